"""The main job in one word: simulate a clinical recording, calibrate it with every solver, compare."""

import time
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import solvers
from carm_kin import summary
from carm_kin.calibrate import calibrate
from carm_kin.errors import InputError
from carm_kin.formats import read_recording, write_recording
from carm_kin.recording import Recording
from carm_kin.result import CalibrationResult
from carm_kin.simulate import simulate

MACHINE = "mobile_nonisocentric"
SIGMA_T_M, SIGMA_R_RAD = 0.25e-3, float(np.radians(0.1))


def run(folder: Path, seed: int) -> None:
    """Write recording, truth and one result a solver into ``folder``; print what came out on stdout."""
    console = Console(highlight=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"the folder cannot be made: {error.strerror}", file=folder) from None
    simulated, truth = simulate(MACHINE, "clinical", sigma_t_m=SIGMA_T_M, sigma_r_rad=SIGMA_R_RAD, seed=seed)
    write_recording(simulated, folder / "recording.csv")
    truth.to_json(folder / "recording.truth.json")
    recording = read_recording(folder / "recording.csv")
    console.print(
        f"Simulated {len(recording)} poses of the C-arm '{MACHINE}' in eight sweeps, "
        f"noise {SIGMA_T_M * 1e3:.2f} mm and {np.degrees(SIGMA_R_RAD):.2f} deg an axis.\n"
    )
    table = Table(title="Errors against the truth, mm and deg", padding=(0, 1), box=box.SIMPLE)
    for column in ("solver", "offset", "its sigma", "R", "axis", "residual", "time"):
        table.add_column(column, no_wrap=True, justify="left" if column == "solver" else "right")
    for name in solvers.solver_names():
        result, seconds = _timed(recording, name)
        result.to_json(folder / f"{name}.json")
        table.add_row(name, *_errors(result, truth), f"{seconds * 1e3:.0f} ms")
    console.print(table)
    console.print("\nThe default solver, kinematic, says:")
    summary.show(calibrate(recording), console)
    console.print("\nThe truth:")
    summary.show(truth, console)
    console.print(f"\nRecording, truth and results are in {folder}/")
    console.print(f"Next: carm-kin calibrate {folder / 'recording.csv'}")


def _timed(recording: Recording, solver: str) -> tuple[CalibrationResult, float]:
    """The result and its time, imports and first-use set-up left out."""
    calibrate(recording, solver)
    start = time.perf_counter()
    result = calibrate(recording, solver)
    return result, time.perf_counter() - start


def _errors(result: CalibrationResult, truth: CalibrationResult) -> list[str]:
    """Cells of the table; a dash where the solver gives no such number."""
    offset, sigma = result.offset_sensor_pivot_m, result.sigma.offset_sensor_pivot_m
    axes = [r.placements[0].angular_axis_world if r.placements else None for r in (result, truth)]
    errors = [
        None if offset is None else np.linalg.norm(offset - truth.offset_sensor_pivot_m) * 1e3,
        None if sigma is None else np.linalg.norm(sigma) * 1e3,
        None if result.major_radius_m is None else (result.major_radius_m - (truth.major_radius_m or 0.0)) * 1e3,
        None if axes[0] is None else np.degrees(np.linalg.norm(np.cross(axes[0], axes[1]))),
        result.residuals.translation_rms_m * 1e3,
    ]
    return ["-" if error is None else f"{error:.4f}" for error in errors]
