"""Logs of one's own: a table with the columns x, y, z and qw, qx, qy, qz of each sensor, its name before or behind.

``Xa,Ya,Za,q0a,qxa,qya,qza`` is the sensor ``a``, ``head_pos_x,...,head_rot_w`` the sensor ``head``. Lines above the
header are passed over. Times are taken from a column that tells its unit, or from hour, minutes, seconds and ms.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats._foreign import Cells, delimiter_of, head_lines, lines_of, read_cells
from carm_kin.recording.raw import Raw, Track
from solvers.se3 import Array

SUMMARY = "any table with columns x, y, z, qw, qx, qy, qz for each sensor, as of a log of one's own"
GENERAL = True

_ABOVE = 20
"""Lines above the header."""
_POSITION, _QUATERNION = ("x", "y", "z"), ("qw", "qx", "qy", "qz")
_WORDS = {
    **{part: (f"position_{part}", f"pos_{part}", f"pos{part}", f"p{part}", f"t{part}", part) for part in _POSITION},
    **{f"q{part}": (f"rotation_{part}", f"rot_{part}", f"quat_{part}", f"q{part}") for part in _POSITION},
    "qw": ("rotation_w", "rot_w", "quat_w", "qw", "q0", "qo"),
}
_PART = dict(sorted(((w, part) for part, words in _WORDS.items() for w in words), key=lambda pair: -len(pair[0])))
"""What a column's name begins or ends with -> its part, the longest first."""
_TIME_S = {f"{name}{unit}": s for name in ("time", "timestamp", "t") for unit, s in (
    ("_s", 1.0), (" (s)", 1.0), ("_ms", 1e-3), (" (ms)", 1e-3), ("_us", 1e-6), ("_ns", 1e-9)
)}  # fmt: skip
_CLOCK_S = {"hour": 3600.0, "minutes": 60.0, "seconds": 1.0, "ms": 1e-3}
_DAY_S = 86400.0


def matches(path: Path, head: bytes) -> bool:
    """One of the first lines names all columns of a sensor."""
    return any(_sensors(_names(line)) for line in head_lines(head, _ABOVE))


def read(path: Path, declared: Declarations) -> Raw:
    """Every sensor that the header names. Raises InputError where there is none."""
    lines, source = lines_of(path, "a header with x, y, z, qw, qx, qy, qz")
    at = next((i for i, line in enumerate(lines.text[:_ABOVE]) if _sensors(_names(line))), None)
    if at is None:
        raise lines.error("no line names the columns x, y, z, qw, qx, qy, qz of a sensor")
    header, lines = lines.split(at + 1)
    if not lines.text:
        raise header.error("the file has a header but no poses below it", at)
    names = _names(header.text[at])
    sensors, times = _sensors(names), _times(names)
    wanted = dict.fromkeys([*(names[i] for columns in sensors.values() for i in columns.values()), *times])
    found = read_cells(replace(lines, delimiter=delimiter_of(header.text[at])), names, list(wanted))
    tracks = {}
    for sensor, columns in sensors.items():
        p, quat_wxyz = (found.stack([names[columns[part]] for part in parts]) for parts in (_POSITION, _QUATERNION))
        tracks[sensor] = Track(p, quat_wxyz)
    return Raw(tracks, source, None, "wxyz", time_s=_seconds(found, times), cut_off=found.cut_off)


def _names(line: str) -> list[str]:
    delimiter = delimiter_of(line)
    return [cell.strip(' "') for cell in line.rstrip().rstrip(delimiter).split(delimiter)]


def _sensors(names: Sequence[str]) -> dict[str, dict[str, int]]:
    """Sensor -> part -> its column, of those sensors that have all seven."""
    found: dict[str, dict[str, int]] = {}
    for i, name in enumerate(names):
        low = name.lower()
        for word, part in _PART.items():
            if low.startswith(word) or low.endswith(word):
                sensor = low[len(word) :] if low.startswith(word) else low[: -len(word)]
                found.setdefault(sensor.strip("_. "), {}).setdefault(part, i)
                break
    whole = {sensor: parts for sensor, parts in found.items() if len(parts) == len(_WORDS)}
    return {sensor or "sensor": parts for sensor, parts in whole.items()}


def _times(names: Sequence[str]) -> dict[str, float]:
    """The columns that make up the time, and what each counts in seconds."""
    low = {name.lower(): name for name in names}
    if _CLOCK_S.keys() <= low.keys():
        return {low[name]: seconds for name, seconds in _CLOCK_S.items()}
    return next(({low[name]: seconds} for name, seconds in _TIME_S.items() if name in low), {})


def _seconds(found: Cells, times: dict[str, float]) -> Array | None:
    """(N,) s, on past midnight where the clock begins anew."""
    if not times:
        return None
    time_s = np.sum([seconds * found.numbers[name] for name, seconds in times.items()], axis=0)
    return np.unwrap(time_s, period=_DAY_S) if len(times) > 1 else time_s
