"""Commands about machines: the demonstration, what a URDF holds, simulated recordings."""

import json
from math import radians
from pathlib import Path
from typing import Annotated

import typer

import carm_kin
from carm_kin.cli.arguments import Angular, Orbital, Seed, SensorLink, Urdf, writable
from carm_kin.cli.options import grouped
from carm_kin.cli.output import warn, written
from carm_kin.cli.report import ReportOptions, report_options
from carm_kin.cli.terminal import Stderr, Stdout, to_stdout
from carm_kin.typed import check_from_zero


def register(app: typer.Typer) -> None:
    """Add the commands to the program."""
    app.command(epilog="Example: carm-kin demo --out my-first-calibration --report report.html")(demo)
    app.command(epilog="Example: carm-kin inspect mobile_nonisocentric")(inspect)
    app.command(epilog="Example: carm-kin simulate mobile_nonisocentric -o rec.csv --sigma-t-mm 0.5 --sigma-r-deg 0.1")(
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


def simulate(
    urdf: Urdf,
    out: Annotated[Path, typer.Option("--out", "-o", help="The recording; its truth goes to NAME.truth.json.")],
    protocol: Annotated[
        str, typer.Option(help="paper, clinical, minimal, free, joints, virtual or a .toml file.")
    ] = "clinical",
    sigma_t_mm: Annotated[float, typer.Option(min=0, help="Position noise, one sigma an axis.")] = 0.0,
    sigma_r_deg: Annotated[float, typer.Option(min=0, help="Orientation noise, one sigma an axis.")] = 0.0,
    depth_ratio: Annotated[
        float, typer.Option(min=0.01, help="Noise along the tracker's line of sight (z) over that across it.")
    ] = 1.0,
    outliers: Annotated[float, typer.Option(help="Share of gross outliers, 0 to 1.")] = 0.0,
    missing: Annotated[float, typer.Option(help="Share of missing frames, 0 to 1.")] = 0.0,
    sigma_reading_deg: Annotated[float, typer.Option(min=0, help="Error of the angles that are recorded.")] = 0.0,
    sigma_reading_mm: Annotated[float, typer.Option(min=0, help="Error of the lengths that are recorded.")] = 0.0,
    labels: Annotated[bool, typer.Option(help="Keep sweeps and known angles.")] = True,
    angular: Angular = None,
    orbital: Orbital = None,
    sensor_link: SensorLink = None,
    seed: Seed = 0,
) -> None:
    """Simulate a recording of a C-arm, with its truth beside it."""
    check_from_zero("--sigma-t-mm", sigma_t_mm)
    check_from_zero("--sigma-r-deg", sigma_r_deg)
    check_from_zero("--sigma-reading-deg", sigma_reading_deg)
    check_from_zero("--sigma-reading-mm", sigma_reading_mm)
    truth_file = writable(writable(out).with_suffix(".truth.json"))
    recording, truth = carm_kin.simulate(
        urdf,
        protocol,
        sigma_t_m=sigma_t_mm / 1000,
        sigma_r_rad=radians(sigma_r_deg),
        depth_ratio=depth_ratio,
        outliers=outliers,
        missing=missing,
        sigma_reading_rad=radians(sigma_reading_deg),
        sigma_reading_m=sigma_reading_mm / 1000,
        labels=labels,
        angular=angular,
        orbital=orbital,
        sensor_link=sensor_link,
        seed=seed,
    )
    carm_kin.write_recording(recording, out)
    truth.to_json(truth_file)
    warn(truth.warnings)
    written(out, f"{len(recording)} poses")
    written(truth_file, "the truth")
