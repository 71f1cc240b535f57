"""pyigtl's server as an independent peer: sends poses as TRANSFORM at a rate, and may stop and start in between.

    python -m benchmarks.igtl_peer PORT POSES.npy RATE_HZ [STOP_AFTER ...]

POSES.npy holds (N, 4, 4) matrices in millimetres. It prints ``ready`` when it listens, and each time that it was
started again. Its server needs the main thread of a process.
"""

import sys
import time

import numpy as np
import pyigtl

TOOL = "MarkerToTracker"
PAUSE_S = 1.0
"""How long the server is away when it stops in between."""
QUEUE = 90
"""pyigtl drops messages silently once 100 wait to be sent."""


def main(port: int, poses: np.ndarray, rate_hz: float, stops: list[int]) -> None:
    """Send all poses in parts, each from a server of its own."""
    for part in np.split(poses, stops):
        server = pyigtl.OpenIGTLinkServer(port=port, local_server=True)
        print("ready", flush=True)
        while not server.is_connected():
            time.sleep(0.01)
        time.sleep(0.2)
        start = time.monotonic()
        for k, matrix in enumerate(part):
            time.sleep(max(start + k / rate_hz - time.monotonic(), 0.0))
            while len(server.outgoing_messages) > QUEUE:
                time.sleep(0.001)
            server.send_message(pyigtl.TransformMessage(matrix, device_name=TOOL), wait=False)
        while server.outgoing_messages:
            time.sleep(0.01)
        time.sleep(0.2)
        server.stop()
        time.sleep(PAUSE_S)


if __name__ == "__main__":
    main(int(sys.argv[1]), np.load(sys.argv[2]), float(sys.argv[3]), [int(n) for n in sys.argv[4:]])
