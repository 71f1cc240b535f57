"""Draw the pictures of docs/deformation.md: python tools/draw_deformation.py docs

The errors in them are those of docs/deformation.csv. Where that file is missing, its 126 calibrations of simulated
recordings are made first, in about two minutes.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from bending_study import ARCS_DEG, SAGS_MM, Row, cases, measured, read, write

import carm_kin
from carm_kin.calibrated.rotation_centre import chain_at
from carm_kin.report.colours import AMOUNT
from carm_kin.report.marks import Map
from carm_kin.report.matplotlib_figures import draw_map
from carm_kin.report.static import figure, save
from carm_kin.results.deformation import Deformation
from solvers.se3 import Array

BLUE, ORANGE, GRID = "#1f6feb", "#c2410c", "#d0d7de"


def draw_errors(axes: Any, groups: dict[str, list[Row]], place: float, look: tuple[str, str], label: str) -> None:
    """A dot a calibration, and a bar at the mean of "off by at most (95%)"."""
    colour, mark = look
    for k, rows in enumerate(groups.values()):
        told = [row for row in rows if row.status != "refused"]
        x, most = k + place + np.linspace(-0.1, 0.1, len(told)), np.mean([row.within_95_mm for row in told])
        axes.plot(x, [row.error_mm for row in told], mark, color=colour, markersize=4, label="_" if k else label)
        axes.hlines(most, k + place - 0.15, k + place + 0.15, color=colour, linewidth=2.5)
    axes.set_xticks(range(len(groups)), list(groups))
    axes.set_xlim(-0.5, len(groups) - 0.5)
    axes.grid(axis="y", color=GRID, linewidth=0.5)


def draw_sags(rows: list[Row], path: Path) -> None:
    drawn = figure(8.5, 3.6)
    panels = drawn.subplots(1, 2, sharey=True)
    for axes, field, title in zip(panels, (0.0, 0.2), ("tracker without distortion", "0.2 mm"), strict=True):
        for k, (name, label) in enumerate({"none": "--systematic none", "auto": "as carm-kin does"}.items()):
            of_name = [row for row in rows if row.systematic == name]
            groups = {f"{s:g}": [row for row in of_name if row.recorded == (s, field, 180, 1)] for s in SAGS_MM}
            draw_errors(axes, groups, 0.36 * k - 0.18, ((ORANGE, "s"), (BLUE, "o"))[k], label)
        axes.set_xlabel("peak sag of the sensor, mm")
        axes.set_title(title if not field else f"tracker distorts by {title} (rms)", loc="left", fontsize=10)
    panels[0].set_ylabel("error of the offset, mm")
    panels[0].legend(fontsize=8, loc="upper left")
    panels[0].set_ylim(bottom=0)
    save(drawn, path)


def draw_recordings(rows: list[Row], path: Path) -> None:
    drawn, auto = figure(8.5, 3.4), [row for row in rows if row.systematic == "auto"]
    arcs = {
        f"{a} and {np.ptp(b)}": [row for row in auto if row.recorded == (2, 0.2, a, 1)] for a, b in ARCS_DEG.items()
    }
    moved = {f"{n}": [row for row in auto if row.recorded == (0, 0.3, 180, n)] for n in (1, 2, 3)}
    panels = drawn.subplots(1, 2)
    for axes, groups in zip(panels, (arcs, moved), strict=True):
        draw_errors(axes, groups, 0.0, (BLUE, "o"), "")
        axes.set_ylim(bottom=0)
    panels[0].set(xlabel="arcs of alpha and of beta, deg", ylabel="error of the offset, mm")
    panels[0].set_title("2 mm of sag, tracker distorts by 0.2 mm", loc="left", fontsize=10)
    panels[1].set_xlabel("placements of the base, 650 poses in all")
    panels[1].set_title("no sag, tracker distorts by 0.3 mm", loc="left", fontsize=10)
    save(drawn, path)


def draw_centre(path: Path) -> None:
    """The shift of the rotation centre of docs/deformation.md's machine over both angles, true and found."""
    noise: dict[str, Any] = {"sigma_t_m": 2e-4, "sigma_r_rad": float(np.radians(0.08)), "sag_m": 2e-3, "seed": 1}
    recording, truth = carm_kin.simulate("mobile_skewed", **noise)
    result = carm_kin.calibrate(recording)
    alpha, beta = np.linspace(-90, 90, 60), np.linspace(-40, 110, 60)
    drawn, grid = figure(8.5, 6.2), np.radians([np.repeat(alpha, 60), np.tile(beta, 60)])
    (top, bottom) = drawn.subplots(2, 2)
    mean_m = truth.offset_sensor_pivot_m
    assert mean_m is not None
    shifts = [np.linalg.norm(shift_mm(one, mean_m, grid), axis=1).reshape(60, 60) for one in (truth, result)]
    for axes, shift, name in zip(top, shifts, ("true", "found"), strict=True):
        draw_map(axes, Map(alpha, beta, shift, "mm", (0.0, float(np.max(shifts))), AMOUNT))
        axes.set_title(f"shift of the rotation centre, {name}", loc="left", fontsize=10)
        axes.set(xlabel="alpha, deg", ylabel="beta, deg", xticks=(-90, -45, 0, 45, 90), yticks=(-40, 0, 40, 80))
    draw_way(bottom[0], (truth, result), beta, np.array([np.full(60, 80.0), beta]))
    draw_way(bottom[1], (truth, result), alpha, np.array([alpha, np.full(60, 100.0)]))
    bottom[0].set(xlabel="beta, deg, at alpha 80 deg", ylabel="shift, mm", xticks=(-40, 0, 40, 80))
    bottom[1].set(xlabel="alpha, deg, at beta 100 deg", xticks=(-90, -45, 0, 45, 90))
    bottom[0].sharey(bottom[1])
    bottom[0].legend(fontsize=7)
    save(drawn, path)


def draw_way(axes: Any, pair: tuple[carm_kin.CalibrationResult, ...], x: Array, angles_deg: Array) -> None:
    """The way along x and z of the torus frame, true as a line, found dashed with one standard deviation about it."""
    mean_m = pair[0].offset_sensor_pivot_m
    assert mean_m is not None
    at, sigma = zip(*(way_mm(one, mean_m, np.radians(angles_deg)) for one in pair), strict=True)
    for k, colour, label in ((0, ORANGE, "along the angular axis"), (2, BLUE, "across it, z")):
        axes.fill_between(x, at[1][:, k] - sigma[1][:, k], at[1][:, k] + sigma[1][:, k], color=colour, alpha=0.15, lw=0)
        axes.plot(x, at[0][:, k], "-", color=colour, label=f"{label}: true")
        axes.plot(x, at[1][:, k], "--", color=colour, label="found, ±")
    axes.grid(color=GRID, linewidth=0.5)


def shift_mm(one: carm_kin.CalibrationResult, from_m: Array, angles: Array) -> Array:
    """(N, 3) of the rotation centre at angles (2, N) in the sensor's frame, from (3,)."""
    assert one.offset_sensor_pivot_m is not None
    return (one.offset_sensor_pivot_m - from_m + bent(one).shift_m(*angles)) * 1e3


def way_mm(one: carm_kin.CalibrationResult, from_m: Array, angles: Array) -> tuple[Array, Array]:
    """(N, 3) by which the rotation centre is off in the torus frame at angles (2, N), and one standard deviation."""
    torus = chain_at(one, None)
    R = torus.T_torus_carm(angles.T)[:, :3, :3] @ torus.T_sensor_carm[:3, :3].T
    moved = np.einsum("nij,nj->ni", R, shift_mm(one, from_m, angles))
    return moved, np.sqrt(np.einsum("nij,nj->ni", R**2, bent(one).sigma_m(*angles) ** 2)) * 1e3


def bent(one: carm_kin.CalibrationResult) -> Deformation:
    assert one.deformation is not None
    return one.deformation


def main(folder: Path) -> None:
    table = folder / "deformation.csv"
    if not table.exists():
        write([measured(case) for case in cases()], table)
    draw_centre(folder / "deformation_centre.svg")
    draw_sags(read(table), folder / "deformation_sag.svg")
    draw_recordings(read(table), folder / "deformation_recording.svg")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
