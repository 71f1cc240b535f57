"""The command `carm-kin trend`: dated calibrations against control limits."""

import sys
from math import radians
from pathlib import Path
from typing import Annotated

import typer

from carm_kin.cli.arguments import AsJson, writable
from carm_kin.cli.output import check_place, deliver, ended, results, warn, written
from carm_kin.files import write_atomically
from carm_kin.typed import above_zero


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command(epilog="Example: carm-kin trend 2024-*.json --tolerance-mm 1 --figure trend.png --csv trend.csv")(trend)


def trend(
    calibrations: Annotated[
        list[Path], typer.Argument(help="Saved calibrations of one C-arm and sensor, as calibrate --json writes them.")
    ],
    baseline: Annotated[
        int | None, typer.Option(help="The reference is the mean of so many first results; by default 5, if as many.")
    ] = None,
    tolerance_mm: Annotated[
        float | None, typer.Option(help="Change of a length that fails; by default by the limits, and 1.")
    ] = None,
    tolerance_deg: Annotated[
        float | None, typer.Option(help="Change of an angle that fails; by default by the limits, and 0.5.")
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="Draw the control charts here: .svg, .png or .pdf.")] = None,
    as_csv: Annotated[Path | None, typer.Option("--csv", help="Write every result and quantity here.")] = None,
    as_json: AsJson = None,
) -> None:
    """Put calibrations in the order of their dates and judge the latest: status 0 pass or note, 3 alert or fail."""
    from carm_kin.quality import trend_view
    from carm_kin.quality.trend import trend as judge
    from carm_kin.results.provenance import command_line
    from carm_kin.results.rows import csv_text

    _check_places(figure, as_csv, as_json)
    found = judge(
        calibrations,
        baseline=baseline,
        tolerance_m=above_zero("--tolerance-mm", tolerance_mm, 1e-3),
        tolerance_rad=above_zero("--tolerance-deg", tolerance_deg, radians(1)),
        command=command_line(sys.argv[1:]),
    )
    deliver(found, as_json)
    if as_csv is not None:
        write_atomically(as_csv, csv_text(trend_view.rows_of(found)))
        written(as_csv)
    if figure is not None:
        from carm_kin.report.static import save

        save(found.figure(), figure)
        written(figure)
    console = results(as_json, as_csv)
    for line in trend_view.lines_of(found):
        console.print(line.text, soft_wrap=True)
    warn(found.warnings)
    wrong = found.status in ("alert", "fail")
    console.print(found.verdict, style="bold red" if wrong else "bold green", soft_wrap=True)
    if wrong:
        latest = found.results[-1]
        raise typer.Exit(ended(3, found.status, f"{latest.label}: {'; '.join(latest.reasons)}"))


def _check_places(figure: Path | None, as_csv: Path | None, as_json: str | None) -> None:
    """Before the work starts."""
    check_place(as_json)
    if as_csv is not None:
        writable(as_csv)
    if figure is not None:
        from carm_kin.report.static import check_figure

        check_figure(writable(figure))
