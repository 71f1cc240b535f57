"""A server that plays a recording as a tracker would, so that a capture can be tried without one."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from carm_kin.streams.client import Address
from carm_kin.streams.openigtlink import Message, encode
from carm_kin.streams.tracking import qtdata_message, tdata_message, transform_message
from solvers.se3 import Array, transform

USUAL_HZ = 60.0
"""The rate where neither an option nor the recording's times tell."""
KINDS = ("transform", "tdata", "qtdata")
MAX_BEHIND = 1 << 22
"""A client that is so many bytes behind is dropped."""

CLOSE_S = 2.0
"""How long a client may take to read the rest."""


@dataclass(frozen=True)
class Playing:
    """How a recording is played."""

    tool: str = "Sensor"
    kind: str = "transform"
    """One of `KINDS`; the two others leave out frames without a pose."""
    rate_hz: float | None = None
    """None: at the recorded times, or `USUAL_HZ` where there are none."""
    loop: bool = False
    """Begin again at the end, until stopped."""


class Listener(asyncio.Protocol):
    """A client; what it sends is not heeded."""

    def __init__(self, replay: "Replay") -> None:
        self._replay = replay

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """It is sent the frames from here on."""
        assert isinstance(transport, asyncio.WriteTransport)
        self._transport = transport
        self._replay.clients.add(transport)
        self._replay.begin.set()

    def connection_lost(self, exc: Exception | None) -> None:
        """It is gone."""
        self._replay.clients.discard(self._transport)


@dataclass(eq=False)
class Replay:
    """One playing of a recording to whoever listens; it begins with the first client."""

    recording: Recording
    playing: Playing
    clients: set[asyncio.WriteTransport] = field(default_factory=set)
    begin: asyncio.Event = field(default_factory=asyncio.Event)
    sent: int = 0
    """Frames sent."""

    def __post_init__(self) -> None:
        if self.playing.kind not in KINDS:
            raise InputError(f"--message '{self.playing.kind}' is none of {', '.join(KINDS)}")
        if self.recording.R_world_sensor is None:
            raise InputError("the recording has no orientations (qw, qx, qy, qz) to send")

    def run(self, address: Address, tell: Callable[[str], None]) -> None:
        """Serve until the end of the recording. Raises InputError where the address cannot be used."""
        asyncio.run(self._serve(address, tell))

    async def _serve(self, address: Address, tell: Callable[[str], None]) -> None:
        try:
            server = await asyncio.get_running_loop().create_server(lambda: Listener(self), address.host, address.port)
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"cannot serve at {address}: {reason}") from None
        port = server.sockets[0].getsockname()[1]
        tell(f"serving '{self.playing.tool}' at {Address(address.host, port)}; it begins with the first client")
        async with server:
            await self.begin.wait()
            await self._play()
            server.close()
            await self._let_go()

    async def _let_go(self) -> None:
        """Close the connections once all is sent, but wait for no client for long."""
        for transport in tuple(self.clients):
            transport.close()
        until = time.monotonic() + CLOSE_S
        while self.clients and time.monotonic() < until:
            await asyncio.sleep(0.01)
        for transport in tuple(self.clients):
            transport.abort()

    async def _play(self) -> None:
        times, poses = schedule(self.recording, self.playing.rate_hz)
        while True:
            start = time.monotonic() - times[0]
            for due, T in zip(times, poses, strict=True):
                await asyncio.sleep(max(start + due - time.monotonic(), 0.0))
                self._send(T)
            if not self.playing.loop:
                return
            await asyncio.sleep(times[1] - times[0] if len(times) > 1 else 1 / USUAL_HZ)

    def _send(self, T: Array | None) -> None:
        self.sent += 1
        message = self._message(T)
        data = b"" if message is None else encode(message)
        for transport in tuple(self.clients):
            if transport.get_write_buffer_size() > MAX_BEHIND:
                transport.abort()
            else:
                transport.write(data)

    def _message(self, T: Array | None) -> Message | None:
        tool, stamp_s = self.playing.tool, time.time()
        if self.playing.kind == "transform":
            return transform_message(tool, T, stamp_s, self.sent)
        make = tdata_message if self.playing.kind == "tdata" else qtdata_message
        return None if T is None else make("Tracker", [(tool, T)], stamp_s, self.sent)


def schedule(recording: Recording, rate_hz: float | None) -> tuple[Array, list[Array | None]]:
    """When each frame is due (F,), s, and its pose (4, 4), m; None where the recording has none.

    The times are those recorded, if they increase and no rate is given; frames without a pose lie between.
    """
    assert recording.R_world_sensor is not None
    frames, number = len(recording) + recording.missing, recording.pose_number
    if not recording.missing:
        number = np.arange(len(recording))
    poses: list[Array | None] = [None] * frames
    for k, T in zip(number, transform(recording.R_world_sensor, recording.p_world_sensor), strict=True):
        poses[k] = T
    recorded = recording.time_s
    if rate_hz is None and recorded is not None and (np.diff(recorded) > 0).all() and len(recording) > 1:
        inside = np.arange(number[0], number[-1] + 1)
        return np.interp(inside, number, recorded - recorded[0]), poses[number[0] : number[-1] + 1]
    return np.arange(frames) / (rate_hz or USUAL_HZ), poses
