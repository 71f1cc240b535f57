"""Tables of other programs: columns by position, empty cells and NaN for what is missing, perhaps cut off.

No format itself.
"""

import hashlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carm_kin.recording.formats._table import Lines, read_bytes, read_lines
from carm_kin.recording.recording import Source
from solvers.se3 import Array

MAX_BYTES = 2 * 10**9
"""Larger files are refused."""
CHUNK = 2000
"""Lines that are split at a time; their cells stay in the processor's cache."""
NOTHING = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "--", "missing", "nan(ind)", "-nan(ind)", "-1.#ind"})
"""How programs write that there is no number, in lower case."""


@dataclass(frozen=True, eq=False)
class Cells:
    """The wanted columns of a table."""

    numbers: Mapping[str, Array]
    """Column -> (N,), NaN where there is none."""
    text: Mapping[str, np.ndarray]
    """Column -> (N,) str without white space around it."""
    cut_off: int
    """1 where the last row ends before its time, else 0; it is not among the N."""

    def stack(self, names: Sequence[str]) -> Array:
        """(N, K) of K columns."""
        return np.stack([self.numbers[name] for name in names], axis=1)


def lines_of(path: Path, needed: str, delimiter: str = ",", comment: str = "#") -> tuple[Lines, Source]:
    """The lines of a file and where they come from."""
    data = read_bytes(path, MAX_BYTES)
    source = Source(str(path), hashlib.sha256(data).hexdigest())
    return read_lines(path, data, needed, delimiter, comment), source


def head_lines(head: bytes, count: int) -> list[str]:
    """The first lines of a text file, neither blank nor comments, no byte order mark; [] where it is binary."""
    if b"\0" in head:
        return []
    lines = head.decode("utf-8-sig", errors="replace").splitlines()
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")][:count]


def delimiter_of(line: str) -> str:
    """What stands between the cells of a line: the most frequent of comma, semicolon and tab."""
    return max(",;\t", key=line.count)


def read_cells(lines: Lines, names: Sequence[str], numeric: Sequence[str], text: Sequence[str] = ()) -> Cells:
    """Some columns of a table whose columns have these names, by position; the other columns are not looked at.

    Empty cells at the end of a row need no column. Raises InputError with line and column where a row has another
    number of cells or a cell is no number.
    """
    index = {name: names.index(name) for name in (*numeric, *text)}
    numbers: dict[str, list[Array]] = {name: [] for name in numeric}
    words: dict[str, list[str]] = {name: [] for name in text}
    cut_off = 0
    for start in range(0, len(lines), CHUNK):
        rows = lines.cells(start, start + CHUNK)
        if set(map(len, rows)) != {len(names)}:
            rows = [_fitted(cells, len(names)) for cells in rows]
            if start + len(rows) == len(lines) and len(rows[-1]) < len(names):
                rows, cut_off = rows[:-1], 1
            _check_width(lines, names, start, rows)
        columns = list(zip(*rows, strict=True)) or [()] * len(names)
        for name, found in numbers.items():
            found.append(floats(lines, name, start, columns[index[name]]))
        for name, found in words.items():
            found.extend(map(sys.intern, map(str.strip, columns[index[name]])))
    return Cells(
        {name: np.concatenate(found) if found else np.empty(0) for name, found in numbers.items()},
        {name: np.array(found, dtype=object) for name, found in words.items()},
        cut_off,
    )


def floats(lines: Lines, name: str, start: int, cells: Sequence[str]) -> Array:
    """(N,) numbers, NaN where there is none, of the cells of a column from row ``start`` on."""
    try:
        if "_" not in "".join(cells):
            return np.fromiter(map(float, cells), float, len(cells))
    except ValueError:
        pass
    return np.array([_float(lines, name, row, cell) for row, cell in enumerate(cells, start)])


def _float(lines: Lines, name: str, row: int, cell: str) -> float:
    if cell.strip().lower() in NOTHING:
        return np.nan
    try:
        if "_" not in cell:
            return float(cell)
    except ValueError:
        pass
    shown = cell.strip() if len(cell) <= 40 else f"{cell.strip()[:37]}..."
    hint = "; use '.' as the decimal mark" if "," in cell else ""
    raise lines.error(f"'{shown}' is not a number{hint}", row, name)


def _fitted(cells: list[str], width: int) -> list[str]:
    """The row without empty cells beyond its columns."""
    while len(cells) > width and not cells[-1].strip():
        cells = cells[:-1]
    return cells


def _check_width(lines: Lines, names: Sequence[str], start: int, rows: Sequence[Sequence[str]]) -> None:
    for row, cells in enumerate(rows, start):
        if len(cells) == len(names):
            continue
        problem = f"the row has {len(cells)} cells, the header has {len(names)}"
        if len(cells) > len(names) and lines.delimiter == "," and not any("." in cell for cell in cells):
            problem += "; the file seems to use ',' as the decimal mark: write 1.5, not 1,5"
        raise lines.error(problem, row, names[len(cells)] if len(cells) < len(names) else str(len(names) + 1))
