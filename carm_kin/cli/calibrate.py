"""The command `carm-kin calibrate`."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from carm_kin.cli.arguments import AsJson, writable
from carm_kin.cli.names import Naming
from carm_kin.cli.options import grouped
from carm_kin.cli.output import check_place, deliver, ended, results, warn, written
from carm_kin.cli.reading import How, reading_options
from carm_kin.cli.report import ReportOptions, report_options
from carm_kin.cli.settings import CHAIN_PANEL, named, settings_options
from carm_kin.errors import RefusedError
from carm_kin.typed import above_zero


def register(app: typer.Typer) -> None:
    """Add the commands to the program."""
    example = "Example: carm-kin calibrate rec.csv --json result.json --report report.html"
    app.command(cls=Naming, epilog=example)(calibrate)


@grouped("pages", report_options)
@grouped("how", reading_options)
@grouped("given", settings_options)
def calibrate(
    recording: Annotated[list[Path], typer.Argument(help="File, folder or session; with --urdf several.")],
    how: How,
    given: dict[str, Any],
    pages: ReportOptions,
    urdf_out: Annotated[
        Path | None, typer.Option(help="Write the calibrated URDF here.", rich_help_panel=CHAIN_PANEL)
    ] = None,
    tolerance_mm: Annotated[
        float | None, typer.Option(help="Status 3 where the offset may be off by more than this (95%).")
    ] = None,
    as_json: AsJson = None,
) -> None:
    """Calibrate a recording: offset, radii, axes, and how good they are.

    Status 3: refused, or the offset is told in part.
    """
    from carm_kin.calibration.by_settings import calibrate_as
    from carm_kin.calibration.settings import CHAIN, Settings, only_with_chain
    from carm_kin.results import summary
    from carm_kin.results.provenance import command_line

    check_place(as_json)
    pages.check()
    tolerance_m = above_zero("--tolerance-mm", tolerance_mm, 1e-3)
    settings = Settings(**given)
    settings.check(named)
    if urdf_out and settings.solver_name != CHAIN:
        raise only_with_chain("--urdf-out")
    urdf_out = writable(urdf_out) if urdf_out else None
    recordings = [how.read(path) for path in recording]
    result = calibrate_as(recordings, settings, command_line(sys.argv[1:]))
    if urdf_out and settings.urdf and result.chain:
        from carm_kin.calibration.chain.calibrated_urdf import calibrated_urdf
        from carm_kin.machine.urdf import read_urdf, write_urdf

        write_urdf(calibrated_urdf(read_urdf(settings.urdf), result.chain), urdf_out)
        written(urdf_out)
    deliver(result, as_json)
    joints = settings.angular or "angular", settings.orbital or "orbital"
    pages.write(result, recordings, joints if settings.solver_name == CHAIN else settings.joint_names(recordings[0]))
    summary.show(result, results(as_json, pages.page))
    warn(result.warnings)
    if result.refusal:
        raise RefusedError(result.refusal.code, result.refusal.message)
    if result.status == "partial":
        raise RefusedError("partial", f"not told: {'; '.join(result.observability.unobservable)}")
    if result.status == "doubtful":
        raise typer.Exit(ended(3, "doubtful", "the parts of the recording disagree (see the warning parts_disagree)"))
    within_m = result.offset_within_95_m
    if tolerance_m is not None and (within_m is None or within_m > tolerance_m):
        may = "has no known uncertainty" if within_m is None else f"may be off by {within_m * 1e3:.3g} mm (95%)"
        raise typer.Exit(ended(3, "not within tolerance", f"the offset {may}; the tolerance is {tolerance_mm:g} mm"))
