"""A server for tests that does as it is told, however hostile, and messages to send."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from carm_kin.streams.client import Address
from carm_kin.streams.openigtlink import encode
from carm_kin.streams.tracking import transform_message

Script = Callable[[socket.socket], None]
RATE_HZ = 240.0


class Server:
    """Accepts one client after another and plays a script to each; use it as a context."""

    def __init__(self, *scripts: Script) -> None:
        self.heard: list[bytes] = []
        """The first bytes of each client."""
        self._scripts = scripts
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = Address("127.0.0.1", self._listener.getsockname()[1])
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> "Server":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()
        self._thread.join(5)

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            for script in self._scripts:
                client, _ = self._listener.accept()
                with client, contextlib.suppress(OSError):
                    self.heard.append(client.recv(1 << 16))
                    script(client)


def pose(k: int) -> np.ndarray:
    """(4, 4) the k-th pose: its x is k mm."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [0.1 * k, 20, -30], degrees=True).as_matrix()
    T[:3, 3] = k / 1000, -0.2, 0.3
    return T


def sample(k: int, tool: str = "Tool") -> bytes:
    """The k-th pose as a message, stamped as if sent at `RATE_HZ`."""
    return encode(transform_message(tool, pose(k), 1000 + k / RATE_HZ, k + 1))


def sends(*data: bytes, pause_s: float = 0.0) -> Script:
    """A script that sends pieces, and goes."""

    def script(client: socket.socket) -> None:
        for piece in data:
            client.sendall(piece)
            time.sleep(pause_s)

    return script


def stays(*data: bytes) -> Script:
    """A script that sends, and is silent until the client goes."""

    def script(client: socket.socket) -> None:
        client.sendall(b"".join(data))
        while client.recv(1 << 16):
            pass

    return script
