"""The options of every command that reads a recording."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from carm_kin.declarations import Declarations
from carm_kin.recording import Recording

PANEL = "How the file is read"


@dataclass(frozen=True)
class How:
    """How the recordings of a command are read."""

    format: str | None
    declared: Declarations
    stations: bool

    def read(self, path: Path) -> Recording:
        """The recording in a file, a folder or a session."""
        from carm_kin.formats import read_recording

        recording = read_recording(path, self.format, self.declared)
        if not self.stations:
            return recording
        from carm_kin.stations import at_stations

        return at_stations(recording)


def _option(*names: str, help: str) -> Any:
    return typer.Option(*names, help=help, rich_help_panel=PANEL)


def _options(
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


def reads_recordings(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options of a reader in place of its parameter ``how``."""
    own = inspect.signature(command).parameters
    more = {
        name: parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for name, parameter in inspect.signature(_options).parameters.items()
    }

    @wraps(command)
    def whole(*given: Any, **named: Any) -> Any:
        how = _options(**{name: named.pop(name) for name in more})
        return command(*given, how=how, **named)

    kept = [parameter for name, parameter in own.items() if name != "how"]
    whole.__signature__ = inspect.Signature([*kept, *more.values()])  # pyright: ignore[reportAttributeAccessIssue]
    hints = get_type_hints(command, include_extras=True) | get_type_hints(_options, include_extras=True)
    whole.__annotations__ = {name: hint for name, hint in hints.items() if name not in ("how", "return")}
    return whole
