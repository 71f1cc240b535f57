"""Capture from a live tracker that speaks OpenIGTLink, and calibrate what came.

    python scripts/live_capture.py [HOST[:PORT]] [--seconds 60] [--out FOLDER]

Without a tracker, a simulated recording is played as one on this computer. In a terminal one sees what arrives.
"""

import argparse
import socket
import sys
from pathlib import Path
from threading import Event, Thread

import numpy as np
from rich.console import Console

import carm_kin
from carm_kin.streams.capture import Ends
from carm_kin.streams.client import Address
from carm_kin.streams.openigtlink import PORT
from carm_kin.streams.replay import Playing, Replay
from carm_kin.streams.run import Request, run


def main() -> None:
    parser = argparse.ArgumentParser(description="Capture from a live tracker and calibrate.")
    parser.add_argument("server", nargs="?", help="HOST or HOST:PORT; left out, a recording is played as a tracker")
    parser.add_argument("--seconds", type=float, default=60, help="how long to capture")
    parser.add_argument("--out", type=Path, default=Path("example"), help="folder for what is written")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "captured.csv"

    if arguments.server:
        server, ends = Address.parse(arguments.server, PORT), Ends(arguments.seconds)
    else:
        recording, _ = carm_kin.simulate("mobile_skewed", sigma_t_m=0.3e-3, sigma_r_rad=np.radians(0.1), seed=7)
        path.unlink(missing_ok=True)  # what was played before; a capture writes over no file
        server, ends = played(recording), Ends(arguments.seconds, poses=len(recording))

    _, seen = run(Request(server, path, ends=ends), Console(stderr=True))
    print(f"{seen.poses} of {seen.frames} frames had a pose; written: {path}")
    print(carm_kin.calibrate(carm_kin.read_recording(path), systematic="none"))  # what is played has noise alone


def played(recording: carm_kin.Recording) -> Address:
    """The address at which a thread plays a recording, 600 poses a second, once somebody listens."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        server = Address("127.0.0.1", free.getsockname()[1])
    replay, serving = Replay(recording, Playing(rate_hz=600)), Event()
    Thread(target=replay.run, args=(server, lambda words: serving.set()), daemon=True).start()
    serving.wait()
    return server


if __name__ == "__main__":
    try:
        main()
    except (carm_kin.CarmKinError, OSError) as error:
        sys.exit(f"error: {error}")
