"""From the socket to the disk to the state: the loop that must never wait for anything else."""

import struct
import time
from dataclasses import dataclass
from threading import Event

from carm_kin.errors import InputError
from carm_kin.streams.capture_file import CaptureFile
from carm_kin.streams.client import Batch, Client
from carm_kin.streams.frames import Frame, Frames
from carm_kin.streams.live import Live
from carm_kin.streams.marks import Marks
from carm_kin.streams.openigtlink import MALFORMED, Message, text
from carm_kin.streams.tracking import Observation, observations

WAIT_S = 0.2
"""How long the loop waits for a message before it looks whether to stop."""
LISTEN_S, PATIENCE_S = 1.0, 10.0
"""How long tools are looked for from the first one on, and how long the first one is waited for."""

_STATUS = struct.Struct(">Hq20s")
_STATUS_OK = 1


@dataclass(frozen=True, eq=False)
class Reception:
    """What a capture reads, where it stores it, and who is told."""

    client: Client
    file: CaptureFile
    frames: Frames
    live: Live

    def run(self, stop: Event, most: int | None) -> None:
        """Store what arrives until `stop` is set or ``most`` poses are stored; then set it.

        Frames are on the disk before `live` has them. Raises InputError where they cannot be written.
        """
        connections = self.client.connections
        try:
            while not stop.is_set():
                batch, marks = self.client.receive(WAIT_S), self.live.marks
                if connections != self.client.connections:
                    connections = self.client.connections
                    self.live.reconnected()
                done = self._frames(batch)
                self._store(done if most is None else _first(done, most - self.live.poses), marks)
                if most is not None and self.live.poses >= most:
                    return
            self._store(self.frames.rest(), self.live.marks)
        finally:
            stop.set()

    def _frames(self, batch: Batch) -> list[Frame]:
        done = []
        for message in batch.messages:
            if message.type == "STATUS":
                _tell_status(message, self.live)
                continue
            for observation in _observed(self.client, message):
                self.live.saw(observation, self.frames.of_tool(observation))
                done += self.frames.add(observation, batch.received_s)
        return done

    def _store(self, frames: list[Frame], marks: Marks) -> None:
        if frames:
            self.file.append(frames, marks)
            self.live.add(frames, marks)


def only_tool(client: Client) -> str:
    """The name of the tool that the server sends; what is read meanwhile can be read again.

    Raises InputError where it sends none or several.
    """
    seen: dict[str, None] = {}
    batches = []
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        batches.append(client.receive(WAIT_S))
        found = [o.tool for m in batches[-1].messages if m.type != "STATUS" for o in _observed(client, m)]
        if found and not seen:
            until = time.monotonic() + LISTEN_S
        seen |= dict.fromkeys(found)
    if not seen:
        raise InputError(f"the server at {client.address} sent no pose for {PATIENCE_S:g} s{_sent(client)}")
    if len(seen) > 1:
        names = ", ".join(f"'{name}'" for name in seen)
        raise InputError(f"the server sends several tools; choose one by --tool: {names}")
    client.unread([batch for batch in batches if batch.messages])
    return next(iter(seen))


def _sent(client: Client) -> str:
    """What the server sent instead."""
    kinds = [f"{count} {kind}" for kind, count in client.counts.items()]
    return f"; it sent {', '.join(kinds)}" if kinds else ""


def _observed(client: Client, message: Message) -> list[Observation]:
    try:
        return observations(message)
    except ValueError:
        client.counts[MALFORMED] += 1
        return []


def _tell_status(message: Message, live: Live) -> None:
    """A status other than OK is an event."""
    if len(message.content) >= _STATUS.size:
        code, _, name = _STATUS.unpack_from(message.content)
        if code != _STATUS_OK:
            live.tell(f"the server says: status {code} {text(name)}")


def _first(frames: list[Frame], poses: int) -> list[Frame]:
    """The frames up to so many poses."""
    kept = []
    for frame in frames:
        if poses <= 0:
            break
        kept.append(frame)
        poses -= frame.T is not None
    return kept
