"""Delimited text: lines, cells and numbers, with the place of whatever is wrong. No format itself."""

import contextlib
import csv
import difflib
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from solvers.se3 import Array, rotation_from_quat_wxyz

QUATERNION_TOLERANCE = 1e-3
"""How far the norm of a quaternion may be from 1."""

_DELIMITERS = {",": "','", ";": "';'", "\t": "a tab", "|": "'|'", " ": "a space"}
"""How they are called in messages."""
_SHOWN = 200
"""Characters of a header that a message repeats."""


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines of a file, neither blank nor comments."""

    file: Path
    text: list[str]
    number: list[int]
    """Line numbers in the file, from 1."""
    delimiter: str = ","
    """One of `_DELIMITERS`; cells that a space divides cannot be quoted, and any white space divides them."""

    def __len__(self) -> int:
        return len(self.text)

    def error(self, problem: str, row: int = 0, column: str | None = None) -> InputError:
        """The error at one of the lines, counted from 0."""
        return InputError(problem, file=self.file, line=self.number[row], column=column)

    def split(self, lines: int) -> tuple["Lines", "Lines"]:
        """The first lines, such as a header, and the ones below them."""
        head = replace(self, text=self.text[:lines], number=self.number[:lines])
        return head, replace(self, text=self.text[lines:], number=self.number[lines:])

    def cells(self, start: int = 0, stop: int | None = None) -> list[list[str]]:
        """The cells of some lines."""
        chunk = self.text[start:stop]
        if self.delimiter == " ":
            return [line.split() for line in chunk]
        with contextlib.suppress(csv.Error):
            rows = list(self._parsed(chunk))
            if len(rows) == len(chunk):
                return rows
        return [self._cells_of_one(row) for row in range(start, start + len(chunk))]

    def _parsed(self, lines: list[str]) -> Iterable[list[str]]:
        return csv.reader(lines, delimiter=self.delimiter, skipinitialspace=True, strict=True)

    def _cells_of_one(self, row: int) -> list[str]:
        try:
            return next(iter(self._parsed([self.text[row]])))
        except csv.Error as error:
            end = _DELIMITERS[self.delimiter]
            raise self.error(f"a quoted cell must end on its line and before a {end} ({error})", row) from None


def read_bytes(path: Path, most: int) -> bytes:
    """What is in a file of at most so many bytes."""
    try:
        if not path.is_file():
            raise InputError("is not a file" if path.exists() else "no such file", file=path)
        if (size := path.stat().st_size) > most:
            raise InputError(f"has {size / 1e9:.1f} GB; at most {most / 1e9:.0f} GB are read", file=path)
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None


def read_lines(path: Path, data: bytes, needed: str, delimiter: str = ",", comment: str = "#") -> Lines:
    """The lines of a file, whose bytes are UTF-8; `needed` tells what an empty one lacks. Lines that begin with
    `comment` are left out; "": none are."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        start = data.rfind(b"\n", 0, error.start) + 1
        line = data.count(b"\n", 0, error.start) + 1
        cell = len(data[start : error.start + 1].split(None if delimiter == " " else delimiter.encode()))
        problem = f"byte 0x{data[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise InputError(problem, file=path, line=line, column=str(cell)) from None
    if (at := text.find("\0")) >= 0:
        line = text.count("\n", 0, at) + 1
        raise InputError("a NUL character; this is no text file, or a damaged one", file=path, line=line)
    every = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    number = [i for i, line in enumerate(every, 1) if line.lstrip()[:1] not in comment]
    if not number:
        raise InputError(f"the file is empty; {needed} is needed", file=path)
    return Lines(path, [every[i - 1] for i in number], number, delimiter)


def check_unique(header: Lines, names: Sequence[str]) -> None:
    """Raise InputError where a column has the name of another."""
    for name in names:
        if names.count(name) > 1:
            places = " and ".join(str(i) for i, other in enumerate(names, 1) if other == name)
            raise header.error(f"the name '{name}' stands in the columns {places}; names must be unique", column=name)


def check_present(header: Lines, names: Sequence[str], needed: Sequence[str], advice: str) -> None:
    """Raise InputError where one of the needed columns is missing, with the likely reason."""
    absent = [name for name in needed if name not in names]
    if not absent:
        return
    for delimiter, shown in _DELIMITERS.items():
        cells = header.text[0].split(delimiter)
        if delimiter != header.delimiter and len(cells) > 1 and set(needed) & {cell.strip(' "') for cell in cells}:
            use = f"{_DELIMITERS[header.delimiter]} (and '.' as the decimal mark)"
            raise header.error(f"the file seems to use {shown} between its cells; use {use}", column=absent[0])
    if any(_is_number(name) for name in names if name):
        raise header.error("the first line holds numbers; a header line with the names of the columns is needed")
    close = difflib.get_close_matches(absent[0], [name for name in names if name not in needed], 1)
    meant = f" (is it '{close[0]}'?)" if close else ""
    has = ", ".join(names)
    has = has if len(has) <= _SHOWN else f"{has[:_SHOWN]}..."
    problem = f"missing {', '.join(absent)}{meant}; the file has {has}; {advice}"
    raise header.error(problem, column=absent[0])


def read_columns(
    lines: Lines, names: Sequence[str], numeric: Sequence[str], at_a_time: int
) -> tuple[dict[str, Array], dict[str, list[str]]]:
    """Column -> (N,) numbers, NaN where a cell is empty, and column -> text.

    So many lines are split at a time; few enough, and their cells stay in the processor's cache.
    """
    numbers = {name: np.empty(len(lines)) for name in numeric}
    text: dict[str, list[str]] = {name: [] for name in names if name not in numbers}
    for start in range(0, len(lines), at_a_time):
        rows = lines.cells(start, start + at_a_time)
        _check_width(lines, names, start, rows)
        for name, cells in zip(names, zip(*rows, strict=True), strict=True):
            if name in text:
                text[name].extend(map(sys.intern, cells))
            else:
                numbers[name][start : start + len(cells)] = _numbers(lines, name, start, cells)
    return numbers, text


def present(lines: Lines, groups: Iterable[Sequence[str]], numbers: Mapping[str, Array]) -> np.ndarray:
    """(N,) whether every group of columns is there; a part of a group alone is an error."""
    missing = np.zeros(len(lines), dtype=bool)
    for group in filter(None, groups):
        empty = np.isnan([numbers[name] for name in group])
        if np.any(partly := empty.any(axis=0) & ~empty.all(axis=0)):
            row = int(np.argmax(partly))
            problem = f"the cell is empty, others of {', '.join(group)} are not; leave all or none of them empty"
            raise lines.error(problem, row, group[int(np.argmax(empty[:, row]))])
        missing |= empty.all(axis=0)
    return ~missing


def rotations(lines: Lines, rows: np.ndarray, quat_wxyz: Array, column: str) -> Array:
    """(M, 3, 3) rotations of the (M, 4) unit quaternions that stand in the given rows, w in the given column."""
    norm = np.linalg.norm(quat_wxyz, axis=1)
    if np.any(bad := np.abs(norm - 1) > QUATERNION_TOLERANCE):
        pose = int(np.argmax(bad))
        problem = f"the quaternion has the norm {norm[pose]:.6g}; it must be a unit quaternion"
        if norm[pose] < QUATERNION_TOLERANCE:
            problem = "the quaternion is zero; leave the cells of a missing frame empty"
        raise lines.error(problem, rows[pose], column)
    return rotation_from_quat_wxyz(quat_wxyz)


def _check_width(lines: Lines, names: Sequence[str], start: int, rows: list[list[str]]) -> None:
    if set(map(len, rows)) == {len(names)}:
        return
    row, cells = next((i, cells) for i, cells in enumerate(rows, start) if len(cells) != len(names))
    problem = f"the row has {len(cells)} cells, the header has {len(names)}"
    if len(cells) < len(names):
        raise lines.error(problem, row, names[len(cells)])
    if lines.delimiter == "," and not any("." in cell for cell in cells):
        problem += "; the file seems to use ',' as the decimal mark: write 1.5, not 1,5"
    raise lines.error(problem, row, str(len(names) + 1))


def _numbers(lines: Lines, name: str, start: int, cells: Sequence[str]) -> Array:
    """(N,) finite numbers, NaN where a cell is empty."""
    with contextlib.suppress(ValueError):
        return _floats(cells)
    row, cell = next((i, cell.strip()) for i, cell in enumerate(cells, start) if not _is_number(cell))
    problem = f"'{cell}' is not a number"
    if "," in cell:
        problem += "; use '.' as the decimal mark"
    with contextlib.suppress(ValueError):
        if not np.isfinite(float(cell)):
            problem = f"'{cell}' is not finite; leave the cells of a missing frame empty"
    raise lines.error(problem, row, name)


def _floats(cells: Sequence[str]) -> Array:
    """Raises ValueError where a cell is neither empty nor the plain notation of a finite number."""
    joined = "".join(cells)
    if not joined.isascii() or any(letter in joined for letter in "nN_"):
        raise ValueError
    try:
        values = np.fromiter(map(float, cells), float, len(cells))
    except ValueError:
        values = np.array([float(cell) if cell.strip() else np.nan for cell in cells])
    if np.isinf(values).any():
        raise ValueError
    return values


def _is_number(cell: str) -> bool:
    try:
        return len(_floats([cell])) == 1
    except ValueError:
        return False
