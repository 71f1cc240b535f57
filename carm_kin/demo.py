"""The main job in one word: simulate a clinical recording, calibrate it with every solver, compare."""

import time
from pathlib import Path

import numpy as np
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
    table = Table(
        "solver", "offset error", "R error", "axis error", "sigma of offset", "residual", "time", title="Errors against the truth"
    )
    for name in solvers.solver_names():
        result, seconds = _timed(recording, name)
        result.to_json(folder / f"{name}.json")
        table.add_row(name, *_errors(result, truth), f"{seconds * 1e3:.0f} ms")
    console.print(table)
    console.print("\nThe default solver, kinematic, says:")
    summary.show(calibrate(recording), console)
    x, y, z = truth.offset_sensor_pivot_m * 1e3 if truth.offset_sensor_pivot_m is not None else (0, 0, 0)
    console.print(f"truth: offset ({x:.3f}, {y:.3f}, {z:.3f}) mm, major radius {(truth.major_radius_m or 0) * 1e3:.3f} mm")
    console.print(f"\nRecording, truth and results are in {folder}/")
    console.print(f"Next: carm-kin calibrate {folder / 'recording.csv'}")


def _timed(recording: Recording, solver: str) -> tuple[CalibrationResult, float]:
    """The result and its time, imports and first-use set-up left out."""
    calibrate(recording, solver)
    start = time.perf_counter()
    result = calibrate(recording, solver)
    return result, time.perf_counter() - start


def _errors(result: CalibrationResult, truth: CalibrationResult) -> list[str]:
    cells = []
    offset, true_offset = result.offset_sensor_pivot_m, truth.offset_sensor_pivot_m
    missing = offset is None or true_offset is None
    cells.append("not given" if missing else f"{np.linalg.norm(offset - true_offset) * 1e3:.3f} mm")
    radius = (result.major_radius_m or 0.0) - (truth.major_radius_m or 0.0)
    cells.append(f"{radius * 1e3:+.3f} mm")
    axes = [r.placements[0].angular_axis_world if r.placements else None for r in (result, truth)]
    known = axes[0] is not None and axes[1] is not None
    cells.append(f"{np.degrees(np.linalg.norm(np.cross(*axes))):.4f} deg" if known else "not given")
    sigma = result.sigma.offset_sensor_pivot_m
    cells.append("not given" if sigma is None else f"{np.linalg.norm(sigma) * 1e3:.3f} mm")
    cells.append(f"{result.residuals.translation_rms_m * 1e3:.3f} mm")
    return cells
