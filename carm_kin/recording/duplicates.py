"""Poses that are no measurements of their own: copies of earlier ones, and positions that stand still.

No tracker with noise gives the same numbers twice. A single pose may come again in data without noise or of coarse
steps; what counts as a copy is a stretch that comes again, a pose that comes three times, or a large share of the
poses.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from carm_kin.recording.checks import REPEATED, repeated
from solvers.estimate import Note
from solvers.se3 import Array

COPIED = "a copy of an earlier pose"
IDLE = "no angular motion in this placement"
STANDING = "the position stands still while the orientation turns"
"""What the list of outliers says of them."""
LEAST_RUN = 3
"""Poses in a row that come again in a row: a copied stretch."""
LEAST_TIMES = 3
"""Times that a pose, or a position, occurs."""
LEAST_SHARE = 0.2
"""Share of copies among all poses from which on each of them counts as one."""
TURNED = 0.05
"""Range of an entry of the rotation matrices from which on the sensor counts as turning: 3 degrees."""


@dataclass(frozen=True, eq=False)
class NotMeasured:
    """(N,) masks by what the list of outliers says of the poses; no pose is in two of them."""

    reasons: Mapping[str, np.ndarray]
    REASONS: ClassVar = (REPEATED, COPIED, STANDING)

    @staticmethod
    def of(p_world_sensor: Array, R_world_sensor: Array | None) -> "NotMeasured":
        """From positions (N, 3), m, and orientations (N, 3, 3)."""
        again = repeated(p_world_sensor, R_world_sensor)
        copy = copied(p_world_sensor, R_world_sensor) & ~again
        still = np.zeros_like(again)
        if R_world_sensor is not None:
            still = standing(p_world_sensor, R_world_sensor) & ~again & ~copy
        return NotMeasured({REPEATED: again, COPIED: copy, STANDING: still})

    @property
    def any_of(self) -> np.ndarray:
        """(N,) the poses to leave out."""
        return np.any([*self.reasons.values()], axis=0)

    def _count(self, reason: str) -> int:
        return int(self.reasons[reason].sum()) if reason in self.reasons else 0

    def notes(self) -> tuple[Note, ...]:
        """Warnings of the copies and of the positions at rest; those of `REPEATED` are the recording's own."""
        n = len(self.any_of)
        found = []
        if copies := self._count(COPIED):
            message = (
                f"{copies} of {n} poses are copies of earlier ones, as if a part was pasted twice; each counts once"
            )
            found.append(Note("copied_poses", message))
        if still := self._count(STANDING):
            message = (
                f"{still} of {n} poses have one and the same position while the orientation turns, as a tracker writes "
                "that lost the position; they were not used"
            )
            found.append(Note("position_at_rest", message))
        return tuple(found)


def copied(p_world_sensor: Array, R_world_sensor: Array | None) -> np.ndarray:
    """(N,) mask of the copies of earlier poses, equal in every digit."""
    n = len(p_world_sensor)
    shared = _groups(p_world_sensor) >= 0
    first = np.arange(n)
    members = np.flatnonzero(shared)
    whole = (
        p_world_sensor if R_world_sensor is None else np.column_stack([p_world_sensor, R_world_sensor.reshape(n, 9)])
    )
    group = _groups(whole[members])
    for g in range(group.max(initial=-1) + 1):
        same = members[group == g]
        first[same] = same[0]
    copy = first != np.arange(n)
    times = np.bincount(first, minlength=n)[first]
    if copy.sum() > LEAST_SHARE * n:
        return copy
    return copy & ((times >= LEAST_TIMES) | _in_a_run(copy, first))


def standing(p_world_sensor: Array, R_world_sensor: Array) -> np.ndarray:
    """(N,) mask of the poses whose position occurs at least `LEAST_TIMES` times, in every digit, while they turn."""
    still, group = np.zeros(len(p_world_sensor), dtype=bool), _groups(p_world_sensor)
    for g in range(group.max(initial=-1) + 1):
        here = np.flatnonzero(group == g)
        still[here] = len(here) >= LEAST_TIMES and np.ptp(R_world_sensor[here], axis=0).max() > TURNED
    return still


def _in_a_run(copy: np.ndarray, first: np.ndarray) -> np.ndarray:
    """The copies that stand in at least `LEAST_RUN` in a row, as the poses they were copied from do."""
    goes_on = np.zeros(len(copy), dtype=bool)
    goes_on[1:] = copy[1:] & copy[:-1] & (np.abs(np.diff(first)) == 1)
    run = np.cumsum(~goes_on)
    return copy & (np.bincount(run)[run] >= LEAST_RUN)


def _groups(rows: Array) -> np.ndarray:
    """(N,) number of each row's group of equal rows, -1 of a row that has no equal."""
    n, number = len(rows), np.full(len(rows), -1)
    if not n:
        return number
    order = np.lexsort(rows.T)
    new = np.ones(n, dtype=bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    group = np.cumsum(new) - 1
    counts = np.bincount(group)
    numbers = np.where(counts > 1, np.cumsum(counts > 1) - 1, -1)
    number[order] = numbers[group]
    return number
