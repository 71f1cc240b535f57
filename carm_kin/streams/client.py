"""A client of an OpenIGTLink server that keeps its connection: it connects again, ever more slowly, when it is lost."""

import contextlib
import socket
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from carm_kin.errors import InputError
from carm_kin.streams.openigtlink import Decoder, Message, ProtocolError, encode
from carm_kin.streams.tracking import TYPES

BACK_OFF_S = (0.1, 5.0)
"""First and longest pause before connecting again; each is twice the one before."""
SILENCE_S = 10.0
"""A connection on which nothing arrives for so long is made anew."""
CONNECT_S = 2.0
"""How long connecting may take."""

BROKEN = "broken streams"
"""How often a connection was given up since what arrived was no OpenIGTLink."""

_AT_ONCE = 1 << 16
_HELLO = Message("GET_STATUS", "carm-kin", b"")
"""Tells the server that we read header version 2; PLUS sends metadata, with the validity of poses, only then."""


@dataclass(frozen=True)
class Address:
    """A host and a TCP port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @staticmethod
    def parse(text: str, default_port: int) -> "Address":
        """``HOST``, ``HOST:PORT``, ``[IPV6]`` or ``[IPV6]:PORT``. Raises InputError for anything else."""
        host, colon, port = text.strip().rpartition(":")
        if not colon or (text.startswith("[") and text.endswith("]")):
            host, port = text.strip(), str(default_port)
        elif ":" in host and not host.startswith("["):
            raise InputError(f"server '{text}': write an IPv6 address as [ADDRESS]:PORT")
        host = host.removeprefix("[").removesuffix("]")
        if not host or not (port.isascii() and port.isdecimal()) or not 0 < int(port) < 65536:
            raise InputError(f"server '{text}' is not of the form HOST or HOST:PORT, with a port from 1 to 65535")
        return Address(host, int(port))


@dataclass(frozen=True)
class Batch:
    """Messages that arrived together."""

    received_s: float
    """When, s since 1970 by this computer's clock."""
    messages: tuple[Message, ...] = ()


class Client:
    """Reads the messages that hold poses, and STATUS."""

    def __init__(
        self,
        address: Address,
        ask: tuple[Message, ...] = (),
        silence_s: float = SILENCE_S,
    ) -> None:
        """`ask` is sent whenever a connection is made."""
        self.address = address
        self.tell: Callable[[str], None] = lambda event: None
        """Is given a sentence whenever the connection changes."""
        self.counts: Counter[str] = Counter()
        """What was left out, over all connections: see `Decoder`, and `BROKEN`."""
        self.connections = 0
        self._ask = b"".join(encode(message) for message in (_HELLO, *ask))
        self._silence_s = silence_s
        self._socket: socket.socket | None = None
        self._decoder = self._new_decoder()
        self._pause_s = BACK_OFF_S[0]
        self._next = 0.0
        self._heard = 0.0
        self._unread: list[Batch] = []

    @property
    def connected(self) -> bool:
        """Whether there is a connection."""
        return self._socket is not None

    def connect(self) -> None:
        """Connect for the first time. Raises InputError where there is no server."""
        try:
            self._open()
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"no OpenIGTLink server at {self.address}: {reason}") from None

    def unread(self, batches: list[Batch]) -> None:
        """Let `receive` give these batches again, before all others."""
        self._unread = batches + self._unread

    def receive(self, timeout_s: float) -> Batch:
        """The messages that have arrived, as soon as there is something; connects again where that is due."""
        if self._unread:
            return self._unread.pop(0)
        data = self._data(timeout_s)
        received_s = time.time()
        return Batch(received_s, self._decoded(data) if data else ())

    def _data(self, timeout_s: float) -> bytes:
        """What the socket has; nothing after the timeout, or without a connection."""
        if self._socket is None:
            self._connect_again(timeout_s)
            return b""
        self._socket.settimeout(timeout_s)
        try:
            data = self._socket.recv(_AT_ONCE)
        except TimeoutError:
            if time.monotonic() - self._heard > self._silence_s:
                self._lose(f"nothing arrived for {self._silence_s:g} s")
            return b""
        except OSError as error:
            self._lose(error.strerror or str(error))
            return b""
        if not data:
            self._lose("the server closed it")
        self._heard = time.monotonic()
        return data

    def close(self) -> None:
        """End the connection."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._decoder = self._new_decoder()

    def _new_decoder(self) -> Decoder:
        return Decoder((*TYPES, "STATUS"), self.counts)

    def _decoded(self, data: bytes) -> tuple[Message, ...]:
        """The sound messages, also where what follows them is not."""
        messages = []
        try:
            for message in self._decoder.feed(data):
                messages.append(message)
                self._pause_s = BACK_OFF_S[0]
        except ProtocolError as error:
            self.counts[BROKEN] += 1
            self._lose(str(error))
        return tuple(messages)

    def _connect_again(self, timeout_s: float) -> None:
        wait = self._next - time.monotonic()
        if wait > 0:
            time.sleep(min(wait, timeout_s))
            return
        try:
            self._open()
        except OSError:
            self._put_off()
        else:
            self.tell(f"connected again to {self.address}")

    def _open(self) -> None:
        opened = socket.create_connection((self.address.host, self.address.port), CONNECT_S)
        with contextlib.suppress(OSError):
            opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            opened.sendall(self._ask)
        except OSError:
            opened.close()
            raise
        self._socket, self._heard = opened, time.monotonic()
        self.connections += 1

    def _lose(self, reason: str) -> None:
        self.close()
        self._put_off()
        self.tell(f"connection lost: {reason}")

    def _put_off(self) -> None:
        self._next = time.monotonic() + self._pause_s
        self._pause_s = min(2 * self._pause_s, BACK_OFF_S[1])
