"""Likely causes of poses that do not fit, tried one by one."""

from dataclasses import replace

import numpy as np

from solvers import kinematic
from solvers.estimate import Estimate
from solvers.problem import Problem

MIN_POSES = 6
"""Fewer rejected poses than this are not asked for a cause."""
CONTIGUOUS = 0.8
"""Share of rejected poses within the stretch that they span, from which on they count as one stretch."""


def base_moved_at(problem: Problem, estimate: Estimate) -> int | None:
    """The first pose after the base was moved, or None.

    Tried where the rejected poses form one stretch of one placement at its beginning or end: the stretch is
    given a placement of its own, and the cause is accepted if most of it then agrees with the same machine.
    """
    rejected = np.flatnonzero(~estimate.used) if estimate.used is not None else np.zeros(0, dtype=int)
    if len(rejected) < MIN_POSES or problem.R_world_sensor is None:
        return None
    placement = np.bincount(problem.placement[rejected]).argmax()
    here = np.flatnonzero(problem.placement == placement)
    ours = np.isin(here, rejected)
    change = _best_split(ours)
    if change is None:
        return None
    stretch = here[:change] if ours[:change].mean() > ours[change:].mean() else here[change:]
    moved = problem.placement.copy()
    moved[stretch] = problem.placements
    try:
        fit = kinematic.solve(replace(problem, placement=moved))
    except np.linalg.LinAlgError:
        return None
    explained = fit.used is not None and fit.used[stretch].mean() > CONTIGUOUS
    return int(here[change]) if explained else None


def _best_split(rejected: np.ndarray) -> int | None:
    """Where a sequence of flags is best cut into kept and rejected; None if it is no such sequence."""
    n = len(rejected)
    before = np.concatenate([[0], np.cumsum(rejected)])
    after = before[-1] - before
    cut = np.arange(n + 1)
    errors = np.minimum(before + (n - cut - after), (cut - before) + after)
    best = int(np.argmin(errors))
    enough = min(best, n - best) >= MIN_POSES
    return best if enough and errors[best] <= (1 - CONTIGUOUS) * rejected.sum() else None
