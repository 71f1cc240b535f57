"""Commands about files of recordings: which formats there are, and from one to another."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from carm_kin.cli.arguments import writable
from carm_kin.cli.loudness import App
from carm_kin.cli.options import grouped
from carm_kin.cli.output import results, warn, written
from carm_kin.cli.reading import How, reading_options
from carm_kin.cli.terminal import Stderr, Stdout

if TYPE_CHECKING:
    from carm_kin.recording.recording import Recording

_PARTS = ("time_s", "sweep", "moving", "placement", "joints", "metadata", "variance")
"""Of a recording, beyond the poses."""


def register(app: typer.Typer) -> None:
    """Add the commands to the program."""
    app.command(epilog="Example: carm-kin formats")(formats)
    app.command(epilog="Example: carm-kin convert capture.igs.mha -o rec.csv --tool Stylus")(convert)
    session = App(help="Sessions: sweeps in several files, with their labels.", no_args_is_help=False)
    session.callback()(lambda: None)
    session.command(epilog="Example: carm-kin session init monday")(init)
    app.add_typer(session, name="session")


def formats() -> None:
    """List the formats of recordings."""
    from carm_kin.recording.formats import formats as known

    console = Stdout()
    for name, found in known().items():
        console.print(f"  {name:<10}{'read, write' if found.write else 'read':<13}{found.summary}", soft_wrap=True)


@grouped("how", reading_options)
def convert(
    recording: Annotated[Path, typer.Argument(help="A file, a folder of files, or a session.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The file to write; its ending tells the format.")],
    how: How,
    to: Annotated[str | None, typer.Option(help="Format to write, where the ending does not tell.")] = None,
) -> None:
    """Convert a recording, as into the native CSV, and count what was dropped."""
    from carm_kin.recording.formats import write_recording, writer_of
    from carm_kin.results import summary

    format = writer_of(writable(out), to)
    poses = how.read(recording)
    write_recording(poses, out, format.name)
    summary.show_intakes(poses.intakes, results(out))
    warn(note for note in poses.warnings if note.code != "missing_frames")
    if lost := [part for part in _held(poses) if part not in format.holds]:
        Stderr().print(f"warning: the format '{format.name}' does not hold {', '.join(lost)}", soft_wrap=True)
    written(out, f"{len(poses)} poses")


def init(folder: Annotated[Path, typer.Argument(help="The folder of the tracker's files.")]) -> None:
    """Write a first session.toml from the files found."""
    from carm_kin.recording.session_init import init as write

    path, sweeps = write(folder)
    written(path, f"{sweeps} sweeps; fill in their labels")


def _held(recording: "Recording") -> list[str]:
    """The parts that the recording has."""
    values = {part: getattr(recording, part) for part in _PARTS}
    return [part for part, value in values.items() if value is not None and len(value)]
