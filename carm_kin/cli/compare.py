"""The command `carm-kin compare`: solvers on one recording, or over a study of simulated ones."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import carm_kin
from carm_kin.cli.arguments import writable
from carm_kin.cli.names import Naming
from carm_kin.cli.options import grouped
from carm_kin.cli.output import check_place, deliver, results, written
from carm_kin.cli.terminal import Stderr
from carm_kin.errors import InputError, RefusedError
from carm_kin.files import write_atomically

if TYPE_CHECKING:
    from rich.console import Console

    from carm_kin.calibration.settings import Settings
    from carm_kin.recording.recording import Recording
    from carm_kin.results.result import CalibrationResult
    from carm_kin.results.rows import Cell
    from carm_kin.study.compare import Comparison
    from carm_kin.study.monte_carlo_result import Study

STUDY = "A study of simulated recordings: --repeat, --urdf, and"
STUDIED = ("direct", "decomposed")
"""What a study compares by default."""


def register(app: typer.Typer) -> None:
    """Add the command."""
    example = "carm-kin compare --repeat 100 --urdf mobile_nonisocentric --sigma-t-mm 1 --solvers direct,decomposed"
    app.command(cls=Naming, epilog=f"Example: carm-kin compare rec.csv --figure rec.svg; or {example}")(compare)


@dataclass(frozen=True)
class Simulated:
    """What is simulated for a study; nothing where ``repeat`` is None."""

    repeat: int | None
    protocol: str
    sigma_t_m: float
    sigma_r_rad: float
    outliers: float
    seed: int
    jobs: int


def simulated(
    repeat: Annotated[int | None, typer.Option(help="How many recordings to simulate.", rich_help_panel=STUDY)] = None,
    protocol: Annotated[str, typer.Option(help="As of carm-kin simulate.", rich_help_panel=STUDY)] = "clinical",
    sigma_t_mm: Annotated[float, typer.Option(min=0, help="Position noise.", rich_help_panel=STUDY)] = 0.0,
    sigma_r_deg: Annotated[float, typer.Option(min=0, help="Orientation noise.", rich_help_panel=STUDY)] = 0.0,
    outliers: Annotated[float, typer.Option(help="Share of gross outliers.", rich_help_panel=STUDY)] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first recording.", rich_help_panel=STUDY)] = 0,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.", rich_help_panel=STUDY)] = 1,
) -> Simulated:
    """What was asked for. Raises InputError where there is no study that it could belong to."""
    found = Simulated(repeat, protocol, sigma_t_mm / 1e3, radians(sigma_r_deg), outliers, seed, jobs)
    if repeat is None and found != Simulated(None, "clinical", 0.0, 0.0, 0.0, 0, 1):
        raise InputError("--protocol, --sigma-..., --outliers, --seed and --jobs are of a study: --repeat is missing")
    return found


@dataclass(frozen=True)
class Outputs:
    """Where what comes out goes."""

    json: str | None
    csv: Path | None
    figure: Path | None
    report: Path | None

    def console(self) -> "Console":
        """Where the tables are read."""
        return results(self.json, self.csv, self.report)


def outputs(
    as_json: Annotated[str | None, typer.Option("--json", help="Write everything here; - for stdout.")] = None,
    as_csv: Annotated[Path | None, typer.Option("--csv", help="Write the table here.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Draw here: .svg, .png or .pdf.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write a page about one recording here, one HTML file.")] = None,
) -> Outputs:
    """The places, checked before the work starts."""
    check_place(as_json)
    if figure is not None:
        from carm_kin.report.static import check_figure

        check_figure(writable(figure))
    return Outputs(as_json, writable(as_csv) if as_csv else None, figure, writable(report) if report else None)


@grouped("simulation", simulated)
@grouped("output", outputs)
def compare(
    simulation: Simulated,
    output: Outputs,
    recording: Annotated[Path | None, typer.Argument(help="The recording; left out with --repeat.")] = None,
    solvers: Annotated[
        str | None, typer.Option(help="Comma between; by default all that are possible: {solvers}; chain with --urdf.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="The true result; by default NAME.truth.json beside the recording.")
    ] = None,
    urdf: Annotated[str | None, typer.Option(help="The machine: joint names, and the solver chain.")] = None,
    angular: Annotated[str | None, typer.Option(help="Name of the angular joint.")] = None,
    orbital: Annotated[str | None, typer.Option(help="Name of the orbital joint.")] = None,
    sensor_link: Annotated[str | None, typer.Option(help="Link that carries the sensor.")] = None,
    folds: Annotated[int, typer.Option(help="Number of held-out parts; 0 for no such check.")] = 5,
    all_poses: Annotated[
        bool, typer.Option("--all-poses", help="Also those that the solver kinematic takes for outliers.")
    ] = False,
) -> None:
    """Compare the solvers on the same poses: offset, radii, axes, residuals, held-out errors, time."""
    from carm_kin.calibration.settings import Settings

    names = [name.strip() for name in solvers.split(",")] if solvers else None
    settings = Settings(urdf=urdf, angular=angular, orbital=orbital, sensor_link=sensor_link)
    if simulation.repeat is not None:
        if recording is not None or truth is not None or output.report is not None:
            raise InputError("--repeat simulates recordings: leave out the recording, --truth and --report")
        _study(simulation, names or STUDIED, settings, output)
    elif recording is None:
        raise InputError("a recording is missing, or --repeat with --urdf for a study")
    else:
        _recording(recording, names, settings, truth, folds, all_poses, output)


def _recording(
    path: Path,
    names: Sequence[str] | None,
    settings: "Settings",
    truth: Path | None,
    folds: int,
    all_poses: bool,
    output: Outputs,
) -> None:
    from carm_kin.results.provenance import command_line
    from carm_kin.study import compare_figures, compare_view
    from carm_kin.study.compare import agreement
    from carm_kin.study.compare import compare as compared

    console, whole = output.console(), carm_kin.read_recording(path)
    beside = path.with_suffix(".truth.json")
    file = truth or (beside if beside.is_file() else None)
    true = carm_kin.CalibrationResult.from_json(file) if file else None
    together = agreement(whole, settings)
    recording = whole if all_poses else whole.select(together)
    left_out = len(whole) - len(recording)
    found = compared(
        recording,
        names,
        settings=settings,
        counted=together if all_poses else None,
        truth=true,
        folds=folds or None,
        command=command_line(sys.argv[1:]),
    )
    draw = compare_figures.comparison_figure
    _deliver(found, compare_view.rows_of(found), lambda: draw(found, true), output)
    if output.report:
        _report(found, recording, true, output.report)
    console.print(f"{len(recording)} poses, the same for every solver; {left_out} left out that disagree")
    for table in compare_view.tables(found):
        console.print(table)
    for line in compare_view.remarks(found):
        console.print(line, soft_wrap=True)
    if not any(run.result for run in found.runs):
        raise RefusedError("no_result", "no solver has a result")


def _report(found: "Comparison", recording: "Recording", truth: "CalibrationResult | None", page: Path) -> None:
    """The page of the first solver that draws the machine, the others compared on it."""
    from carm_kin.report import write_report

    calibrated = {run.solver: run.result for run in found.runs if run.result is not None}
    if calibrated:
        first = calibrated.get("kinematic") or next(iter(calibrated.values()))
        write_report(first, recording, page, compared=calibrated, truth=truth)
        written(page)


def _study(simulation: Simulated, names: Sequence[str], settings: "Settings", output: Outputs) -> None:
    from carm_kin.batches.local_workers import LocalWorkers
    from carm_kin.cli.progress import progress
    from carm_kin.results.provenance import command_line
    from carm_kin.study import compare_figures
    from carm_kin.study import monte_carlo_view as study_view
    from carm_kin.study.monte_carlo import Simulation, study

    if settings.urdf is None:
        raise InputError("--repeat needs --urdf: the machine to simulate")
    assert simulation.repeat is not None
    chosen = Simulation(
        settings.urdf,
        simulation.protocol,
        simulation.sigma_t_m,
        simulation.sigma_r_rad,
        simulation.outliers,
        angular=settings.angular,
        orbital=settings.orbital,
        sensor_link=settings.sensor_link,
    )
    console = output.console()
    with progress(Stderr(), "simulating", 0, simulation.repeat) as step:
        found = study(
            chosen,
            names,
            simulation.repeat,
            LocalWorkers(simulation.jobs),
            seed=simulation.seed,
            command=command_line(sys.argv[1:]),
            told=lambda words: step(words, False),
        )
    _deliver(found, study_view.study_rows(found), lambda: compare_figures.study_figure(found), output)
    for table in study_view.study_tables(found):
        console.print(table)
    for one in found.solvers:
        if one.first_reason:
            console.print(
                f"{one.solver}: {one.refused} of {one.runs} without a result: {one.first_reason}", soft_wrap=True
            )


def _deliver(found: "Comparison | Study", rows: "list[dict[str, Cell]]", draw: Any, output: Outputs) -> None:
    """Write what was asked for."""
    deliver(found, output.json)
    if output.csv is not None:
        from carm_kin.results.rows import csv_text

        write_atomically(output.csv, csv_text(rows))
        written(output.csv)
    if output.figure is not None:
        from carm_kin.report.static import save

        save(draw(), output.figure)
        written(output.figure)
