"""The wander of the rotation centre over both angles: numbers, words and maps."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carm_kin.calibrated.isocentre import isocentre
from carm_kin.report import static
from carm_kin.report.colours import AMOUNT, SIGNED
from carm_kin.report.marks import Axis, Chart, Map, Panel
from carm_kin.report.matplotlib_figures import draw_map
from carm_kin.report.words import Row, with_sigma
from carm_kin.results.deformation import Deformation
from carm_kin.results.isocentre_result import Ball, Isocentre
from carm_kin.results.result import CalibrationResult

STEPS = 60
"""Angles of a joint at which a map is drawn."""
ALPHA, BETA = Axis("α, deg"), Axis("β, deg")
BALLS = {
    "both": "Smallest ball, over both axes",
    "angular": "Over the angular axis alone",
    "orbital": "Over the orbital axis alone",
}


@dataclass(frozen=True, eq=False)
class Wander:
    """What a page shows of it."""

    rows: tuple[Row, ...]
    words: tuple[str, ...]
    charts: tuple[Chart, ...]


def wander_of(result: CalibrationResult) -> Wander | None:
    """None where the calibration found no deformation of the C."""
    if result.deformation is None:
        return None
    found = isocentre(result, placement=result.placements[0].label)
    rows = {ball.axis: _row(ball) for ball in found.balls}
    return Wander(tuple(rows[axis] for axis in BALLS), found.walks, _charts(result.deformation))


def _row(ball: Ball) -> Row:
    diameter, sigma = with_sigma(ball.diameter_m * 1e3, ball.sigma_m * 1e3)
    circle = f"{ball.diameter_with_circle_m * 1e3:.2f} mm with the circle of the major radius"
    return Row(BALLS[ball.axis], (diameter,), (sigma,) if sigma else (), "mm", circle)


def _charts(bent: Deformation) -> tuple[Chart, ...]:
    sigma_mm = float(np.linalg.norm(bent.sigma_m(*_middle(bent)))) * 1e3
    whole = (
        "How far the rotation centre lies from the offset above, in the sensor's frame, over the calibrated angles. "
        f"Its ± in their middle is {sigma_mm:.2g} mm, all axes together."
    )
    captions = {"length": whole} | {axis: f"Along {axis} of the sensor." for axis in "xyz"}
    return tuple(
        Chart(
            f"isocentre_{name}",
            f"Shift of the rotation centre: {name}",
            captions[name],
            (Panel(ALPHA, BETA, (drawn,)),),
        )
        for name, drawn in _maps(bent).items()
    )


def _middle(bent: Deformation) -> tuple[np.ndarray, np.ndarray]:
    return np.array([np.mean(bent.alpha_range_rad)]), np.array([np.mean(bent.beta_range_rad)])


def _maps(bent: Deformation) -> dict[str, Map]:
    """The length of the shift and its components in the sensor's frame, mm, by name."""
    alpha, beta = (np.linspace(x[0], x[1], STEPS) for x in (bent.alpha_range_rad, bent.beta_range_rad))
    shift_mm = (bent.shift_m(np.repeat(alpha, STEPS), np.tile(beta, STEPS)) * 1e3).reshape(STEPS, STEPS, 3)
    length = np.linalg.norm(shift_mm, axis=2)
    x, y, most = np.degrees(alpha), np.degrees(beta), max(float(length.max()), 1e-6)
    maps = {"length": Map(x, y, length, "mm", (0.0, most), AMOUNT)}
    return maps | {name: Map(x, y, shift_mm[..., k], "mm", (-most, most), SIGNED) for k, name in enumerate("xyz")}


def draw_isocentre(found: Isocentre, path: Path) -> None:
    """Draw the shift of the rotation centre in the sensor's frame over the calibrated range: its length and components.

    Raises InputError for another extension than those of `static.FORMATS`, MissingDependencyError without matplotlib.
    """
    static.check_figure(path)
    assert found.deformation is not None
    drawn = static.figure(7.0, 5.6)
    panels = drawn.subplots(2, 2, sharex=True, sharey=True)
    for panel, (name, shift) in zip(np.ravel(panels), _maps(found.deformation).items(), strict=True):
        draw_map(panel, shift)
        panel.set_title(f"shift, {name}", fontsize=9)
        panel.set(xlabel=ALPHA.title, ylabel=BETA.title)
        panel.label_outer()
    static.save(drawn, path)
