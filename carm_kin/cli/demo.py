"""The main job in one word: simulate a clinical recording, calibrate it with every solver, compare."""

import shlex
import time
from pathlib import Path

import numpy as np
from rich import box
from rich.table import Table

import solvers
from carm_kin.calibration.calibrate import calibrate
from carm_kin.cli.output import warn, written
from carm_kin.cli.report import ReportOptions
from carm_kin.cli.terminal import Stderr, Stdout
from carm_kin.errors import InputError
from carm_kin.recording.formats import read_recording, write_recording
from carm_kin.recording.recording import Recording
from carm_kin.results import summary
from carm_kin.results.result import CalibrationResult
from carm_kin.simulation.simulate import simulate
from solvers.se3 import Array

MACHINE = "mobile_nonisocentric"
SIGMA_T_M, SIGMA_R_RAD = 0.25e-3, float(np.radians(0.1))


def run(folder: Path, seed: int, pages: ReportOptions = ReportOptions(None, None)) -> None:
    """Write recording, truth and one result a solver into ``folder``, and the ``pages``; print what came out.

    Raises InputError where the folder cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"the folder cannot be made: {error.strerror}", file=folder) from None
    pages.check()
    console = Stdout()
    simulated, truth = simulate(MACHINE, "clinical", sigma_t_m=SIGMA_T_M, sigma_r_rad=SIGMA_R_RAD, seed=seed)
    write_recording(simulated, folder / "recording.csv")
    written(folder / "recording.csv")
    truth.to_json(folder / "recording.truth.json")
    written(folder / "recording.truth.json", "the truth")
    recording = read_recording(folder / "recording.csv")
    console.print(
        f"{len(recording)} poses of the C-arm '{MACHINE}' in {len(recording.sweeps)} sweeps,\n"
        f"noise {SIGMA_T_M * 1e3:.2f} mm and {np.degrees(SIGMA_R_RAD):.2f} deg an axis.\n",
    )
    table = Table(title="Errors against the truth (mm, deg)", title_justify="left", box=box.SIMPLE, pad_edge=False)
    for column in ("solver", "offset", "its sigma", "major radius", "axis", "residual", "time"):
        table.add_column(column, no_wrap=True, justify="left" if column == "solver" else "right")
    results = {}
    for name in solvers.solver_names():
        try:
            results[name], seconds = _timed(recording, name)
        except InputError as error:
            console.print(f"{name}: {error}", soft_wrap=True)
            continue
        results[name].to_json(folder / f"{name}.json")
        written(folder / f"{name}.json")
        table.add_row(name, *_errors(results[name], truth), f"{seconds * 1e3:.0f} ms")
    console.print(table)
    console.print("The default solver says:")
    summary.show(results["kinematic"], console)
    warn(results["kinematic"].warnings)
    console.print("\nThe truth is:")
    summary.show_numbers(truth, console)
    pages.write(results["kinematic"], [recording], compared=results, truth=truth)
    Stderr().print(f"Next: carm-kin calibrate {shlex.quote(str(folder / 'recording.csv'))}", soft_wrap=True)


def _timed(recording: Recording, solver: str) -> tuple[CalibrationResult, float]:
    """The result and its time, imports and first-use set-up left out."""
    calibrate(recording, solver)
    start = time.perf_counter()
    result = calibrate(recording, solver)
    return result, time.perf_counter() - start


def _errors(result: CalibrationResult, truth: CalibrationResult) -> list[str]:
    """Cells of the table; a dash where the solver gives no such number."""
    errors = [
        _distance(result.offset_sensor_pivot_m, truth.offset_sensor_pivot_m),
        _distance(result.sigma.offset_sensor_pivot_m, np.zeros(3)),
        _distance(result.major_radius_m, truth.major_radius_m),
        _angle_deg(_axis(result), _axis(truth)),
        result.residuals.translation_rms_m * 1e3,
    ]
    return ["-" if error is None else f"{error:.4f}" for error in errors]


def _axis(result: CalibrationResult) -> Array | None:
    return result.placements[0].angular_axis_world if result.placements else None


def _distance(one: Array | float | None, other: Array | float | None) -> float | None:
    """In mm."""
    return None if one is None or other is None else float(np.linalg.norm(np.subtract(one, other))) * 1e3


def _angle_deg(one: Array | None, other: Array | None) -> float | None:
    """Between two unit vectors whose senses do not matter."""
    return None if one is None or other is None else float(np.degrees(np.linalg.norm(np.cross(one, other))))
