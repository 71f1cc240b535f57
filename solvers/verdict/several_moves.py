"""Whether the base was moved several times in a recording: docs/estimation.md, "Two sensors".

One move after the other is given a placement of its own, each at the most likely pose, until none is left. Noise that
is correlated and a machine that bends leave some at every step; only moves come to an end, and leave far less noise.
"""

from dataclasses import replace

import numpy as np

from solvers import kinematic
from solvers.estimate import Estimate, Note
from solvers.likelihood.linearise import linearise
from solvers.problem import Problem
from solvers.se3 import exp_se3
from solvers.torus import Torus
from solvers.verdict.change import Change, most_likely, rows_of
from solvers.verdict.play import with_play

MOST_MOVES = 5
FALSE_ALARM = 1e-6
"""Probability of a change where there is none, under independent noise, at which the search begins,"""
QUIET = 1e-3
"""and that at which it ends."""
QUIETER = 1.3
"""Ratio of the noise of positions or orientations before and after, from which on moves are told."""
TRIED = 800
"""Poses on which it is looked for."""


def several_moves_of(problem: Problem, estimate: Estimate) -> Note | None:
    """`base_moved` of two and more moves within a problem that the ``estimate`` explains as one."""
    used = np.ones(len(problem), dtype=bool) if estimate.used is None else estimate.used
    poses = np.flatnonzero(used)
    poses = poses[:: -(-len(poses) // TRIED)]
    if estimate.torus is None or problem.placements > 1:
        return None
    part, torus, first, found = problem.select(poses), estimate.torus, None, []
    for _ in range(MOST_MOVES + 1):
        fit = _fitted(part, torus)
        if fit is None or fit.torus is None:
            return None
        first, torus = first or fit, fit.torus
        change = _change(part, fit)
        if change is None or change.probability > (QUIET if found else FALSE_ALARM):
            break
        found.append(change.pose)
        part, torus = _divided(part, torus, change)
    else:
        return None
    gain = max(
        (a or 0.0) / max(b or 0.0, 1e-9) for a, b in ((first.sigma_t, fit.sigma_t), (first.sigma_r, fit.sigma_r))
    )
    if len(found) < 2 or gain < QUIETER:
        return None
    at = ", ".join(str(poses[pose]) for pose in sorted(found))
    return Note(
        "base_moved",
        f"the base seems to have been moved {len(found)} times, at about poses {at}; give each part a 'placement' of "
        "its own",
    )


def _fitted(problem: Problem, torus: Torus) -> Estimate | None:
    options = kinematic.Options(reject_outliers=False, max_iterations=15)
    try:
        return kinematic.refine(problem, torus, options, torus.non_orthogonality == 0.0)
    except np.linalg.LinAlgError:
        return None


def _change(problem: Problem, fit: Estimate) -> Change | None:
    if fit.torus is None or fit.angles is None:
        return None
    angles, sigma = fit.angles.T, (fit.sigma_t or 0.0, fit.sigma_r or 0.0)
    rows = rows_of(linearise(fit.torus, angles, problem), angles, problem, sigma, flex=False)
    return most_likely(with_play(rows, angles, problem), problem)


def _divided(problem: Problem, torus: Torus, change: Change) -> tuple[Problem, Torus]:
    """The problem with one more placement, from the pose of the change on, and a chain to start from."""
    p = int(problem.placement[change.pose])
    here = np.flatnonzero(problem.placement == p)
    moved = torus.T_world_torus[p] @ exp_se3(change.displacement)
    return problem.apart(here[here >= change.pose]), replace(
        torus,
        T_world_torus=np.concatenate([torus.T_world_torus, moved[None]]),
        referenced=np.append(torus.referenced, torus.referenced[p]),
    )
