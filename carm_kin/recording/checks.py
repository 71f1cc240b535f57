"""What is checked of a recording's arrays."""

from collections.abc import Iterable

import numpy as np

from carm_kin.errors import InputError
from solvers.se3 import Array

ROTATION_TOLERANCE = 1e-3
"""Largest entry of ``R Rᵀ - I`` that is taken for rounding."""
LABEL_TOLERANCE_RAD = float(np.radians(1e-6))
"""How far the labels of a joint may differ and still be the same."""
LABEL_TOLERANCE_M = 1e-9
"""The same for a prismatic joint."""
WANDER_RAD = float(np.radians(0.05))
"""How far the readings of a held joint may wander within a sweep, whatever their digits."""
WANDER_M = 5e-5
"""The same for a prismatic joint."""
WANDER_STEPS = 1.5
"""So many steps of the last digit are allowed, too: a display flips between two neighbours."""
REPEATED = "identical to the pose before"
"""What the list of outliers says of them."""
REPEATED_TOLERANCE = 1e-6
"""Poses are identical up to this, m and entries of the rotation matrix: rounding to single precision."""
OPTIONAL_COLUMNS = ("time_s", "sweep", "moving", "placement")
"""What a recording may say of each pose, next to the joints' values."""


class PoseError(InputError):
    """Bad data at one pose. A reader that knows where the pose stands in its file says so instead."""

    def __init__(self, problem: str, pose: int, column: str):
        super().__init__(problem, file=f"pose {pose}", column=column)
        self.problem = problem
        self.pose = pose
        self.column = column

    def __reduce__(self) -> tuple:
        return type(self), (self.problem, self.pose, self.column)


def numeric(name: str, values: object, shape: tuple[int, ...], unknown: bool = False) -> Array:
    """Float array of the given shape; finite, or NaN where `unknown` allows it."""
    array = floats(name, values)
    if array.shape != shape:
        raise InputError(f"{name} has the shape {array.shape}; {shape} is needed")
    bad = np.isinf(array) if unknown else ~np.isfinite(array)
    if bad.any():
        pose = int(np.argwhere(bad)[0, 0])
        raise PoseError("the value is empty or not finite", pose, name)
    return array


def floats(name: str, values: object) -> Array:
    """Float array of any shape."""
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is not an array of numbers: {error}") from None


def rotations(values: object, n: int) -> Array:
    """(N, 3, 3) array of rotations, as they are given."""
    R = numeric("R_world_sensor", values, (n, 3, 3))
    error = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))
    if np.any(bad := error > ROTATION_TOLERANCE):
        pose = int(np.argmax(bad))
        problem = (
            f"not a rotation: R Rᵀ differs from the identity by {error[pose]:.2g} (at most {ROTATION_TOLERANCE:g})"
        )
        raise PoseError(problem, pose, "R_world_sensor")
    if np.any(bad := np.einsum("ni,ni->n", np.cross(R[:, 0], R[:, 1]), R[:, 2]) < 0):
        problem = "a reflection, not a rotation: the frames must be right-handed"
        raise PoseError(problem, int(np.argmax(bad)), "R_world_sensor")
    return R


def transforms(name: str, values: object) -> Array:
    """(N, 4, 4) array of rigid motions; a single one counts as N = 1."""
    T = floats(name, values)
    T = T[None] if T.shape == (4, 4) else T
    T = numeric(name, T, (len(T) if T.ndim else 1, 4, 4))
    rotations(T[:, :3, :3], len(T))
    if np.any(bad := (T[:, 3] != (0, 0, 0, 1)).any(axis=1)):
        raise PoseError("the last row of a transform must be 0 0 0 1", int(np.argmax(bad)), name)
    return T


def text(name: str, values: Iterable[object], n: int) -> np.ndarray:
    """(N,) object array of str; fixed-width arrays would take N times the longest text."""
    labels = [str(value).strip() for value in values]
    if len(labels) != n:
        raise InputError(f"{name} has {len(labels)} entries for {n} poses")
    array = np.empty(n, dtype=object)
    array[:] = labels
    return array


def numbered(labels: np.ndarray) -> tuple[list[str], np.ndarray]:
    """The distinct labels in order of first appearance, and the (N,) number of each pose's label."""
    distinct = list(dict.fromkeys(labels))
    numbers = dict(zip(distinct, range(len(distinct)), strict=True))
    return distinct, np.fromiter(map(numbers.__getitem__, labels), int, len(labels))


def first_known(values: Array, group: np.ndarray, groups: int) -> Array:
    """(groups,) the first known value in every group, NaN where there is none; -1 is no group."""
    first = np.full(groups, np.nan)
    known = np.flatnonzero(np.isfinite(values) & (group >= 0))
    number, index = np.unique(group[known], return_index=True)
    first[number] = values[known[index]]
    return first


def mean_known(values: Array, group: np.ndarray, groups: int) -> tuple[Array, Array]:
    """(groups,) mean and standard deviation of the known values in every group, NaN where there is none; -1 is no
    group. The mean of equal values is that value."""
    first = first_known(values, group, groups)
    known = np.flatnonzero(np.isfinite(values) & (group >= 0))
    number = group[known]
    off = values[known] - first[number]
    count = np.maximum(np.bincount(number, minlength=groups), 1)
    mean = np.bincount(number, off, groups) / count
    return first + mean, np.sqrt(np.bincount(number, (off - mean[number]) ** 2, groups) / count)


def label_unit(prismatic: bool) -> tuple[float, float, str]:
    """How far the labels of a held joint may differ, and the scale to the unit in which they are shown."""
    return (LABEL_TOLERANCE_M, 1e3, "mm") if prismatic else (LABEL_TOLERANCE_RAD, 180 / np.pi, "deg")


def repeated(p_world_sensor: Array, R_world_sensor: Array | None) -> np.ndarray:
    """(N,) mask of the poses that equal the one before them, of positions (N, 3), m, and orientations (N, 3, 3).

    Of a frozen stretch the first pose stays, whatever the times and labels of the others. No tracker with noise
    measures the same pose twice, so they are no measurements. Where only positions were recorded, these decide.
    """
    again = np.zeros(len(p_world_sensor), dtype=bool)
    again[1:] = (np.abs(np.diff(p_world_sensor, axis=0)) <= REPEATED_TOLERANCE).all(axis=1)
    if R_world_sensor is not None:
        again[1:] &= (np.abs(np.diff(R_world_sensor, axis=0)) <= REPEATED_TOLERANCE).all(axis=(1, 2))
    return again
