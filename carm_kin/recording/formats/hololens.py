"""HoloLens logs: JSON objects ``{Tx, Ty, Tz, Rx, Ry, Rz}`` of Unity, or lines of ticks and a 4x4 matrix row by row.

Metres. Unity's frames are left-handed and its Euler angles, in degrees, are of the order YXZ; an app may have converted
them, so that the handedness must be stated. The lines of ticks (100 ns) are those of the research mode's recorder, in
the right-handed frames of Windows.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats._foreign import head_lines, lines_of, read_cells
from carm_kin.recording.formats._table import read_bytes
from carm_kin.recording.raw import Raw, Track
from carm_kin.recording.recording import Source
from solvers.se3 import Array

SUMMARY = "HoloLens log: JSON of Tx..Rz (Unity), or lines of ticks and a 4x4 matrix (research mode)"

MAX_BYTES = 10**9
TOOL = "headset"

_KEYS = ("tx", "ty", "tz", "rx", "ry", "rz")
_TICK_S = 1e-7
_MATRIX = [f"m{row}{column}" for row in range(1, 5) for column in range(1, 5)]
_TIMES = ("time_s", "time", "timestamp", "t")


def matches(path: Path, head: bytes) -> bool:
    """A JSON text with the keys Tx and Rz, or a first line of 17 numbers between commas."""
    if head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] in (b"{", b"["):
        low = head.lower()
        return b'"tx"' in low and b'"rz"' in low
    lines = head_lines(head, 1)
    cells = lines[0].split(",") if lines else []
    return len(cells) == 17 and all(_is_number(cell) for cell in cells)


def read(path: Path, declared: Declarations) -> Raw:
    """The poses of the headset."""
    with_json = path.is_file() and path.open("rb").read(100).removeprefix(b"\xef\xbb\xbf").lstrip()[:1] in (b"{", b"[")
    return _of_json(path, declared) if with_json else _of_lines(path)


def _of_lines(path: Path) -> Raw:
    lines, source = lines_of(path, "lines of a time in ticks and 16 numbers")
    names = ["ticks", *_MATRIX]
    found = read_cells(lines, names, names)
    T = found.stack(_MATRIX).reshape(-1, 4, 4)
    if (T[:, 3] == (0, 0, 0, 1)).all(axis=1).mean() < (T[:, :, 3] == (0, 0, 0, 1)).all(axis=1).mean():
        T = np.swapaxes(T, 1, 2)
    ticks = found.numbers["ticks"]
    time_s = (ticks - ticks[0]) * _TICK_S if len(ticks) else ticks
    return Raw({TOOL: Track(T[:, :3, 3], T[:, :3, :3])}, source, "m", time_s=time_s, cut_off=found.cut_off)


def _of_json(path: Path, declared: Declarations) -> Raw:
    data = read_bytes(path, MAX_BYTES)
    poses = _objects(path, data)
    numbers = np.array([_numbers(path, i, pose) for i, pose in enumerate(poses)]).reshape(-1, len(_KEYS))
    source = Source(str(path), hashlib.sha256(data).hexdigest())
    unity = "YXZ" if declared.left_handed else None
    track = Track(numbers[:, :3], numbers[:, 3:])
    return Raw({TOOL: track}, source, "m", euler=unity, left_handed=None, time_s=_time(path, poses))


def _objects(path: Path, data: bytes) -> list[dict[str, Any]]:
    """The poses of a list, of the only list in an object, or of a line each; keys in lower case."""
    try:
        text = data.decode("utf-8-sig")
        lines = text.splitlines()
        one_a_line = len(lines) > 1 and lines[0].strip().startswith("{") and lines[0].strip().endswith("}")
        found: Any = [json.loads(line) for line in lines if line.strip()] if one_a_line else json.loads(text)
    except UnicodeDecodeError:
        raise InputError("is not UTF-8; save the file as UTF-8", file=path) from None
    except json.JSONDecodeError as error:
        raise InputError(f"is not JSON: {error.msg}", file=path, line=error.lineno) from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"is not JSON: {error}", file=path) from None
    if isinstance(found, dict) and _KEYS[0] not in map(str.lower, found):
        lists = [value for value in found.values() if isinstance(value, list)]
        found = lists[0] if len(lists) == 1 else found
    poses = found if isinstance(found, list) else [found]
    for i, pose in enumerate(poses):
        if not isinstance(pose, dict):
            raise InputError(f"entry {i + 1} is no object with Tx, Ty, Tz, Rx, Ry, Rz", file=path)
    return [{key.lower(): value for key, value in pose.items()} for pose in poses]


def _numbers(path: Path, i: int, pose: dict[str, Any]) -> list[float]:
    values = []
    for key in _KEYS:
        if key not in pose:
            raise InputError(f"entry {i + 1} has no {key.capitalize()}", file=path)
        value = pose[key]
        if value is not None and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise InputError(f"entry {i + 1}: {key.capitalize()} is no number", file=path)
        values.append(np.nan if value is None else float(value))
    return values


def _time(path: Path, poses: list[dict[str, Any]]) -> Array | None:
    """(N,) s, of a key that every pose has and that holds numbers."""
    for key in _TIMES:
        values = [pose.get(key) for pose in poses]
        if all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values):
            return np.array(values, dtype=float)
    return None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
