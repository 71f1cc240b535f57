"""A result as a row of a table, and tables as CSV."""

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from carm_kin.results.shown import angle_determined, direction_determined, length_determined

Cell = str | int | float | None

TEXT, WHOLE, NUMBER = "string", "int64", "double"
COLUMNS: dict[str, tuple[str, str]] = {
    "solver": (TEXT, "solver"),
    "poses": (WHOLE, "poses"),
    "used": (WHOLE, "used"),
    "outliers": (WHOLE, "outliers.count"),
    **{f"offset_{axis}_mm": (NUMBER, f"offset_sensor_pivot_mm.{k}") for k, axis in enumerate("xyz")},
    **{f"sigma_offset_{axis}_mm": (NUMBER, f"sigma.offset_sensor_pivot_mm.{k}") for k, axis in enumerate("xyz")},
    "major_radius_mm": (NUMBER, "major_radius_mm"),
    "sigma_major_radius_mm": (NUMBER, "sigma.major_radius_mm"),
    "minor_radius_mm": (NUMBER, "minor_radius_mm"),
    "sigma_minor_radius_mm": (NUMBER, "sigma.minor_radius_mm"),
    "axis_non_orthogonality_deg": (NUMBER, "axis_non_orthogonality_deg"),
    "sigma_axis_non_orthogonality_deg": (NUMBER, "sigma.axis_non_orthogonality_deg"),
    **{f"orbital_axis_{axis}": (NUMBER, f"orbital_axis_sensor.{k}") for k, axis in enumerate("xyz")},
    "residual_translation_rms_mm": (NUMBER, "residuals.overall.translation_rms_mm"),
    "residual_rotation_rms_deg": (NUMBER, "residuals.overall.rotation_rms_deg"),
    "noise_translation_mm": (NUMBER, "noise.translation_mm"),
    "noise_rotation_deg": (NUMBER, "noise.rotation_deg"),
    "held_out_translation_rms_mm": (NUMBER, "cross_validation.overall.translation_rms_mm"),
    "held_out_rotation_rms_deg": (NUMBER, "cross_validation.overall.rotation_rms_deg"),
    "input_sha256": (TEXT, "provenance.input_sha256"),
}
"""Column -> its type and the place of its value in the result's file."""


def cells(result: Mapping[str, Any] | None) -> dict[str, Cell]:
    """The columns of a result's file content; all None where there is none, and numbers that are not determined."""
    found: dict[str, Cell] = {name: _at(result, place) for name, (_, place) in COLUMNS.items()}
    for name in [name for name in found if _beyond_meaning(found, name)]:
        found[name] = found[f"sigma_{name}"] = None
    axis = _at(result, "sigma.orbital_axis_sensor")
    if axis is not None and not direction_determined(np.array(axis)):
        found |= dict.fromkeys((f"orbital_axis_{k}" for k in "xyz"), None)
    warnings = result["warnings"] if result else []
    return found | {"warnings": ";".join(dict.fromkeys(warning["code"] for warning in warnings))}


def _beyond_meaning(found: Mapping[str, Cell], name: str) -> bool:
    """Whether the column has a sigma, and it says that the number is not determined."""
    sigma = found.get(f"sigma_{name}")
    if not isinstance(sigma, float):
        return False
    return not (length_determined(sigma / 1e3) if name.endswith("_mm") else angle_determined(float(np.radians(sigma))))


def csv_text(rows: Sequence[Mapping[str, Cell]]) -> str:
    """The rows, which have the same columns, with a header."""
    text = io.StringIO()
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()


def _at(result: Mapping[str, Any] | None, place: str) -> Any:
    value: Any = result
    for step in place.split("."):
        if value is None:
            return None
        value = value[int(step)] if step.isdigit() else value[step]
    return value
