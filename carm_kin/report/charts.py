"""The flat figures: residuals, histograms, coverage. mm and degrees."""

import numpy as np

from carm_kin.report.circle import cut, span
from carm_kin.report.colours import EXPECTED, REJECTED, SERIES, TRIAD
from carm_kin.report.marks import Axis, Bars, Chart, Line, Mark, Panel, Points
from carm_kin.report.poses import Fit, Poses
from carm_kin.results.result import CalibrationResult
from solvers.problem import ANGULAR, ORBITAL
from solvers.se3 import Array

DIRECTIONS = "along the angular axis", "along the orbital axis", "along the common perpendicular"
MOST_BINS = 60
SIGMAS_SHOWN = 5.0
"""Least range of a residual panel, in standard deviations of the noise."""

_AGAINST = {
    "alpha": ("Residuals against α", "Residuals that follow α show a gantry that bends, or a biased tracker."),
    "beta": ("Residuals against β", "Residuals that follow β show a C that bends, or a biased tracker."),
    "pose": ("Residuals in the order of the poses", "A step shows a base or sensor that moved, a slope a drift."),
}
"""Name of a figure of residuals -> its title, and what it may show."""
_KINDS = {"position": (slice(0, 3), 1e3, "mm"), "rotation": (slice(3, 6), float(np.degrees(1)), "deg")}
"""Kind of a residual -> its columns, its unit in m or rad, the unit's name."""


def charts(result: CalibrationResult, poses: Poses) -> tuple[Chart, ...]:
    """All flat figures of a result; none where there is no fit."""
    if poses.fit is None:
        return ()
    fit = poses.fit
    alpha, beta = (_degrees(fit, poses, joint) for joint in (ANGULAR, ORBITAL))
    pose = poses.recording.pose_number.astype(float)
    return (
        _coverage(poses, alpha, beta),
        _residuals("alpha", Axis("α, deg"), alpha, result, poses),
        _residuals("beta", Axis("β, deg"), beta, result, poses),
        _residuals("pose", Axis("number of the pose"), pose, result, poses),
        *(_histogram(kind, result, poses, fit) for kind in _KINDS),
    )


def _degrees(fit: Fit, poses: Poses, joint: int) -> Array:
    """(N,) the angles of a joint, cut where there are fewest."""
    angle = fit.angles[:, joint]
    return np.degrees(cut(angle, *span(angle[poses.used])))


def _coverage(poses: Poses, alpha: Array, beta: Array) -> Chart:
    marks: list[Mark] = []
    at = np.stack([alpha, beta], axis=1)
    for group in poses.groups:
        drawn = group.member & poses.used & poses.shown
        if drawn.any():
            colour, words = tuple(poses.colour[drawn]), tuple(poses.words[drawn])
            marks.append(Points(group.name, at[drawn], colour, words, group.symbol, 5))
    drawn = ~poses.used & poses.shown
    if drawn.any():
        marks.append(Points("not used", at[drawn], REJECTED, tuple(poses.words[drawn]), "cross", 6))
    ranges = (
        f"{name} from {values[poses.used].min():.1f} to {values[poses.used].max():.1f} deg"
        for name, values in (("α", alpha), ("β", beta))
    )
    panel = Panel(Axis("α, deg"), Axis("β, deg"), tuple(marks))
    caption = f"The angles of the used poses: {', '.join(ranges)}. Wide arcs about both axes give a small uncertainty."
    return Chart("coverage", "Coverage of the two angles", caption, (panel,))


def _residuals(name: str, x: Axis, at: Array, result: CalibrationResult, poses: Poses) -> Chart:
    fit = poses.fit
    assert fit is not None
    noise = result.noise.translation_m, result.noise.rotation_rad
    panels = []
    for (kind, (columns, unit, unit_name)), sigma in zip(_KINDS.items(), noise, strict=True):
        values = fit.residual[:, columns] * unit
        limit = _limit(values[poses.used], (sigma or 0.0) * unit)
        marks = _components(poses, at, values, limit) + _band(at, (sigma or 0.0) * unit)
        panels.append(Panel(x, Axis(f"{kind}, {unit_name}", (-limit, limit)), tuple(marks)))
    title, hint = _AGAINST[name]
    every = "" if poses.sampled.all() else f" {poses.sampled.sum()} of {len(poses.sampled)} poses are drawn."
    return Chart(f"residuals_{name}", title, f"Recorded less fitted pose. {hint}{every}", tuple(panels))


def _limit(values: Array, sigma: float) -> float:
    return float(max(1.08 * np.abs(values).max(initial=0.0), SIGMAS_SHOWN * sigma, 1e-9))


def _components(poses: Poses, at: Array, values: Array, limit: float) -> list[Mark]:
    """The three components of the used poses, and the others, at the edge where they lie beyond it."""
    marks: list[Mark] = []
    drawn = poses.used & poses.sampled
    for column, (name, colour) in enumerate(zip(DIRECTIONS, TRIAD, strict=True)):
        points = np.stack([at[drawn], values[drawn, column]], axis=1)
        marks.append(Points(name, points, colour, tuple(poses.words[drawn]), size=3.2))
    off = ~poses.used & poses.sampled
    if off.any():
        worst = np.take_along_axis(values[off], np.abs(values[off]).argmax(axis=1)[:, None], axis=1)[:, 0]
        words = tuple(f"{text}: {value:.4g}" for text, value in zip(poses.words[off], worst, strict=True))
        edge = np.clip(worst, -0.97 * limit, 0.97 * limit)
        marks.append(
            Points("not used (at the edge if beyond it)", np.stack([at[off], edge], 1), REJECTED, words, "cross", 6)
        )
    return marks


def _band(at: Array, sigma: float) -> list[Mark]:
    """One standard deviation of the noise, either way."""
    ends = np.array([np.nanmin(at), np.nanmax(at)])
    name = "noise an axis, one standard deviation"
    sides = (np.stack([ends, np.full(2, side)], axis=1) for side in (-sigma, sigma))
    return [Line(name, at, EXPECTED, 2.0, dashed=True) for at in sides]


def _histogram(kind: str, result: CalibrationResult, poses: Poses, fit: Fit) -> Chart:
    columns, unit, name = _KINDS[kind]
    values = (fit.residual[poses.used, columns] * unit).ravel()
    expected = (fit.expected[poses.used, columns] * unit).ravel()
    bins = int(np.clip(np.sqrt(len(values)), 8, MOST_BINS))
    reach = _limit(values, 3 * float(expected.max(initial=0.0)) / SIGMAS_SHOWN)
    edges = np.linspace(-reach, reach, bins + 1)
    density = np.histogram(values, edges)[0] / (len(values) * np.diff(edges))
    grid = np.linspace(-reach, reach, 301)
    curve = np.stack([grid, _mixture(grid, expected)], axis=1)
    marks = (
        Bars("residuals, three components", edges, density, SERIES[0]),
        Line("expected from the noise", curve, EXPECTED, 2.5),
    )
    panel = Panel(Axis(f"{kind} residual, {name}"), Axis(f"density, 1/{name}"), marks)
    noise = (result.noise.translation_m, result.noise.rotation_rad)[kind == "rotation"] or 0.0
    given = "estimated" if result.noise.estimated else "given"
    caption = (
        f"The curve is what normal noise of {noise * unit:.3f} {name} an axis ({given}) leaves of these poses once "
        "their unknown angles are fitted. Bars that stand wider than it mean that the model or the noise is wrong."
    )
    return Chart(f"histogram_{kind}", f"Distribution of the {kind} residuals", caption, (panel,))


def _mixture(grid: Array, sigma: Array) -> Array:
    """Density at ``grid`` of residuals with the standard deviations ``sigma`` (K,); those that are 0 are spikes."""
    some = sigma[:: max(1, len(sigma) // 2000)]
    some = some[some > 1e-3 * sigma.max(initial=1e-12)]
    z = grid[:, None] / some
    density = np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * some)
    return density.sum(axis=1) / max(len(sigma[:: max(1, len(sigma) // 2000)]), 1)
