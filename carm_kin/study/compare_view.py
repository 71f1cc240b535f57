"""A comparison of solvers as tables for the terminal, as text, and as rows of a CSV file."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from carm_kin.errors import printable
from carm_kin.results.differences import MAJOR_RADIUS, MINOR_RADIUS, OFFSET, ORBITAL_AXIS, Difference
from carm_kin.results.result import CalibrationResult
from carm_kin.results.rows import Cell, cells
from carm_kin.results.shown import FIXED, only_determined

if TYPE_CHECKING:
    from carm_kin.study.compare import Comparison, Run

NONE = "-"
TRUTH = "truth"
REFERENCE = "kinematic"
"""The solver by which poses that disagree are told, and beside which the others are shown."""
WIDE = 10_000
"""Columns at which no table is cut."""


@dataclass(frozen=True)
class Apart:
    """How far a solver is from another, or from the truth."""

    difference: Difference
    own: float | None
    """In standard deviations of the solver."""
    other: float | None
    """In those of the other."""


def reference_of(comparison: "Comparison") -> str:
    """The solver beside which the others are shown."""
    good = [run.solver for run in comparison.runs if run.result]
    return REFERENCE if REFERENCE in good or not good else good[0]


def apart_from(comparison: "Comparison", other: str) -> dict[str, dict[str, Apart]]:
    """Solver -> quantity -> how far it is from ``other``: a solver, or the truth."""
    found: dict[str, dict[str, Apart]] = {}
    for d in comparison.differences:
        if d.second == other:
            found.setdefault(d.first, {})[d.quantity] = Apart(d, d.sigmas_of_first, d.sigmas_of_second)
        elif d.first == other and d.second != TRUTH:
            found.setdefault(d.second, {})[d.quantity] = Apart(d, d.sigmas_of_second, d.sigmas_of_first)
    return found


def tables(comparison: "Comparison") -> list[Table]:
    """Numbers, axes, quality, and the differences to the reference and to the truth."""
    reference = reference_of(comparison)
    results = {run.solver: only_determined(run.result) for run in comparison.runs if run.result}
    found = [_numbers(results), _axes(results), _quality(comparison.runs)]
    found.append(_differences(f"Difference to {reference}", f"sigmas, own and {reference}'s", comparison, reference))
    found.append(_differences("Error", "in own sigmas", comparison, TRUTH))
    return [table for table in found if table.row_count]


def remarks(comparison: "Comparison") -> list[str]:
    """Below the tables: which poses count, and why a solver has no answer or no errors."""
    found = []
    if comparison.counted < comparison.poses:
        found.append(f"residuals and held-out errors are of the {comparison.counted} poses that agree")
    for run in comparison.runs:
        if run.reason:
            found.append(f"{run.solver}: {run.reason.message}")
        if run.errors_reason:
            found.append(f"{run.solver}: no errors of poses: {run.errors_reason}")
    return found


def text_of(comparison: "Comparison") -> str:
    """The tables and remarks, without colour."""
    file = io.StringIO()
    console = Console(file=file, width=WIDE, highlight=False, markup=False, emoji=False)
    for table in tables(comparison):
        console.print(table)
    lines = [line.rstrip() for line in file.getvalue().splitlines()]
    return "\n".join((*lines, *map(printable, remarks(comparison))))


def rows_of(comparison: "Comparison") -> list[dict[str, Cell]]:
    """A row for each solver: its numbers, quality, and errors where the truth is known."""
    errors = apart_from(comparison, TRUTH)
    return [_row(run, errors.get(run.solver, {})) for run in comparison.runs]


def empty_table(title: str, *columns: str) -> Table:
    """A table without rows, all but its first column to the right."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE, pad_edge=False)
    for k, name in enumerate(columns):
        table.add_column(name, no_wrap=True, justify="left" if k == 0 else "right")
    return table


def _numbers(results: dict[str, CalibrationResult]) -> Table:
    table = empty_table("Offset and radii, mm; non-orthogonality, deg", "solver", "x", "y", "z", "R", "minor", "skew")
    for name, result in results.items():
        offset = [None] * 3 if result.offset_sensor_pivot_m is None else result.offset_sensor_pivot_m
        lengths = (*offset, result.major_radius_m, result.minor_radius_m)
        *xyz, major, minor = map(_mm, lengths)
        held = dict.fromkeys(result.fixed, f" ({FIXED})")
        skew = _deg(result.axis_non_orthogonality_rad) + held.get("axis_non_orthogonality", "")
        table.add_row(name, *xyz, major + held.get("major_radius", ""), minor + held.get("minor_radius", ""), skew)
    return table


def _axes(results: dict[str, CalibrationResult]) -> Table:
    table = empty_table("Axes", "solver", "orbital, in the sensor", "angular, in the world")
    for name, result in results.items():
        angular = result.placements[0].angular_axis_world if result.placements else None
        shown = (NONE if u is None else " ".join(f"{x:+.5f}" for x in u) for u in (result.orbital_axis_sensor, angular))
        table.add_row(name, *shown)
    return table


def _quality(runs: "Sequence[Run]") -> Table:
    names = ("used", "residual mm", "deg", "held out mm", "deg", "time ms")
    table = empty_table("Residuals, held-out pose errors, time", "solver", *names)
    for run in runs:
        if run.result is None:
            continue
        fitted, held = run.fitted, run.held_out
        table.add_row(
            run.solver,
            str(run.result.used),
            _mm(fitted and fitted.translation_rms_m),
            _deg(fitted and fitted.rotation_rms_rad),
            _mm(held and held.translation_rms_m),
            _deg(held and held.rotation_rms_rad),
            NONE if run.time_s is None else f"{run.time_s * 1e3:.1f}",
        )
    return table


def _differences(title: str, sigmas: str, comparison: "Comparison", other: str) -> Table:
    found = apart_from(comparison, other)
    table = empty_table(title, "", *found)
    for quantity in dict.fromkeys(quantity for one in found.values() for quantity in one):
        column = [one.get(quantity) for one in found.values()]
        unit = "deg" if any(cell and cell.difference.difference_rad is not None for cell in column) else "mm"
        table.add_row(f"{quantity}, {unit}", *(NONE if cell is None else _size(cell.difference) for cell in column))
        table.add_row(f"  {sigmas}", *(NONE if cell is None else _in_sigmas(cell, other) for cell in column))
    return table


def _size(difference: Difference) -> str:
    return _mm(difference.difference_m) if difference.difference_rad is None else _deg(difference.difference_rad)


def _in_sigmas(cell: Apart, other: str) -> str:
    both = (cell.own,) if other == TRUTH else (cell.own, cell.other)
    return ", ".join(NONE if sigmas is None else f"{sigmas:.1f}" for sigmas in both)


def _row(run: "Run", errors: dict[str, Apart]) -> dict[str, Cell]:
    fitted, held, reason = run.fitted, run.held_out, run.reason
    row: dict[str, Cell] = cells(run.result.to_dict() if run.result else None) | {"solver": run.solver}
    row |= {"code": reason.code if reason else "", "reason": reason.message if reason else "", "time_s": run.time_s}
    row["residual_translation_rms_mm"] = _scaled(fitted and fitted.translation_rms_m, 1e3)
    row["residual_rotation_rms_deg"] = _scaled(fitted and fitted.rotation_rms_rad, _DEG)
    row["held_out_translation_rms_mm"] = _scaled(held and held.translation_rms_m, 1e3)
    row["held_out_rotation_rms_deg"] = _scaled(held and held.rotation_rms_rad, _DEG)
    for quantity in (OFFSET, MAJOR_RADIUS, MINOR_RADIUS):
        error = errors.get(quantity)
        row[f"error_{quantity.replace(' ', '_')}_mm"] = _scaled(error and error.difference.difference_m, 1e3)
    axis = errors.get(ORBITAL_AXIS)
    return row | {"error_orbital_axis_deg": _scaled(axis and axis.difference.difference_rad, _DEG)}


_DEG = float(np.degrees(1.0))


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else value * scale


def _mm(value: float | None) -> str:
    return NONE if value is None else f"{value * 1e3:.4f}"


def _deg(value: float | None) -> str:
    return NONE if value is None else f"{value * _DEG:.4f}"
