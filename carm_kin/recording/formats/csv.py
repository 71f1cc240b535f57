"""The native recording: one header line, one line a pose, columns in any order, ``#`` for comments.

Positions are read from ``x_mm,y_mm,z_mm`` or ``x_m,y_m,z_m``, orientations from the unit quaternion
``qw,qx,qy,qz``, joint values from ``q_<joint>_deg`` or ``_rad`` and ``q_<joint>_mm`` or ``_m``. The text
columns are ``sweep``, ``moving`` and ``placement``; ``time_s`` is in seconds; ``sigma_t_mm,sigma_r_deg`` are the
standard deviations of a pose that is a mean of frames; every other column is metadata.
"""

import csv
import hashlib
import os
import re
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats._foreign import head_lines
from carm_kin.recording.formats._table import (
    Lines,
    check_present,
    check_unique,
    present,
    read_bytes,
    read_columns,
    read_lines,
    rotations,
)
from carm_kin.recording.intake import Dropped, Intake
from carm_kin.recording.recording import PoseError, Recording, Source
from solvers.se3 import Array, quat_wxyz_from_rotation

SUMMARY = "the native CSV: x_mm, y_mm, z_mm, qw, qx, qy, qz, sweeps, labels"
EXTENSIONS = (".csv",)
HOLDS = ("time_s", "sweep", "moving", "placement", "joints", "metadata", "variance")
MAX_BYTES = 2 * 10**9
"""Larger files are refused."""

_CHUNK = 2000
"""Lines that are split at a time."""
_QUATERNION = ("qw", "qx", "qy", "qz")
_TEXT = ("sweep", "moving", "placement")
_SIGMAS = ("sigma_t_mm", "sigma_r_deg")
_RESERVED = {*_QUATERNION, *_TEXT, *_SIGMAS, "time_s", *(f"{axis}_{unit}" for axis in "xyz" for unit in ("mm", "m"))}
_JOINT = re.compile(r"q_(?P<joint>.+)_(?P<unit>deg|rad|mm|m)")
_ADVICE = "needed are x_mm, y_mm, z_mm (or x_m, y_m, z_m) and, for orientations, qw, qx, qy, qz"

_UNITS: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "mm": (lambda mm: mm / 1000, lambda m: m * 1000),
    "m": (np.array, np.array),
    "deg": (np.radians, np.degrees),
    "rad": (np.array, np.array),
}
"""Conversions to m or rad and back."""
_VARIANCE = np.array([1e-6, np.radians(1.0) ** 2])
"""From the squares of `_SIGMAS` to m² and rad²."""


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
        return [*self.position, *self.quaternion, *joints, *(n for n in ("time_s", *_SIGMAS) if n in self.names)]

    @property
    def metadata(self) -> list[str]:
        return [name for name in self.names if name not in (*self.numeric, *_TEXT)]


def matches(path: Path, head: bytes) -> bool:
    """A header with a position that tells its unit."""
    lines = head_lines(head, 1)
    names = {cell.strip(' "') for cell in lines[0].split(",")} if lines else set()
    return {"x_mm", "y_mm", "z_mm"} <= names or {"x_m", "y_m", "z_m"} <= names


def read(path: Path, declared: Declarations) -> Recording:
    """The recording in a file. Raises InputError, with line and column, where the file is not sound."""
    data = read_bytes(path, MAX_BYTES)
    header, lines = read_lines(path, data, "a header line such as x_mm,y_mm,z_mm,qw,qx,qy,qz").split(1)
    columns = _columns(header, [name.strip() for name in header.cells()[0]])
    if not lines.text:
        raise header.error("the file has a header but no poses below it")
    numbers, text = read_columns(lines, columns.names, columns.numeric, _CHUNK)
    has_pose = present(lines, [columns.position, columns.quaternion], numbers)
    rows = np.flatnonzero(has_pose)
    if not rows.size:
        problem = f"all {len(has_pose)} poses are missing: every row lacks its position or orientation"
        raise lines.error(problem, 0, columns.position[0])
    numbers = {name: values[rows] for name, values in numbers.items()}
    labels = {name: np.array(cells, dtype=object)[rows] for name, cells in text.items()}

    def stack(names: list[str]) -> Array:
        return np.stack([numbers[name] for name in names], axis=1)

    try:
        return Recording(
            _UNITS[columns.unit][0](stack(columns.position)),
            rotations(lines, rows, stack(columns.quaternion), "qw") if columns.quaternion else None,
            time_s=numbers.get("time_s"),
            variance=stack(list(_SIGMAS)) ** 2 * _VARIANCE if _SIGMAS[0] in numbers else None,
            sweep=labels.get("sweep"),
            moving=labels.get("moving"),
            placement=labels.get("placement"),
            joints={joint: _UNITS[unit][0](numbers[name]) for joint, (name, unit) in columns.joints.items()},
            prismatic=frozenset(joint for joint, (_, unit) in columns.joints.items() if unit in ("mm", "m")),
            metadata={name: labels[name] for name in columns.metadata},
            missing=len(has_pose) - len(rows),
            pose_number=rows,
            source=Source(str(path), hashlib.sha256(data).hexdigest()),
            intakes=(_intake(len(has_pose), len(rows)),),
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
    for name, cells in _as_text(recording, path).items():
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


def _intake(frames: int, kept: int) -> Intake:
    return Intake("csv", "", "", (), frames, kept, (Dropped("without a pose", frames - kept),))


def _columns(header: Lines, names: list[str]) -> _Columns:
    position, unit = _position(header, names)
    check_unique(header, names)
    quaternion = [name for name in _QUATERNION if name in names]
    if quaternion:
        check_present(header, names, _QUATERNION, _ADVICE)
    if set(_SIGMAS) & set(names):
        check_present(header, names, _SIGMAS, f"{' and '.join(_SIGMAS)} belong together")
    return _Columns(names, position, unit, quaternion, _joints(header, names))


def _position(header: Lines, names: list[str]) -> tuple[list[str], str]:
    """The three columns of the position and their unit."""
    found = {axis: [unit for unit in ("mm", "m") if f"{axis}_{unit}" in names] for axis in "xyz"}
    for axis, units in found.items():
        if len(units) == 2:
            raise header.error(f"{axis}_mm and {axis}_m are both given; keep one of them", column=f"{axis}_m")
    given = [units[0] for units in found.values() if units]
    if len(set(given)) > 1:
        mixed = next(f"{axis}_{units[0]}" for axis, units in found.items() if units and units[0] != given[0])
        raise header.error(f"the units of the position are mixed; {mixed} must be in {given[0]}", column=mixed)
    unit = given[0] if given else "mm"
    position = [f"{axis}_{unit}" for axis in "xyz"]
    check_present(header, names, position, _ADVICE)
    return position, unit


def _joints(header: Lines, names: list[str]) -> dict[str, tuple[str, str]]:
    joints: dict[str, tuple[str, str]] = {}
    for name in names:
        if not name.startswith("q_"):
            continue
        if (match := _JOINT.fullmatch(name)) is None:
            problem = "the unit of the joint value is missing or unknown; write q_<joint>_deg or q_<joint>_mm"
            raise header.error(problem, column=name)
        joint = match["joint"]
        if joint in joints:
            raise header.error(f"joint '{joint}' already has the column {joints[joint][0]}; keep one", column=name)
        joints[joint] = name, match["unit"]
    return joints


def _as_text(recording: Recording, path: Path) -> Mapping[str, Sequence[str]]:
    """Column name -> N cells, which can be read back."""
    position, unit = _exact(recording.p_world_sensor, "mm", "m")
    numbers = {f"{axis}_{unit}": values for axis, values in zip("xyz", position.T, strict=True)}
    if recording.R_world_sensor is not None:
        quat_wxyz = quat_wxyz_from_rotation(recording.R_world_sensor)
        numbers |= dict(zip(_QUATERNION, quat_wxyz.T, strict=True))
    if recording.time_s is not None:
        numbers["time_s"] = recording.time_s
    if recording.variance is not None:
        numbers |= dict(zip(_SIGMAS, np.sqrt(recording.variance / _VARIANCE).T, strict=True))
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
