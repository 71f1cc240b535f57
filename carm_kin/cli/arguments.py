"""Arguments that several commands have, and files that may be written."""

from pathlib import Path
from typing import Annotated

import typer

from carm_kin.errors import InputError

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
