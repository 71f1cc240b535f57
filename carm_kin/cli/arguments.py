"""Arguments of the command that need more than a type: files, joint names, options of a solver."""

import inspect as introspection
import json
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carm_kin.errors import InputError

if TYPE_CHECKING:
    from carm_kin.recording.recording import Recording

Urdf = Annotated[str, typer.Argument(help="A URDF file or the name of a bundled machine.")]
AsJson = Annotated[str | None, typer.Option("--json", help="Write the result here; - for stdout.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Angular = Annotated[str | None, typer.Option(help="Name of the angular joint.")]
Orbital = Annotated[str | None, typer.Option(help="Name of the orbital joint.")]
SensorLink = Annotated[str | None, typer.Option(help="Link that carries the sensor.")]


def writable(path: Path) -> Path:
    """The path of a file that may be written, checked before the work starts."""
    if path.is_dir():
        raise InputError("is a folder; give the name of a file", file=path)
    if not path.parent.is_dir():
        raise InputError(f"the folder {path.parent} does not exist", file=path)
    return path


def above_zero(option: str, value: float | None, unit: float) -> float | None:
    """A standard deviation in m or rad."""
    if value is None:
        return None
    if not 0 < value < inf:
        raise InputError(f"{option} must be a finite number above 0, not {value}; leave it out if it is not known")
    return value * unit


def joint_names(
    recording: "Recording",
    urdf: str | None,
    sensor_link: str | None,
    angular: str | None,
    orbital: str | None,
) -> tuple[str, str]:
    """The names of the two joints in the recording: by option, from the URDF, or the usual ones.

    Raises InputError where the recording names joints, but not those that were asked for.
    """
    names = {*recording.joints, *(() if recording.moving is None else recording.moving)} - {""}
    has = f"the recording has {', '.join(sorted(names))}"
    for option, joint in (("--angular", angular), ("--orbital", orbital)):
        if joint is not None and names and joint not in names:
            raise InputError(f"{option}: no joint '{joint}'; {has}")
    if urdf is None:
        return angular or "angular", orbital or "orbital"
    from carm_kin.machine.chain import chain_of
    from carm_kin.machine.urdf import read_urdf

    chain = chain_of(read_urdf(urdf), sensor_link, angular, orbital)
    axes = chain.names[chain.angular], chain.names[chain.orbital]
    if names and not names & set(axes):
        raise InputError(f"--urdf: its axes are '{axes[0]}' and '{axes[1]}'; {has}; is it another machine?")
    return axes


def options(pairs: list[str]) -> dict[str, Any]:
    """``NAME=VALUE`` pairs; a value is JSON where it can be (true, 0.05, null), else text."""
    from carm_kin.calibration.calibrate import calibrate

    found: dict[str, Any] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name:
            raise InputError(f"--option '{pair}' is not of the form NAME=VALUE")
        if name in introspection.signature(calibrate).parameters:
            raise InputError(f"--option '{name}' is no option of a solver (see carm-kin calibrate --help)")
        if name in found:
            raise InputError(f"--option '{name}' is given twice")
        try:
            found[name] = json.loads(text)
        except (ValueError, RecursionError):
            found[name] = text
    return found
