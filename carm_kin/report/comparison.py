"""Several results side by side."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees

import numpy as np

from carm_kin.report.colours import SERIES, TRIAD
from carm_kin.report.marks import Axis, Chart, Line, Mark, Panel, Points
from carm_kin.report.poses import short
from carm_kin.report.words import number, with_sigma
from carm_kin.results.result import CalibrationResult, ResultLike, as_result
from carm_kin.results.shown import FIXED, only_determined
from solvers.se3 import Array

HEAD = (
    "solver",
    "offset x, mm",
    "y, mm",
    "z, mm",
    "major radius, mm",
    "non-orthogonality, deg",
    "residual, mm",
    "offset off, mm",
)
MOST_NAMES, MOST_LETTERS = 12, 16
"""Beside an axis, and of each of them."""
STEP = 0.18
"""Between the components of one result, of the distance between results."""


@dataclass(frozen=True)
class Cell:
    """A number and its standard deviation, if that is known."""

    value: str = "–"
    sigma: str = ""


@dataclass(frozen=True)
class Result:
    """One line of the table."""

    name: str
    cells: tuple[Cell, ...]
    refused: str = ""
    """Why it has no cells."""


@dataclass(frozen=True)
class Comparison:
    """What the page shows of it."""

    head: tuple[str, ...]
    lines: tuple[Result, ...]
    remark: str
    charts: tuple[Chart, ...]


def comparison_of(compared: Mapping[str, ResultLike], truth: ResultLike | None = None) -> Comparison:
    """Results by name, against the truth, or against their median where none is known."""
    results = {name: only_determined(as_result(result)) for name, result in compared.items()}
    reference = _reference(results, None if truth is None else as_result(truth))
    lines = tuple(_line(name, result, reference) for name, result in results.items())
    against = "the truth" if truth else "the median of the offsets here"
    remark = f"The last column is the distance of the offset from {against}. ± is one standard deviation."
    chart = offsets_chart(results, reference, against)
    return Comparison(HEAD, lines, remark, (chart,) if chart else ())


def _reference(results: Mapping[str, CalibrationResult], truth: CalibrationResult | None) -> Array | None:
    """(3,) the offset that the others are compared with, m."""
    if truth is not None:
        return truth.offset_sensor_pivot_m
    offsets = [r.offset_sensor_pivot_m for r in results.values() if r.offset_sensor_pivot_m is not None]
    return np.median(offsets, axis=0) if offsets else None


def _line(name: str, result: CalibrationResult, reference: Array | None) -> Result:
    if result.refusal:
        return Result(name, (), f"refused ({result.refusal.code}): {result.refusal.message}")
    offset, sigma = result.offset_sensor_pivot_m, result.sigma
    cells = [Cell()] * 3
    if offset is not None:
        deviations = _known(sigma.offset_sensor_pivot_m)
        cells = [_cell(x, deviation, 1e3) for x, deviation in zip(offset, deviations, strict=True)]
    off = None if offset is None or reference is None else float(np.linalg.norm(offset - reference)) * 1e3
    cells += [
        _held(result, "major_radius", _cell(result.major_radius_m, sigma.major_radius_m, 1e3)),
        _held(
            result,
            "axis_non_orthogonality",
            _cell(result.axis_non_orthogonality_rad, sigma.axis_non_orthogonality_rad, degrees(1)),
        ),
        _cell(result.residuals.translation_rms_m, None, 1e3),
        Cell() if off is None else Cell(number(off)),
    ]
    return Result(name, tuple(cells))


def _held(result: CalibrationResult, quantity: str, cell: Cell) -> Cell:
    """The cell, with a word where the quantity was not estimated."""
    return Cell(f"{cell.value} ({FIXED})") if quantity in result.fixed else cell


def _cell(value: float | None, sigma: float | None, unit: float) -> Cell:
    return Cell() if value is None else Cell(*with_sigma(value * unit, None if sigma is None else sigma * unit))


def offsets_chart(results: Mapping[str, CalibrationResult], reference: Array | None, against: str) -> Chart | None:
    """The offsets less a reference, component by component; None where there is nothing to show."""
    shown = {name: r for name, r in results.items() if r.offset_sensor_pivot_m is not None}
    if not shown or reference is None:
        return None
    places = np.arange(len(shown), dtype=float)
    off = np.array([r.offset_sensor_pivot_m for r in shown.values()]) - reference
    sigma = np.array([_known(r.sigma.offset_sensor_pivot_m) for r in shown.values()])
    marks: list[Mark] = [Line("", np.array([[-0.5, 0.0], [len(shown) - 0.5, 0.0]]), SERIES[-1], 1.0)]
    for k, (axis, colour) in enumerate(zip("xyz", TRIAD, strict=True)):
        at = np.stack([places + (k - 1) * STEP, off[:, k] * 1e3], axis=1)
        names = tuple(f"{short(name)}, {axis}" for name in shown)
        marks.append(Points(axis, at, colour, names, size=7, sigma=sigma[:, k] * 1e3))
    ticks = tuple(short(name, MOST_LETTERS) for name in shown) if len(shown) <= MOST_NAMES else ()
    x = Axis("", (-0.6, len(shown) - 0.4), ticks)
    caption = f"Offset less {against}, with one standard deviation where the solver gives it."
    panel = Panel(x, Axis("offset less reference, mm"), tuple(marks))
    return Chart("comparison_offset", "Offsets side by side", caption, (panel,))


def _known(sigma: Array | None) -> Array:
    return np.full(3, np.nan) if sigma is None else sigma
