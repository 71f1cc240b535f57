"""How far the rotation centre of a calibrated C-arm wanders."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from carm_kin.cli.arguments import AsJson, writable
from carm_kin.cli.output import check_place, deliver, ended, results, written
from carm_kin.typed import above_zero


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command(epilog="Example: carm-kin isocentre result.json --tolerance-mm 2 --figure isocentre.png")(isocentre)


def isocentre(
    result: Annotated[Path, typer.Argument(help="The calibration, as calibrate --json writes it.")],
    placement: Annotated[str | None, typer.Option(help="The calibrated placement of the base, if several.")] = None,
    tolerance_mm: Annotated[
        float | None, typer.Option(help="Greatest diameter over both axes that passes; status 3 beyond it.")
    ] = None,
    as_json: AsJson = None,
    csv: Annotated[Path | None, typer.Option(help="Write a row an axis here, for quality records.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Draw the wander over both angles here: .png or .svg.")] = None,
) -> None:
    """Tell the smallest balls that hold the rotation centre over the range of each axis and of both."""
    from carm_kin.calibrated.isocentre import isocentre as found_in
    from carm_kin.results.provenance import command_line

    check_place(as_json)
    for file in (csv, figure):
        if file is not None:
            writable(file)
    found = found_in(
        result,
        placement=placement,
        tolerance_m=above_zero("--tolerance-mm", tolerance_mm, 1e-3),
        command=command_line(sys.argv[1:]),
    )
    deliver(found, as_json)
    if csv is not None:
        found.to_csv(csv)
        written(csv)
    if figure is not None:
        from carm_kin.report.isocentre import draw_isocentre

        draw_isocentre(found, figure)
        written(figure)
    results(as_json).print(str(found))
    if found.status == "failed":
        raise typer.Exit(ended(3, "failed", "the rotation centre wanders farther than the tolerance"))
