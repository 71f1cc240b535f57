"""The figures of a comparison and of a study."""

from typing import TYPE_CHECKING, Any

import numpy as np

from carm_kin.report.static import COLOURS, figure
from carm_kin.results.result import CalibrationResult
from carm_kin.study.compare import Comparison
from carm_kin.study.compare_view import TRUTH, reference_of
from carm_kin.study.monte_carlo_result import Study
from carm_kin.study.monte_carlo_view import NUMBERS, Number, scaled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIGMAS = 2.0
"""Half the length of an error bar."""


def comparison_figure(comparison: Comparison, truth: CalibrationResult | None) -> "Figure":
    """Offset and major radius of every solver less those of the truth or the reference, held-out error and time."""
    results = {run.solver: run.result for run in comparison.runs if run.result}
    other = TRUTH if truth else reference_of(comparison)
    base = truth or results.get(other)
    drawn = figure(9, 6)
    panels = drawn.subplots(2, 2)
    for k, axis in enumerate("xyz"):
        _points(panels[0, 0], {n: _offset(r, base, k) for n, r in results.items()}, shift=0.2 * (1 - k), colour=k)
        panels[0, 0].plot([], [], "o-", color=COLOURS[k], label=axis)
    panels[0, 0].legend(frameon=False)
    _points(panels[0, 1], {name: _radius(result, base) for name, result in results.items()})
    held = {run.solver: run.held_out and run.held_out.translation_rms_m for run in comparison.runs}
    _points(panels[1, 0], {name: scaled(held[name], None, 1e3) for name in results})
    times = {run.solver: run.time_s for run in comparison.runs}
    _points(panels[1, 1], {name: scaled(times[name], None, 1e3) for name in results})
    less = f"less that of {'the truth' if truth else other}, mm, bars {SIGMAS:g} sigmas"
    titles = (f"offset {less}", f"major radius {less}")
    for panel in panels[0]:
        panel.axvline(0, color="#6b7280", linewidth=1)
    for panel, title in zip(panels.flat, (*titles, "held-out position error, RMS, mm", "time, ms"), strict=True):
        panel.set_title(title, loc="left", fontsize=9)
    return drawn


def study_figure(study: Study) -> "Figure":
    """Every number of every solver with its 95% interval, and the offset errors one by one."""
    drawn = figure(9, 9)
    panels = list(drawn.subplots(4, 2).flat)
    for panel, (title, of) in zip(panels, NUMBERS.items(), strict=False):
        _points(panel, {one.solver: of(one) for one in study.solvers})
        panel.set_title(f"{title}, 95% interval", loc="left", fontsize=9)
    last = panels[len(NUMBERS)]
    for k, (one, errors) in enumerate(zip(study.solvers, study.offset_errors_m, strict=True)):
        values = np.sort(np.array(errors)[np.isfinite(errors)]) * 1e3
        last.plot(values, (np.arange(len(values)) + 1) / max(len(values), 1), color=COLOURS[k], label=one.solver)
    last.set_title("share of runs with an offset error below, mm", loc="left", fontsize=9)
    last.grid(color="#d0d7de")
    last.legend(frameon=False)
    return drawn


def _points(panel: Any, numbers: dict[str, Number], shift: float = 0.0, colour: int | None = None) -> None:
    """A point for each name from the top down, with its interval; nothing where there is no number."""
    for k, (value, interval) in enumerate(numbers.values()):
        one = COLOURS[(k if colour is None else colour) % len(COLOURS)]
        if value is not None:
            panel.plot([value], [shift - k], "o", color=one, markersize=5)
        if interval is not None:
            panel.plot(interval, [shift - k] * 2, "-", color=one)
    panel.set_yticks([-k for k in range(len(numbers))], list(numbers))
    panel.set_ylim(-len(numbers) + 0.5, 0.5)
    panel.grid(axis="x", color="#d0d7de")


def _offset(result: CalibrationResult, base: CalibrationResult | None, k: int) -> Number:
    if base is None or result.offset_sensor_pivot_m is None or base.offset_sensor_pivot_m is None:
        return None, None
    sigma = result.sigma.offset_sensor_pivot_m
    return _bar(result.offset_sensor_pivot_m[k] - base.offset_sensor_pivot_m[k], None if sigma is None else sigma[k])


def _radius(result: CalibrationResult, base: CalibrationResult | None) -> Number:
    if base is None or result.major_radius_m is None or base.major_radius_m is None:
        return None, None
    return _bar(result.major_radius_m - base.major_radius_m, result.sigma.major_radius_m)


def _bar(value: float, sigma: float | None) -> Number:
    return scaled(value, None if sigma is None else (value - SIGMAS * sigma, value + SIGMAS * sigma), 1e3)
