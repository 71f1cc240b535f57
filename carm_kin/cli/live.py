"""Commands about live trackers: capture from one, replay a recording as one."""

import shlex
from math import inf
from pathlib import Path
from typing import Annotated

import typer

import carm_kin
from carm_kin.cli.arguments import writable
from carm_kin.cli.output import written
from carm_kin.cli.terminal import Stderr
from carm_kin.errors import RefusedError
from carm_kin.streams.marks import Marks
from carm_kin.streams.openigtlink import PORT
from carm_kin.typed import above_zero


def register(app: typer.Typer) -> None:
    """Add the commands to the program."""
    app.command(epilog="Example: carm-kin capture localhost -o rec.csv --tool MarkerToTracker")(capture)
    app.command(epilog="Example: carm-kin replay rec.csv --rate-hz 60")(replay)


def capture(
    server: Annotated[str, typer.Argument(help="HOST or HOST:PORT of an OpenIGTLink server (PLUS, 3D Slicer).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The recording to write, a native CSV.")],
    tool: Annotated[
        str | None, typer.Option(help="The tool on the C; may be left out where there is only one.")
    ] = None,
    reference: Annotated[str | None, typer.Option(help="A tool in whose frame the poses are written.")] = None,
    moving: Annotated[str | None, typer.Option(help="Begin with a sweep in which this joint moves.")] = None,
    label: Annotated[float | None, typer.Option(help="Angle of the joint that is held in it, deg.")] = None,
    until_sigma_mm: Annotated[
        float | None, typer.Option(help="Stop once the offset is known so well, one sigma in every direction.")
    ] = None,
    duration_s: Annotated[float | None, typer.Option(help="Stop after so many seconds.")] = None,
    max_poses: Annotated[int | None, typer.Option(min=1, help="Stop after so many poses.")] = None,
    append: Annotated[bool, typer.Option("--append", help="Go on with a capture that was cut short.")] = False,
    tdata_ms: Annotated[
        int | None, typer.Option(min=0, max=60_000, help="Ask the server for TDATA with so much time between.")
    ] = None,
    angular: Annotated[str, typer.Option(help="Name of the angular joint.")] = "angular",
    orbital: Annotated[str, typer.Option(help="Name of the orbital joint.")] = "orbital",
) -> None:
    """Capture poses from a live tracker; see them, the swept ranges and the calibration as it becomes better."""
    from carm_kin.streams.capture import ENDED, Ends
    from carm_kin.streams.client import Address
    from carm_kin.streams.run import Request, run
    from carm_kin.streams.tracking import start_tdata

    goal_m = above_zero("--until-sigma-mm", until_sigma_mm, 1e-3)
    request = Request(
        server=Address.parse(server, PORT),
        path=writable(out),
        append=append,
        tool=tool,
        reference=reference,
        marks=Marks(angular, orbital),
        moving=moving,
        held_deg=label,
        ends=Ends(above_zero("--duration-s", duration_s, 1.0) or inf, max_poses, goal_m),
        ask=() if tdata_ms is None else (start_tdata(tdata_ms),),
    )
    console = Stderr()
    why, live = run(request, console)
    written(out, f"{live.poses} poses, {live.frames - live.poses} frames without a pose")
    if why == ENDED and goal_m is not None:
        raise RefusedError("goal_not_met", f"the capture ended before the offset was known to {until_sigma_mm:g} mm")
    console.print(f"Next: carm-kin calibrate {shlex.quote(str(out))}", soft_wrap=True)


def replay(
    recording: Annotated[Path, typer.Argument(help="The recording to play.")],
    host: Annotated[str, typer.Option(help="Address to serve at; 0.0.0.0 for every network.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="TCP port; 0 takes a free one.")] = PORT,
    rate_hz: Annotated[float | None, typer.Option(help="Frames a second; left out: as recorded.")] = None,
    tool: Annotated[str, typer.Option(help="Name of the tool.")] = "Sensor",
    message: Annotated[str, typer.Option(help="transform, tdata or qtdata.")] = "transform",
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end, until Ctrl-C.")] = False,
) -> None:
    """Play a recording as an OpenIGTLink server, as if it came from a tracker."""
    from carm_kin.streams.client import Address
    from carm_kin.streams.replay import Playing, Replay

    console = Stderr()
    rate = above_zero("--rate-hz", rate_hz, 1.0)
    player = Replay(carm_kin.read_recording(recording), Playing(tool, message, rate, loop))
    player.run(Address(host, port), lambda words: console.print(words, soft_wrap=True))
    console.print(f"{player.sent} frames sent", soft_wrap=True)
