"""A session: the sweeps of a recording in one TOML file, each a tracker's file or a part of one, with its labels.

Keys at the top are those of `carm_kin.recording.declarations` and ``tracker``, the format; ``[defaults]`` holds what
the sweeps share. See docs/session.md.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np

from carm_kin.errors import InputError
from carm_kin.files import tables_of
from carm_kin.recording.declarations import Declarations
from carm_kin.typed import typed

T = TypeVar("T")

NAME = "session.toml"
MAX_BYTES = 10_000_000
"""A larger file is no session."""
MAX_SWEEPS = 100_000

_TABLE = re.compile(r"\s*\[\[?\s*([\w.-]+)\s*\]")
_KEY = re.compile(r"""\s*["']?([\w-]+)["']?\s*=""")


@dataclass(frozen=True)
class Tracker:
    """How the files are read; the declarations of `Declarations` under their names."""

    tracker: str | None = None
    """Name of the format; None: told by the content."""
    tool: str | None = None
    reference: str | None = None
    invert: bool = False
    unit: str | None = None
    quaternion: str | None = None
    euler: str | None = None
    left_handed: bool | None = None
    stations: bool = False
    """Average the frames of every stop of the C."""

    @property
    def declared(self) -> Declarations:
        """The same as the options of a reader."""
        return Declarations(**{f.name: getattr(self, f.name) for f in fields(Declarations) if hasattr(self, f.name)})


@dataclass(frozen=True)
class Sweep:
    """One sweep."""

    file: str = ""
    """The tracker's file, or a folder of files, below the folder of the session."""
    from_s: float | None = None
    """Poses from here on, in seconds after the file's first pose,"""
    to_s: float | None = None
    """up to here."""
    label: str = ""
    """Default: the number of the sweep."""
    moving: str = ""
    """The joint that moves; "" = unknown or several."""
    placement: str = ""
    held_deg: Mapping[str, float] = field(default_factory=dict)
    """Angles of joints that are held."""
    held_mm: Mapping[str, float] = field(default_factory=dict)
    """Positions of prismatic joints that are held."""


@dataclass(frozen=True)
class Session:
    """The content of a session file, checked."""

    path: Path
    sha256: str
    tracker: Tracker
    sweeps: tuple[Sweep, ...]
    lines: tuple[int, ...]
    """Where each sweep begins in the file."""

    def error(self, problem: str, sweep: int) -> InputError:
        """The error of a sweep, counted from 0."""
        return InputError(f"sweep {sweep + 1}: {problem}", file=self.path, line=self.lines[sweep])

    def file(self, sweep: int) -> Path:
        """The file of a sweep. Raises InputError where it lies outside of the session's folder."""
        folder = self.path.parent
        path = folder / self.sweeps[sweep].file
        if not path.resolve().is_relative_to(folder.resolve()):
            raise self.error(f"file '{self.sweeps[sweep].file}' lies outside of the folder of the session", sweep)
        return path


def read_session(path: Path) -> Session:
    """The session in a file. Raises InputError that names the key and the line."""
    from hashlib import sha256

    data = _bytes(path)
    try:
        tables = tables_of(data)
    except InputError as error:
        raise InputError(str(error), file=path) from None
    places = _places(data.decode("utf-8-sig"))
    defaults, sweeps = tables.pop("defaults", {}), tables.pop("sweep", [])
    tracker = _checked(Tracker, tables, path, places, "")
    if not isinstance(sweeps, list) or not sweeps:
        raise InputError("no [[sweep]] table; each has a 'file' and may have moving, held_deg, placement", file=path)
    if len(sweeps) > MAX_SWEEPS:
        raise InputError(f"{len(sweeps)} sweeps; at most {MAX_SWEEPS} are read", file=path)
    shared = _checked(Sweep, defaults, path, places, "defaults")
    found = tuple(_sweep(k, table, shared, path, places) for k, table in enumerate(sweeps))
    lines = tuple(places.get(_table(k), 1) for k in range(len(found)))
    session = Session(path, sha256(data).hexdigest(), tracker, found, lines)
    _check(session, places)
    return session


def _bytes(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise InputError("is not a file" if path.exists() else "no such file", file=path)
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"is larger than {MAX_BYTES // 1_000_000} MB, which is no session", file=path)
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None


def _table(sweep: int) -> str:
    return f"sweep[{sweep}]"


def _places(text: str) -> dict[str, int]:
    """Line of every table and of every key in it: ``sweep[0]``, ``sweep[0].moving``, ``tool``."""
    places: dict[str, int] = {}
    table, sweeps = "", 0
    for number, line in enumerate(text.splitlines(), 1):
        if match := _TABLE.match(line):
            table = match[1]
            if table == "sweep":
                table, sweeps = _table(sweeps), sweeps + 1
            elif table.startswith("sweep."):
                table = f"{_table(sweeps - 1)}{table.removeprefix('sweep')}"
            places.setdefault(table, number)
        elif match := _KEY.match(line):
            places.setdefault(f"{table}.{match[1]}" if table else match[1], number)
    return places


def _checked(kind: type[T], values: Any, path: Path, places: Mapping[str, int], table: str) -> T:
    """The dataclass of a table. Raises InputError at the key that is unknown or of a wrong type."""
    number = re.fullmatch(r"sweep\[(\d+)\]", table)
    where = f"sweep {int(number[1]) + 1}: " if number else f"{table}: " if table else ""
    if not isinstance(values, Mapping):
        raise InputError(f"'{table}' must be a table", file=path, line=places.get(table))
    hints = get_type_hints(kind)
    found = {}
    for key, value in values.items():
        line = places.get(f"{table}.{key}" if table else key, places.get(table))
        if key not in hints:
            raise InputError(f"{where}'{key}' is unknown; it may be {', '.join(hints)}", file=path, line=line)
        try:
            found[key] = typed(hints[key], value, f"{where}'{key}'")
        except InputError as error:
            raise InputError(str(error), file=path, line=line) from None
    return kind(**found)


def _sweep(k: int, table: Any, shared: Sweep, path: Path, places: Mapping[str, int]) -> Sweep:
    own = _checked(Sweep, table, path, places, _table(k))
    given = {name: getattr(own, name) for name in table}
    moving = given.get("moving", shared.moving)
    for name in ("held_deg", "held_mm"):
        others = {joint: value for joint, value in getattr(shared, name).items() if joint != moving}
        given[name] = {**others, **getattr(own, name)}
    found = replace(shared, **given)
    return replace(found, label=found.label or str(k + 1))


def _check(session: Session, places: Mapping[str, int]) -> None:
    """Raise InputError at a value that cannot be."""
    try:
        session.tracker.declared  # noqa: B018 - raises where an option has no such value
    except InputError as error:
        option = str(error).split()[0].removeprefix("--")
        raise InputError(str(error).replace("--", "", 1), file=session.path, line=places.get(option)) from None
    labels: dict[str, int] = {}
    for k, sweep in enumerate(session.sweeps):
        if not sweep.file:
            raise session.error("'file' is missing", k)
        if sweep.from_s is not None and sweep.to_s is not None and sweep.to_s <= sweep.from_s:
            raise session.error(f"to_s must be above from_s, not {sweep.to_s:g} and {sweep.from_s:g}", k)
        if sweep.moving in {*sweep.held_deg, *sweep.held_mm}:
            raise session.error(f"'{sweep.moving}' moves and cannot be held", k)
        if labels.setdefault(sweep.label, k) != k:
            raise session.error(f"label '{sweep.label}' is that of sweep {labels[sweep.label] + 1} too", k)
        if not session.file(k).exists():
            raise session.error(f"no file '{sweep.file}' in the folder of the session", k)


def files(session: Session) -> Iterator[tuple[Path, list[int]]]:
    """Every file and the numbers of its sweeps, in order of first appearance."""
    found: dict[Path, list[int]] = {}
    for k in range(len(session.sweeps)):
        found.setdefault(session.file(k).resolve(), []).append(k)
    for sweeps in found.values():
        yield session.file(sweeps[0]), sweeps


def poses_of(session: Session, sweep: int, time_s: np.ndarray | None, count: int) -> np.ndarray:
    """(N,) mask of a file's poses that belong to a sweep. Raises InputError where there is none."""
    entry = session.sweeps[sweep]
    if entry.from_s is None and entry.to_s is None:
        return np.ones(count, dtype=bool)
    if time_s is None:
        raise session.error(f"file '{entry.file}' has no times, which from_s and to_s need", sweep)
    since = time_s - time_s[0]
    low, high = (-np.inf if entry.from_s is None else entry.from_s), (np.inf if entry.to_s is None else entry.to_s)
    chosen = (since >= low) & (since <= high)
    if not chosen.any():
        raise session.error(
            f"no pose of '{entry.file}' lies between from_s and to_s; it lasts {since[-1]:.3g} s", sweep
        )
    return chosen
