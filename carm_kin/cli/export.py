"""The command `carm-kin export`."""

from pathlib import Path
from typing import Annotated

import typer

from carm_kin.cli.arguments import writable
from carm_kin.cli.names import Naming
from carm_kin.cli.output import written


def export(
    result: Annotated[Path, typer.Argument(help="The calibration, as calibrate --json writes it.")],
    to: Annotated[str, typer.Option("--to", help="{exports}.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The file to write.")],
    transform: Annotated[
        str, typer.Option(help="sensor-carm: the C-arm in the sensor's frame; world-torus: the machine in the world.")
    ] = "sensor-carm",
    placement: Annotated[str | None, typer.Option(help="Which base placement, for world-torus.")] = None,
    parent_frame: Annotated[str | None, typer.Option(help="Name of the parent frame.")] = None,
    child_frame: Annotated[str | None, typer.Option(help="Name of the child frame.")] = None,
    urdf: Annotated[Path | None, typer.Option(help="The URDF that was calibrated, to urdf only.")] = None,
) -> None:
    """Write a calibration for another program; a refused one is not exported (status 3)."""
    from carm_kin import exports

    exports.export(
        result,
        to,
        writable(out),
        transform=transform,
        placement=placement,
        parent_frame=parent_frame,
        child_frame=child_frame,
        urdf=urdf,
    )
    written(out)


def register(app: typer.Typer) -> None:
    """Add the command to ``app``."""
    app.command(cls=Naming, epilog="Example: carm-kin export result.json --to ros2 -o sensor_to_carm.yaml")(export)
