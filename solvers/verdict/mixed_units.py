"""Positions of which a part is in another unit, told by their size alone.

A pose is a function of two angles, so that poses of nearly the same orientation have nearly the same position. Where
the distances from the tracker fall into two groups, and those of the nearest orientations differ by a power of ten, a
part of the file was written in another unit. A fit would take the smaller group, whose residuals are smaller by the
same factor.
"""

import numpy as np

from solvers.estimate import Note
from solvers.problem import Problem
from solvers.se3 import Array

LEAST_GAP = 0.5
"""Decades without a distance between the two groups,"""
LEAST_POSES = 3
"""and poses in either."""
POWERS = (1, 2, 3)
NEAREST = 0.2
"""Share of the smaller group, those with the nearest orientations in the other, that is asked."""
REACH_RAD = float(np.radians(30.0))
"""An orientation farther off tells nothing."""
TOLERANCE = 0.15
"""How far the median ratio may be from a power of ten, decades."""
TRIED = 500
"""Poses of either group that are compared."""


def mixed_units(problem: Problem) -> Note | None:
    """A refusal where a placement's positions come in two units."""
    if problem.R_world_sensor is None:
        return None
    for placement in range(problem.placements):
        here = np.flatnonzero(problem.placement == placement)
        found = _parts(problem.p_world_sensor[here], problem.R_world_sensor[here])
        if found is not None:
            small, power = found
            poses = here[small]
            return Note(
                "mixed_units",
                f"{len(poses)} of {len(here)} poses, from pose {poses[0]} to {poses[-1]}, have positions {10**power} "
                "times smaller than others of nearly the same orientation: a part of the file is in another unit; "
                "write all positions in one",
            )
    return None


def _parts(p: Array, R: Array) -> tuple[np.ndarray, int] | None:
    """The poses with the small positions, and the power of ten; None where there is one unit."""
    size = np.log10(np.maximum(np.linalg.norm(p, axis=1), 1e-12))
    order = np.argsort(size)
    gap = np.diff(size[order])[LEAST_POSES - 1 : len(p) - LEAST_POSES]
    if not gap.size or gap.max() < LEAST_GAP:
        return None
    cut = int(np.argmax(gap)) + LEAST_POSES
    small, large = (part[:: -(-len(part) // TRIED)] for part in (order[:cut], order[cut:]))
    trace = R[small].reshape(-1, 9) @ R[large].reshape(-1, 9).T
    nearest = trace.argmax(axis=1)
    angle = np.arccos(np.clip((trace.max(axis=1) - 1) / 2, -1, 1))
    asked = angle <= min(REACH_RAD, float(np.quantile(angle, NEAREST)))
    if not asked.any():
        return None
    decades = float(np.median((size[large[nearest]] - size[small])[asked]))
    power = round(decades)
    if power not in POWERS or abs(decades - power) > TOLERANCE:
        return None
    return np.sort(order[:cut]), power
