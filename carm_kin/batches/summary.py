"""The summary of a batch: a row for each recording, with its numbers or with the reason why there are none."""

import io
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from carm_kin.batches.journal import Line
from carm_kin.files import write_atomically
from carm_kin.results.rows import COLUMNS, TEXT, Cell, cells, csv_text

FIRST = ("label", "input", "status", "code", "reason")


def row_of(line: Line, result: Mapping[str, Any] | None) -> dict[str, Cell]:
    """The row of a recording; ``result`` is the content of its file, None where there is none."""
    return {name: getattr(line, name) for name in FIRST} | cells(result)


def summary_files(path: Path) -> tuple[Path, ...]:
    """``path`` with the extension .csv and, where pyarrow is installed, with .parquet."""
    return tuple(path.with_suffix(ending) for ending in (".csv", *((".parquet",) if find_spec("pyarrow") else ())))


def write_summary(rows: Sequence[Mapping[str, Cell]], path: Path) -> None:
    """Write the `summary_files`."""
    for file in summary_files(path):
        write_atomically(file, csv_text(rows) if file.suffix == ".csv" else _parquet(rows))


def _parquet(rows: Sequence[Mapping[str, Cell]]) -> bytes:
    import pyarrow
    from pyarrow import parquet

    kinds = {name: COLUMNS.get(name, (TEXT,))[0] for name in rows[0]}
    schema = pyarrow.schema([(name, pyarrow.type_for_alias(kind)) for name, kind in kinds.items()])
    buffer = io.BytesIO()
    parquet.write_table(pyarrow.Table.from_pylist([dict(row) for row in rows], schema), buffer)
    return buffer.getvalue()
