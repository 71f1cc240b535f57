"""Commands that use a saved calibration on a new recording: whether it still holds, the virtual centre of a scan."""

import sys
from math import radians
from pathlib import Path
from typing import Annotated

import typer

import carm_kin
from carm_kin.cli.arguments import Angular, AsJson, Orbital
from carm_kin.cli.options import grouped
from carm_kin.cli.output import check_place, deliver, ended, results, warn
from carm_kin.cli.reading import How, reading_options
from carm_kin.errors import RefusedError
from carm_kin.typed import above_zero


def register(app: typer.Typer) -> None:
    """Add the commands to the program."""
    app.command(epilog="Example: carm-kin check result.json new.csv --tolerance-mm 1 --tolerance-deg 0.5")(check)
    app.command(epilog="Example: carm-kin centre result.json scan.csv --json centre.json")(centre)


@grouped("how", reading_options)
def check(
    result: Annotated[Path, typer.Argument(help="The saved calibration, as calibrate --json writes it.")],
    recording: Annotated[Path, typer.Argument(help="A new recording with motion about both axes.")],
    how: How,
    tolerance_mm: Annotated[float, typer.Option(help="Change of a length that is accepted.")] = 1.0,
    tolerance_deg: Annotated[float, typer.Option(help="Change of an angle that is accepted.")] = 0.5,
    angular: Angular = None,
    orbital: Orbital = None,
    sigma_t_mm: Annotated[float | None, typer.Option(help="Position noise, if it is known.")] = None,
    sigma_r_deg: Annotated[float | None, typer.Option(help="Orientation noise, if it is known.")] = None,
    as_json: AsJson = None,
) -> None:
    """Check whether a saved calibration still holds: status 0 passed, 3 failed or refused."""
    from carm_kin.calibrated.check import check as apply
    from carm_kin.calibration.settings import Settings
    from carm_kin.results import summary
    from carm_kin.results.provenance import command_line

    check_place(as_json)
    saved = carm_kin.CalibrationResult.from_json(result)
    poses = how.read(recording)
    joints = Settings(angular=angular, orbital=orbital).joint_names(poses)
    found = apply(
        saved,
        poses,
        tolerance_m=tolerance_mm / 1e3,
        tolerance_rad=radians(tolerance_deg),
        angular=joints[0],
        orbital=joints[1],
        sigma_t_m=above_zero("--sigma-t-mm", sigma_t_mm, 1e-3),
        sigma_r_rad=above_zero("--sigma-r-deg", sigma_r_deg, radians(1)),
        command=command_line(sys.argv[1:]),
    )
    deliver(found, as_json)
    console = results(as_json)
    summary.show_check(found, console)
    warn(found.warnings)
    console.print(found.verdict, style="bold green" if found.status == "passed" else "bold red")
    if found.refusal:
        raise RefusedError(found.refusal.code, found.refusal.message)
    if found.failures:
        raise typer.Exit(ended(3, "failed", "; ".join(found.failures)))


@grouped("how", reading_options)
def centre(
    result: Annotated[Path, typer.Argument(help="The calibration, as calibrate --json writes it.")],
    scan: Annotated[Path, typer.Argument(help="A recording of one orbital scan, other axes travelling.")],
    how: How,
    placement: Annotated[str | None, typer.Option(help="The calibrated placement of the base, if several.")] = None,
    tolerance_mm: Annotated[float, typer.Option(help="Motion of the centre beyond the noise that is accepted.")] = 1.0,
    sigma_t_mm: Annotated[float | None, typer.Option(help="Position noise, if not as calibrated.")] = None,
    sigma_r_deg: Annotated[float | None, typer.Option(help="Orientation noise, if not as calibrated.")] = None,
    as_json: AsJson = None,
) -> None:
    """Find the virtual centre of a non-isocentric scan: status 0 fixed, 3 not fixed or refused."""
    from carm_kin.results import summary
    from carm_kin.results.provenance import command_line

    check_place(as_json)
    found = carm_kin.virtual_centre(
        carm_kin.CalibrationResult.from_json(result),
        how.read(scan),
        placement=placement,
        tolerance_m=tolerance_mm / 1e3,
        sigma_t_m=above_zero("--sigma-t-mm", sigma_t_mm, 1e-3),
        sigma_r_rad=above_zero("--sigma-r-deg", sigma_r_deg, radians(1)),
        command=command_line(sys.argv[1:]),
    )
    deliver(found, as_json)
    console = results(as_json)
    summary.show_centre(found, console)
    warn(found.warnings)
    console.print(found.verdict, style="bold green" if found.status == "fixed" else "bold red")
    if found.refusal:
        raise RefusedError(found.refusal.code, found.refusal.message)
    if found.motion:
        raise typer.Exit(ended(3, "not fixed", found.motion))
