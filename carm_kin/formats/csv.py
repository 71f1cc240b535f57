"""The native recording: one header line, one line a pose, columns in any order, ``#`` for comments.

Positions are read from ``x_mm,y_mm,z_mm`` or ``x_m,y_m,z_m``, orientations from the unit quaternion
``qw,qx,qy,qz``, joint values from ``q_<joint>_deg`` or ``_rad`` and ``q_<joint>_mm`` or ``_m``. The text
columns are ``sweep``, ``moving`` and ``placement``; ``time_s`` is in seconds; every other column is metadata.
"""

import contextlib
import csv
import difflib
import hashlib
import os
import re
import sys
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording import PoseError, Recording, Source
from solvers.se3 import Array, quat_wxyz_from_rotation, rotation_from_quat_wxyz

EXTENSIONS = (".csv",)
MAX_BYTES = 2 * 10**9
"""Larger files are refused."""
QUATERNION_TOLERANCE = 1e-3
"""How far the norm of a quaternion may be from 1."""

_CHUNK = 2000
"""Lines that are split at a time, so that their cells stay in the processor's cache."""
_QUATERNION = ("qw", "qx", "qy", "qz")
_TEXT = ("sweep", "moving", "placement")
_RESERVED = {*_QUATERNION, *_TEXT, "time_s", *(f"{axis}_{unit}" for axis in "xyz" for unit in ("mm", "m"))}
_JOINT = re.compile(r"q_(?P<joint>.+)_(?P<unit>deg|rad|mm|m)")


_UNITS: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "mm": (lambda mm: mm / 1000, lambda m: m * 1000),
    "m": (np.array, np.array),
    "deg": (np.radians, np.degrees),
    "rad": (np.array, np.array),
}
"""Conversions to m or rad and back."""


@dataclass(frozen=True, eq=False)
class _Lines:
    """The lines of a file that are neither blank nor comments; the first one is the header."""

    file: Path
    text: list[str]
    number: list[int]
    """Line numbers in the file, from 1."""

    def error(self, problem: str, row: int = -1, column: str | None = None) -> InputError:
        """The error at a row (0 = the first below the header, -1 = the header)."""
        return InputError(problem, file=self.file, line=self.number[row + 1], column=column)


@dataclass(frozen=True)
class _Columns:
    """Which column says what."""

    names: list[str]
    position: list[str]
    unit: str
    quaternion: list[str]
    """Empty where the file has positions only."""
    joints: dict[str, tuple[str, str]]
    """Joint -> its column and unit."""

    @property
    def numeric(self) -> list[str]:
        joints = [column for column, _ in self.joints.values()]
        return [*self.position, *self.quaternion, *joints, *(["time_s"] if "time_s" in self.names else [])]

    @property
    def metadata(self) -> list[str]:
        return [name for name in self.names if name not in (*self.numeric, *_TEXT)]


def read(path: str | os.PathLike) -> Recording:
    """The recording in a file. Raises InputError, with line and column, where the file is not sound."""
    path = Path(path)
    data = _bytes(path)
    lines = _lines(path, data)
    columns = _columns(lines)
    numbers, text = _cells(lines, columns)
    has_pose = _has_pose(lines, columns, numbers)
    rows = np.flatnonzero(has_pose)
    if not rows.size:
        problem = f"all {len(has_pose)} poses are missing: every row lacks its position or orientation"
        raise lines.error(problem, 0, columns.position[0])
    numbers = {name: values[rows] for name, values in numbers.items()}
    labels = {name: np.array(cells, dtype=object)[rows] for name, cells in text.items()}
    try:
        return Recording(
            _UNITS[columns.unit][0](np.stack([numbers[name] for name in columns.position], axis=1)),
            _rotations(lines, columns, numbers, rows),
            time_s=numbers.get("time_s"),
            sweep=labels.get("sweep"),
            moving=labels.get("moving"),
            placement=labels.get("placement"),
            joints={joint: _UNITS[unit][0](numbers[name]) for joint, (name, unit) in columns.joints.items()},
            prismatic=frozenset(joint for joint, (_, unit) in columns.joints.items() if unit in ("mm", "m")),
            metadata={name: labels[name] for name in columns.metadata},
            missing=len(has_pose) - len(rows),
            pose_number=rows,
            source=Source(str(path), hashlib.sha256(data).hexdigest()),
        )
    except PoseError as error:
        names = {f"q_{joint}": name for joint, (name, _) in columns.joints.items()}
        raise lines.error(error.problem, rows[error.pose], names.get(error.column, error.column)) from None


def write(recording: Recording, path: str | os.PathLike) -> None:
    """Write a recording so that reading it gives it back; the file appears whole or not at all.

    Numbers are written so that they are read back to the last bit: in mm and deg where these units
    allow it for the whole column (always so for what was read in them), else in m and rad.
    Orientations pass through a quaternion and come back to 2e-15. Missing frames keep their place.
    Raises InputError where a name or a text cannot stand in a CSV or the file cannot be written.
    """
    path = Path(path)
    if not len(recording):
        raise InputError("the recording has no poses to write", file=path)
    number = recording.pose_number if recording.missing else np.arange(len(recording))
    table = {}
    for name, cells in _table(recording, path).items():
        table[name] = np.full(len(recording) + recording.missing, "", dtype=object)
        table[name][number] = cells
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        with temporary.open("x", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(table)
            writer.writerows(zip(*table.values(), strict=True))
        temporary.replace(path)
    except (OSError, UnicodeEncodeError) as error:
        raise InputError(f"cannot be written: {error}", file=path) from None
    finally:
        temporary.unlink(missing_ok=True)


def _bytes(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise InputError("is not a file" if path.exists() else "no such file", file=path)
        if (size := path.stat().st_size) > MAX_BYTES:
            raise InputError(f"has {size / 1e9:.1f} GB; at most {MAX_BYTES / 1e9:.0f} GB are read", file=path)
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None


def _lines(path: Path, data: bytes) -> _Lines:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        start = data.rfind(b"\n", 0, error.start) + 1
        line, cell = data.count(b"\n", 0, error.start) + 1, data.count(b",", start, error.start) + 1
        problem = f"byte 0x{data[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise InputError(problem, file=path, line=line, column=str(cell)) from None
    every = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    number = [i for i, line in enumerate(every, 1) if line.lstrip()[:1] not in "#"]
    lines = _Lines(path, [every[i - 1] for i in number], number)
    if not lines.text:
        raise InputError("the file is empty; a header line such as x_mm,y_mm,z_mm,qw,qx,qy,qz is needed", file=path)
    return lines


def _columns(lines: _Lines) -> _Columns:
    names = [name.strip() for name in _split(lines, 0, 1)[0]]
    position, unit = _position(lines, names)
    for name in names:
        if names.count(name) > 1:
            places = " and ".join(str(i) for i, other in enumerate(names, 1) if other == name)
            raise lines.error(f"the name '{name}' stands in the columns {places}; names must be unique", column=name)
    quaternion = [name for name in _QUATERNION if name in names]
    if quaternion:
        _require(lines, names, _QUATERNION)
    joints = _joints(lines, names)
    if len(lines.text) == 1:
        raise lines.error("the file has a header but no poses below it")
    return _Columns(names, position, unit, quaternion, joints)


def _position(lines: _Lines, names: list[str]) -> tuple[list[str], str]:
    """The three columns of the position and their unit."""
    found = {axis: [unit for unit in ("mm", "m") if f"{axis}_{unit}" in names] for axis in "xyz"}
    for axis, units in found.items():
        if len(units) == 2:
            raise lines.error(f"{axis}_mm and {axis}_m are both given; keep one of them", column=f"{axis}_m")
    given = [units[0] for units in found.values() if units]
    if len(set(given)) > 1:
        mixed = next(f"{axis}_{units[0]}" for axis, units in found.items() if units and units[0] != given[0])
        raise lines.error(f"the units of the position are mixed; {mixed} must be in {given[0]}", column=mixed)
    unit = given[0] if given else "mm"
    position = [f"{axis}_{unit}" for axis in "xyz"]
    _require(lines, names, position)
    return position, unit


def _require(lines: _Lines, names: list[str], needed: Sequence[str]) -> None:
    """Raise InputError where one of the needed columns is missing, with the likely reason."""
    absent = [name for name in needed if name not in names]
    if not absent:
        return
    header = lines.text[0]
    for delimiter, shown in {";": "';'", "\t": "a tab", "|": "'|'", " ": "a space"}.items():
        if set(needed) & {cell.strip(' "') for cell in header.split(delimiter)} and delimiter in header:
            problem = f"the file seems to use {shown} between its cells; use ',' (and '.' as the decimal mark)"
            raise lines.error(problem, column=absent[0])
    if any(_is_number(name) for name in names if name):
        raise lines.error("the first line holds numbers; a header line with the names of the columns is needed")
    close = difflib.get_close_matches(absent[0], [name for name in names if name not in needed], 1)
    meant = f" (is it '{close[0]}'?)" if close else ""
    raise lines.error(
        f"missing {', '.join(absent)}{meant}; the file has {', '.join(names)}; needed are x_mm, y_mm, z_mm "
        "(or x_m, y_m, z_m) and, for orientations, qw, qx, qy, qz",
        column=absent[0],
    )


def _joints(lines: _Lines, names: list[str]) -> dict[str, tuple[str, str]]:
    joints: dict[str, tuple[str, str]] = {}
    for name in names:
        if not name.startswith("q_"):
            continue
        if (match := _JOINT.fullmatch(name)) is None:
            problem = "the unit of the joint value is missing or unknown; write q_<joint>_deg or q_<joint>_mm"
            raise lines.error(problem, column=name)
        joint = match["joint"]
        if joint in joints:
            raise lines.error(f"joint '{joint}' already has the column {joints[joint][0]}; keep one", column=name)
        joints[joint] = name, match["unit"]
    return joints


def _split(lines: _Lines, start: int, stop: int) -> list[list[str]]:
    """The cells of some lines."""
    chunk = lines.text[start:stop]
    with contextlib.suppress(csv.Error):
        rows = list(csv.reader(chunk, skipinitialspace=True, strict=True))
        if len(rows) == len(chunk):
            return rows
    return [_split_one(lines, index) for index in range(start, start + len(chunk))]


def _split_one(lines: _Lines, index: int) -> list[str]:
    try:
        return next(csv.reader([lines.text[index]], skipinitialspace=True, strict=True))
    except csv.Error as error:
        raise lines.error(f"a quoted cell must end on its line and before a ',' ({error})", index - 1) from None


def _cells(lines: _Lines, columns: _Columns) -> tuple[dict[str, Array], dict[str, list[str]]]:
    """Column -> (N,) numbers, NaN where a cell is empty, and column -> text."""
    n = len(lines.text) - 1
    numbers = {name: np.empty(n) for name in columns.numeric}
    text: dict[str, list[str]] = {name: [] for name in columns.names if name not in numbers}
    for start in range(0, n, _CHUNK):
        rows = _split(lines, start + 1, start + 1 + _CHUNK)
        _check_width(lines, columns.names, start, rows)
        for name, cells in zip(columns.names, zip(*rows, strict=True), strict=True):
            if name in text:
                text[name].extend(map(sys.intern, cells))
            else:
                numbers[name][start : start + len(cells)] = _numbers(lines, name, start, cells)
    return numbers, text


def _check_width(lines: _Lines, names: list[str], start: int, rows: list[list[str]]) -> None:
    if set(map(len, rows)) == {len(names)}:
        return
    row, cells = next((i, cells) for i, cells in enumerate(rows, start) if len(cells) != len(names))
    problem = f"the row has {len(cells)} cells, the header has {len(names)}"
    if len(cells) < len(names):
        raise lines.error(problem, row, names[len(cells)])
    if not any("." in cell for cell in cells):
        problem += "; the file seems to use ',' as the decimal mark: write 1.5, not 1,5"
    raise lines.error(problem, row, str(len(names) + 1))


def _numbers(lines: _Lines, name: str, start: int, cells: Sequence[str]) -> Array:
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


def _has_pose(lines: _Lines, columns: _Columns, numbers: dict[str, Array]) -> np.ndarray:
    """(N,) whether the position and the orientation are there; a part of one alone is an error."""
    missing = np.zeros(len(lines.text) - 1, dtype=bool)
    for group in filter(None, (columns.position, columns.quaternion)):
        empty = np.isnan([numbers[name] for name in group])
        if np.any(partly := empty.any(axis=0) & ~empty.all(axis=0)):
            row = int(np.argmax(partly))
            problem = f"the cell is empty, others of {', '.join(group)} are not; leave all or none of them empty"
            raise lines.error(problem, row, group[int(np.argmax(empty[:, row]))])
        missing |= empty.all(axis=0)
    return ~missing


def _rotations(lines: _Lines, columns: _Columns, numbers: dict[str, Array], rows: np.ndarray) -> Array | None:
    if not columns.quaternion:
        return None
    quat_wxyz = np.stack([numbers[name] for name in columns.quaternion], axis=1)
    norm = np.linalg.norm(quat_wxyz, axis=1)
    if np.any(bad := np.abs(norm - 1) > QUATERNION_TOLERANCE):
        pose = int(np.argmax(bad))
        problem = f"the quaternion has the norm {norm[pose]:.6g}; it must be a unit quaternion"
        if norm[pose] < QUATERNION_TOLERANCE:
            problem = "the quaternion is zero; leave the cells of a missing frame empty"
        raise lines.error(problem, rows[pose], "qw")
    return rotation_from_quat_wxyz(quat_wxyz)


def _table(recording: Recording, path: Path) -> Mapping[str, Sequence[str]]:
    """Column name -> N cells, which can be read back."""
    position, unit = _exact(recording.p_world_sensor, "mm", "m")
    numbers = {f"{axis}_{unit}": values for axis, values in zip("xyz", position.T, strict=True)}
    if recording.R_world_sensor is not None:
        quat_wxyz = quat_wxyz_from_rotation(recording.R_world_sensor)
        numbers |= dict(zip(_QUATERNION, quat_wxyz.T, strict=True))
    if recording.time_s is not None:
        numbers["time_s"] = recording.time_s
    for joint, values in recording.joints.items():
        shown, unit = _exact(values, *(("mm", "m") if joint in recording.prismatic else ("deg", "rad")))
        numbers[f"q_{joint}_{unit}"] = shown
    text = {name: getattr(recording, name) for name in _TEXT if getattr(recording, name) is not None}
    for name in recording.metadata:
        if name in _RESERVED or name.startswith("q_"):
            raise InputError("metadata cannot have the name of a column that means something", file=path, column=name)
    table = {**{name: _cells_of(values) for name, values in numbers.items()}, **text, **recording.metadata}
    for name, cells in table.items():
        if name != name.strip() or (name.startswith("q_") and not _JOINT.fullmatch(name)):
            raise InputError("the name must not be empty or have white space around it", file=path, column=name)
        if {"\n", "\r", "\0"} & set(name + "".join(cells)):
            raise InputError("a cell cannot hold a line break or a NUL character", file=path, column=name)
        if max(map(len, (name, *cells))) > csv.field_size_limit():
            raise InputError(f"a cell holds at most {csv.field_size_limit()} characters", file=path, column=name)
    return table


def _exact(values: Array, unit: str, si: str) -> tuple[Array, str]:
    """The values in a unit from which they convert back to the last bit: `unit` if it can be, else `si`."""
    to_si, from_si = _UNITS[unit]
    with np.errstate(over="ignore", invalid="ignore"):
        shown = from_si(values)
        exact = np.where(np.isnan(values), np.nan, np.inf)
        for candidate in (np.nextafter(shown, -np.inf), np.nextafter(shown, np.inf), shown, np.round(shown, 9)):
            exact = np.where(to_si(candidate) == values, candidate, exact)
    return (values, si) if np.isinf(exact).any() else (exact, unit)


def _cells_of(values: Array) -> list[str]:
    return ["" if value != value else repr(value) for value in values.tolist()]
