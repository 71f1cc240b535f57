"""The command `carm-kin calibrate`."""

import sys
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Annotated, Any

import typer

import carm_kin
from carm_kin.cli.arguments import Angular, AsJson, Orbital, SensorLink, above_zero, joint_names, options
from carm_kin.cli.chain import ChainOptions, calibrate_with, chain_options
from carm_kin.cli.names import Naming
from carm_kin.cli.options import grouped
from carm_kin.cli.output import check_place, deliver
from carm_kin.cli.reading import How, reading_options
from carm_kin.cli.report import ReportOptions, report_options
from carm_kin.cli.terminal import Stderr
from carm_kin.errors import InputError, RefusedError
from carm_kin.recording.recording import Recording
from carm_kin.results.result import CalibrationResult


def register(app: typer.Typer) -> None:
    """Add the commands to the program."""
    example = "Example: carm-kin calibrate rec.csv --json result.json --report report.html"
    app.command(cls=Naming, epilog=example)(calibrate)


@grouped("pages", report_options)
@grouped("how", reading_options)
@grouped("chain", chain_options)
def calibrate(
    recording: Annotated[list[Path], typer.Argument(help="File, folder or session; with --urdf several.")],
    how: How,
    chain: ChainOptions,
    pages: ReportOptions,
    solver: Annotated[str | None, typer.Option(help="chain (with --urdf), {solvers}.")] = None,
    locus: Annotated[str, typer.Option(help="What the pivot moves on: {loci}; circle is a C-arm.")] = "circle",
    urdf: Annotated[
        str | None, typer.Option(help="Calibrate the chain of this URDF; with --solver only take its joint names.")
    ] = None,
    angular: Angular = None,
    orbital: Orbital = None,
    sensor_link: SensorLink = None,
    sigma_t_mm: Annotated[float | None, typer.Option(help="Position noise, if it is known.")] = None,
    sigma_r_deg: Annotated[float | None, typer.Option(help="Orientation noise, if it is known.")] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", "-O", help="Option of the solver, NAME=VALUE; may be repeated.")
    ] = None,
    cross_validate: Annotated[
        int | None, typer.Option(help="Predict each of so many parts of the recording by the fit to the others.")
    ] = None,
    as_json: AsJson = None,
) -> None:
    """Calibrate a recording: offset, radii, axes, and how good they are."""
    from carm_kin.results import summary
    from carm_kin.results.provenance import command_line

    check_place(as_json)
    pages.check()
    recordings = [how.read(path) for path in recording]
    settings: dict[str, Any] = {
        "sigma_t_m": above_zero("--sigma-t-mm", sigma_t_mm, 1e-3),
        "sigma_r_rad": above_zero("--sigma-r-deg", sigma_r_deg, radians(1)),
        "command": command_line(sys.argv[1:]),
    }
    more, joints = options(option or []), (angular or "angular", orbital or "orbital")
    if solver == "chain" or (urdf and solver is None and locus == "circle"):
        if urdf is None or locus != "circle":
            raise InputError("the solver 'chain' needs --urdf, and the locus 'circle'")
        settings |= {"angular": angular, "orbital": orbital, "sensor_link": sensor_link, "folds": cross_validate}
        result = calibrate_with(chain, recordings, urdf, settings, more)
    else:
        joints = joint_names(_only_one(recordings, chain), urdf, sensor_link, angular, orbital)
        settings |= {"locus": locus, "angular": joints[0], "orbital": joints[1], **more}
        result = _two_axes(recordings[0], solver, cross_validate, settings)
    deliver(result, as_json)
    pages.write(result, recordings, joints)
    summary.show(result, Stderr())
    if result.refusal:
        raise RefusedError(result.refusal.code, result.refusal.message)


def _only_one(recordings: list[Recording], chain: ChainOptions) -> Recording:
    """The recording of a two-axis calibration, which has no options of a chain."""
    if chain.given or len(recordings) > 1:
        what = ", ".join(chain.given) or "several recordings"
        raise InputError(f"{what}: needs the calibration of a chain, --urdf without another --solver")
    return recordings[0]


def _two_axes(
    recording: Recording, solver: str | None, folds: int | None, settings: dict[str, Any]
) -> CalibrationResult:
    """The calibration, with its held-out check where that was asked for."""
    result = carm_kin.calibrate(recording, solver, **settings)
    if folds is None or result.refusal:
        return result
    from carm_kin.calibration.cross_validate import cross_validate

    given = {name: value for name, value in settings.items() if name != "command"}
    return replace(result, cross_validation=cross_validate(recording, folds, solver, **given))
