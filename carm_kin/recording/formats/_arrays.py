"""Arrays by name as a tracker's file: of matrices, or of positions with rotations beside them. No format itself."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.raw import Raw, Track
from carm_kin.recording.recording import Source
from solvers.se3 import Array

NEEDED = "needed are matrices (N, 4, 4), or p (N, 3) with R (N, 3, 3) or quat (N, 4); time_s (N,) may be there"

_POSITION, _ROTATION = ("p", "t", "position", "positions", "translation"), ("R", "rotation", "rotations")
_QUATERNION = {"quat": None, "quaternion": None, "quaternions": None, "quat_wxyz": "wxyz", "quat_xyzw": "xyzw"}
_TIMES = ("time_s", "time", "times", "timestamps")
_UNITS = ("mm", "cm", "m")


def raw_of(arrays: Mapping[str, np.ndarray], source: Source, path: Path) -> Raw:
    """The tools in arrays: every array of 4x4 matrices is one, called as the array without its unit.

    The unit is the end of the name, ``T_world_sensor_mm``. Raises InputError where there are no poses, or
    arrays of different length.
    """
    numeric = {name: values for name, values in arrays.items() if values.dtype.kind in "fiu" and values.size}
    found = {name: _matrices(values) for name, values in numeric.items()}
    tracks = {_split(n)[0]: Track(T[:, :3, 3], T[:, :3, :3]) for n, T in found.items() if T is not None}
    units = {_split(name)[1] for name, T in found.items() if T is not None}
    quaternion = None
    if not tracks:
        track, unit, quaternion = _beside(numeric, path)
        tracks, units = {"sensor": track}, {unit}
    if len({len(track) for track in tracks.values()}) > 1:
        counts = ", ".join(f"{name} {len(track)}" for name, track in tracks.items())
        raise InputError(f"the arrays have different numbers of poses: {counts}", file=path)
    if len(units) > 1:
        raise InputError(f"the arrays are in different units: {', '.join(map(str, units))}", file=path)
    n = len(next(iter(tracks.values())))
    time_s = next((numeric[name].ravel().astype(float) for name in _TIMES if name in numeric), None)
    if time_s is not None and len(time_s) != n:
        raise InputError(f"there are {len(time_s)} times for {n} poses", file=path)
    return Raw(tracks, source, units.pop(), quaternion, time_s=time_s)


def _split(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit."""
    short, _, unit = name.rpartition("_")
    return (short, unit) if short and unit in _UNITS else (name, None)


def _matrices(values: np.ndarray) -> Array | None:
    """(N, 4, 4), also of one matrix or of MATLAB's (4, 4, N); None where they are none."""
    if values.shape == (4, 4):
        values = values[None]
    if values.ndim != 3 or (values.shape[1:] != (4, 4) and values.shape[:2] != (4, 4)):
        return None
    T = np.asarray(values, dtype=float)
    stacked_last = np.moveaxis(T, 2, 0) if T.shape[:2] == (4, 4) else None
    if T.shape[1:] != (4, 4):
        return stacked_last
    if stacked_last is not None and _last_rows(stacked_last) > _last_rows(T):
        return stacked_last
    return T


def _last_rows(T: Array) -> float:
    """Share of matrices (N, 4, 4) that end in the row 0 0 0 1."""
    return float((T[:, 3] == (0, 0, 0, 1)).all(axis=1).mean())


def _beside(arrays: Mapping[str, np.ndarray], path: Path) -> tuple[Track, str | None, str | None]:
    """The one tool whose positions and rotations have arrays of their own, its unit and its order of quaternions."""
    names = {_split(name)[0]: name for name in arrays}
    position = next((names[short] for short in _POSITION if short in names), None)
    matrix = next((names[short] for short in _ROTATION if short in names), None)
    quat = next((short for short in _QUATERNION if short in names), None)
    if position is None or (matrix is None and quat is None):
        raise InputError(f"holds no poses but {', '.join(arrays) or 'nothing'}; {NEEDED}", file=path)
    p = np.asarray(arrays[position], dtype=float)
    rotation = np.asarray(arrays[matrix or names[quat or ""]], dtype=float)
    n = p.shape[0] if p.ndim == 2 else 0
    if matrix and rotation.shape == (3, 3, n) and n != 3:
        rotation = np.moveaxis(rotation, 2, 0)
    if p.shape != (n, 3) or rotation.shape != ((n, 3, 3) if matrix else (n, 4)):
        raise InputError(f"'{position}' has the shape {p.shape}, its rotations {rotation.shape}; {NEEDED}", file=path)
    return Track(p, rotation), _split(position)[1], None if matrix else _QUATERNION[quat or ""]
