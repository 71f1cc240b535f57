"""One capture from its connection to its end."""

from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from carm_kin.errors import InputError
from carm_kin.streams.capture import Ends, capture
from carm_kin.streams.capture_file import CaptureFile
from carm_kin.streams.client import Address, Client
from carm_kin.streams.frames import Frames
from carm_kin.streams.keys import keys
from carm_kin.streams.live import Live, Snapshot
from carm_kin.streams.marks import Marks
from carm_kin.streams.openigtlink import Message
from carm_kin.streams.reception import Reception, only_tool
from carm_kin.streams.view import Title, view


@dataclass(frozen=True)
class Request:
    """What is to be captured from where to where."""

    server: Address
    path: Path
    append: bool = False
    """Go on with the file where it is there."""
    tool: str | None = None
    """None: the only one that the server sends."""
    reference: str | None = None
    marks: Marks = field(default_factory=Marks)
    moving: str | None = None
    """The joint that moves in the first sweep, and"""
    held_deg: float | None = None
    """where the other one stands; both None: no sweep begins yet."""
    ends: Ends = field(default_factory=Ends)
    ask: tuple[Message, ...] = ()
    """Sent to the server whenever a connection is made."""


def run(request: Request, console: Console) -> tuple[str, Snapshot]:
    """Why the capture ended (`capture.STOPPED`, `GOAL` or `ENDED`), and its last state.

    Raises InputError where there is no server, no tool to choose or no place to write, or where no pose arrived.
    """
    request.marks.begun(request.moving, request.held_deg)
    client = Client(request.server, request.ask)
    client.connect()
    try:
        tool = request.tool or only_tool(client)
        if tool == request.reference:
            raise InputError(f"the reference '{tool}' is the tool itself")
        make = CaptureFile.resume if request.append else CaptureFile.create
        with make(request.path, request.marks) as file:
            live = Live(file.marks.begun(request.moving, request.held_deg))
            client.tell = live.tell
            title = Title(str(request.server), tool, request.reference, str(request.path), request.ends.sigma_m)
            with keys() as pressed, view(title, live, console) as show:
                reception = Reception(client, file, Frames(tool, request.reference), live)
                why = capture(reception, request.ends, pressed, show)
    finally:
        client.close()
    if not live.poses:
        raise InputError(_nothing(request.server, tool, live.snapshot()))
    return why, live.snapshot()


def _nothing(server: Address, tool: str, live: Snapshot) -> str:
    """Why there is no pose."""
    if live.frames:
        faults = ", ".join(f"{count} {fault}" for fault, count in live.faults.items())
        return f"no pose of '{tool}' came from {server}: {faults}"
    names = ", ".join(f"'{name}'" for name in live.tools) or "none"
    return f"'{tool}' did not come from {server}; the tools that came: {names}"
