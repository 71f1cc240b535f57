"""The options of every command that reads a recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carm_kin.recording.declarations import Declarations

if TYPE_CHECKING:
    from carm_kin.recording.recording import Recording

PANEL = "How the file is read"


@dataclass(frozen=True)
class How:
    """How the recordings of a command are read."""

    format: str | None
    declared: Declarations
    stations: bool

    def read(self, path: Path) -> "Recording":
        """The recording in a file, a folder or a session."""
        from carm_kin.recording.formats import read_recording

        recording = read_recording(path, self.format, self.declared)
        if not self.stations:
            return recording
        from carm_kin.recording.stations import at_stations

        return at_stations(recording)


def _option(*names: str, help: str) -> Any:
    return typer.Option(*names, help=help, rich_help_panel=PANEL)


def reading_options(
    format: Annotated[str | None, _option("--format", help="Format of the file; see carm-kin formats.")] = None,
    tool: Annotated[str | None, _option("--tool", help="The tool on the C, by its name or a part of it.")] = None,
    reference: Annotated[str | None, _option("--reference", help="Give the poses relative to this tool.")] = None,
    invert: Annotated[bool, _option("--invert", help="The tracker rides on the C and watches a fixed tool.")] = False,
    unit: Annotated[str | None, _option("--unit", help="Of positions: mm, cm or m.")] = None,
    quaternion: Annotated[str | None, _option("--quaternion", help="Order of quaternions: wxyz or xyzw.")] = None,
    euler: Annotated[str | None, _option("--euler", help="Order of Euler angles; ZYX is Rz Ry Rx.")] = None,
    left_handed: Annotated[
        bool | None, _option("--left-handed/--right-handed", help="Handedness of the file's frames.")
    ] = None,
    stations: Annotated[bool, _option("--stations", help="Average the frames of every stop of the C.")] = False,
) -> How:
    """The options of a reader. Raises InputError for one that is unknown."""
    return How(format, Declarations(tool, reference, invert, unit, quaternion, euler, left_handed), stations)
