"""The summary of a batch: a row for each recording, with its numbers or with the reason why there are none."""

import csv
import io
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from carm_kin.journal import Line
from carm_kin.result_json import write_atomically

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
    "residual_translation_rms_mm": (NUMBER, "residuals.overall.translation_rms_mm"),
    "residual_rotation_rms_deg": (NUMBER, "residuals.overall.rotation_rms_deg"),
    "noise_translation_mm": (NUMBER, "noise.translation_mm"),
    "noise_rotation_deg": (NUMBER, "noise.rotation_deg"),
    "held_out_translation_rms_mm": (NUMBER, "cross_validation.overall.translation_rms_mm"),
    "held_out_rotation_rms_deg": (NUMBER, "cross_validation.overall.rotation_rms_deg"),
    "input_sha256": (TEXT, "provenance.input_sha256"),
}
"""Column -> its type and the place of its value in the result's file."""
FIRST = ("label", "input", "status", "code", "reason")


def row_of(line: Line, result: Mapping[str, Any] | None) -> dict[str, Cell]:
    """The row of a recording; ``result`` is the content of its file, None where there is none."""
    row: dict[str, Cell] = {name: getattr(line, name) for name in FIRST}
    row |= {name: _at(result, place) for name, (_, place) in COLUMNS.items()}
    warnings = result["warnings"] if result else []
    return row | {"warnings": ";".join(dict.fromkeys(warning["code"] for warning in warnings))}


def write_summary(rows: Sequence[Mapping[str, Cell]], path: Path) -> list[Path]:
    """Write ``path`` with the extensions .csv and, where pyarrow is installed, .parquet; returns what was written."""
    text = io.StringIO()
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    contents: dict[str, str | bytes] = {".csv": text.getvalue()}
    if find_spec("pyarrow"):
        contents[".parquet"] = _parquet(rows)
    written = [path.with_suffix(extension) for extension in contents]
    for file, content in zip(written, contents.values(), strict=True):
        write_atomically(file, content)
    return written


def _at(result: Mapping[str, Any] | None, place: str) -> Any:
    value: Any = result
    for step in place.split("."):
        if value is None:
            return None
        value = value[int(step)] if step.isdigit() else value[step]
    return value


def _parquet(rows: Sequence[Mapping[str, Cell]]) -> bytes:
    import pyarrow
    from pyarrow import parquet

    kinds = {name: COLUMNS.get(name, (TEXT,))[0] for name in rows[0]}
    schema = pyarrow.schema([(name, pyarrow.type_for_alias(kind)) for name, kind in kinds.items()])
    buffer = io.BytesIO()
    parquet.write_table(pyarrow.Table.from_pylist([dict(row) for row in rows], schema), buffer)
    return buffer.getvalue()
