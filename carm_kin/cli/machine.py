"""Commands about machines: the demonstration, what a URDF holds, simulated recordings."""

import json
from pathlib import Path
from typing import Annotated

import typer

from carm_kin.cli.arguments import Angular, Orbital, Seed, SensorLink, Urdf
from carm_kin.cli.options import grouped
from carm_kin.cli.report import ReportOptions, report_options
from carm_kin.cli.simulate import simulate
from carm_kin.cli.terminal import Stderr, Stdout, to_stdout


def register(app: typer.Typer) -> None:
    """Add the commands to the program."""
    app.command(epilog="Example: carm-kin demo --out my-first-calibration --report report.html")(demo)
    app.command(epilog="Example: carm-kin inspect mobile_nonisocentric")(inspect)
    app.command(epilog="Example: carm-kin simulate mobile_3d -o rec.csv --sigma-t-mm 0.2 --sigma-r-deg 0.1 --sag-mm 2")(
        simulate
    )


@grouped("pages", report_options)
def demo(
    pages: ReportOptions,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the files.")] = Path("carm-kin-demo"),
    seed: Seed = 0,
) -> None:
    """Simulate a clinical recording, calibrate it with every solver, compare with the truth."""
    from carm_kin.cli.demo import run

    run(out, seed, pages)


def inspect(
    urdf: Urdf,
    angular: Angular = None,
    orbital: Orbital = None,
    sensor_link: SensorLink = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the same as JSON on stdout.")] = False,
) -> None:
    """Print the chain, its ranges and the nominal geometry of a C-arm."""
    from carm_kin.machine import inspection

    found = inspection.inspect(urdf, sensor_link, angular, orbital)
    if as_json:
        to_stdout(json.dumps(found.to_dict(), indent=2) + "\n")
        return
    inspection.show(found, Stdout())
    for note in found.notes:
        Stderr().print(f"note: {note}", soft_wrap=True)
