"""The experiments' figures in the paper's layout, the published curves beside ours."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from carm_kin.report.static import figure, save
from carm_kin.study import published
from carm_kin.study.experiment_page import TITLES, Point, points
from carm_kin.study.experiments import DEG, MM, SOLVERS, Outcome

COLOURS: dict[str, str] = dict(zip(SOLVERS, ("#0b6e4f", "#1f6feb", "#c2410c", "#9333ea"), strict=True))
PANELS = {
    "noise.svg": ("noise_translation", "noise_rotation"),
    "trajectories.svg": ("trajectories_orbital", "trajectories_angular"),
    "density.svg": ("density",),
}
"""File -> the experiments in its columns."""


def draw(found: Sequence[Outcome], folder: Path) -> dict[str, str]:
    """Draw the figures of the experiments that were run; experiment -> file name."""
    drawn = {}
    for name, experiments in PANELS.items():
        rows = {e: points(found, e) for e in experiments}
        if any(rows.values()):
            _figure(folder / name, {e: r for e, r in rows.items() if r})
            drawn[next(e for e in experiments if rows[e])] = name
    return drawn


def _figure(path: Path, columns: dict[str, list[Point]]) -> None:
    """The offset's error above, the frame's orientation below."""
    drawn = figure(5.2 * len(columns) + 1.6, 6.4)
    axes = np.reshape(drawn.subplots(2, len(columns)), (2, len(columns)))
    for k, (experiment, rows) in enumerate(columns.items()):
        x = [row.value for row in rows]
        for name in SOLVERS:
            _line(axes[0, k], x, [row.t_rms_m[name] / MM for row in rows], name)
            _line(axes[1, k], x, [row.turn_rms_rad[name] / DEG for row in rows], name)
        axes[0, k].plot(x, [row.bound_m / MM for row in rows], ":", color="black", label="Cramér-Rao bound")
        for ax, quantity in ((axes[0, k], "t_error_mm"), (axes[1, k], "orientation_error_deg")):
            curve = published.curve(experiment, quantity)
            ax.plot(curve.abscissa, curve.value, "s--", color="#6b7280", markersize=3, label="published")
            ax.set_yscale("log")
            ax.set_ylim(bottom=1e-3 if quantity == "t_error_mm" else 1e-4)
            ax.grid(color="#d0d7de", linewidth=0.5)
            if experiment == "density":
                ax.set_xscale("log")
        axes[0, k].set_title(TITLES[experiment][1], fontsize=10)
        axes[1, k].set_xlabel(TITLES[experiment][0])
    axes[0, 0].set_ylabel("error of the offset, RMS, mm")
    axes[1, 0].set_ylabel("error of the frame, RMS, deg")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
    save(drawn, path)


def _line(ax, x: list[float], y: list[float], name: str) -> None:
    ax.plot(x, y, "o-", color=COLOURS[name], markersize=3, linewidth=1, label=name)
