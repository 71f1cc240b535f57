"""Whether the base was moved in mid-recording by too little for outliers: found by `solvers.change`, then confirmed.

A flex of the gantry, noise that drifts and wrong labels make steps in time, too. A move of the base differs: no
function of the angles and no ramp explains it better, and once its parts have a placement each, no step is left.
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers import kinematic
from solvers.change import Change, most_likely, rows_of
from solvers.estimate import Estimate, Note
from solvers.likelihood import Linearisation, linearise
from solvers.problem import Problem
from solvers.se3 import Array, exp_se3, inverse, log_so3_small
from solvers.torus import Torus

FALSE_ALARM = 1e-6
"""Probability of a change where there is none, under independent noise."""
QUIET = 0.01
"""Nothing is left if noise alone makes the greatest change with this probability;"""
CLEAR = 10.0
"""or if the first change explained so many times more than the next one would."""
CLEAR_OF_TWO = 5.0
"""The same of two moves."""
BETTER = 10.0
"""Moves have to lower the weighted sum of squares by so much more than a drift or a function of an angle."""
HARMFUL = 2.0
"""Standard deviations of the offset by which a move may change it without harm."""


@dataclass(frozen=True, eq=False)
class Bump:
    """Moves of the base, m and rad; the sizes are those of the greatest."""

    poses: tuple[int, ...]
    """The first pose after each."""
    shift: float
    """Of the torus centre, m."""
    turn: float
    """rad."""
    harmful: bool
    """Whether it exceeds the noise of a pose, or changes the offset by more than `HARMFUL`."""

    @property
    def note(self) -> Note:
        """In words."""
        first, *others = self.poses
        also = "".join(f", and again at pose {pose}" for pose in others)
        return Note(
            "base_moved",
            f"the base seems to have been moved by about {self.shift * 1e3:.1f} mm and {np.degrees(self.turn):.2f} deg "
            f"at pose {first}{also}; give each part a 'placement' of its own",
        )


def bump_of(
    problem: Problem, estimate: Estimate, angles: Array, sigma: tuple[float, float], line: Linearisation
) -> Bump | None:
    """The moves of the base that explain the residuals ``line`` of the used poses at ``angles`` (2, n), if any do."""
    torus = estimate.torus
    used = np.ones(len(problem), dtype=bool) if estimate.used is None else estimate.used
    part = problem if used.all() else problem.select(used)
    if torus is None:
        return None
    plain = most_likely(rows_of(line, angles, part, sigma, flex=False), part)
    if plain is None or plain.probability > FALSE_ALARM:
        return None
    rows = rows_of(line, angles, part, sigma, flex=True)
    change = most_likely(rows, part)
    if change is None or change.probability > FALSE_ALARM:
        return None
    by_angle = (most_likely(rows, part, by=angle) for angle in angles)
    if any(rival.statistic + BETTER > change.statistic for rival in by_angle if rival):
        return None
    return _confirmed(problem, used, torus, sigma, plain, change)


def _confirmed(
    problem: Problem, used: np.ndarray, torus: Torus, sigma: tuple[float, float], plain: Change, change: Change
) -> Bump | None:
    """The bump, if the chain has no other change once the parts have a placement each; ``change`` is the most likely
    one, and ``plain`` that without a flex."""
    whole, offset, poses, explained, least = problem, torus.offset, [], plain.statistic, change.statistic
    for clear in (CLEAR, CLEAR_OF_TWO):
        poses.append(int(np.flatnonzero(used)[change.pose]))
        problem, start = _divided(problem, torus, poses[-1], change.displacement)
        try:
            fit = kinematic.refine(problem, start, kinematic.Options(), torus.non_orthogonality == 0.0, used)
        except np.linalg.LinAlgError:
            return None
        if fit.torus is None or fit.angles is None or fit.used is None:
            return None
        torus, used, angles, part = fit.torus, fit.used, fit.angles[fit.used].T, problem.select(fit.used)
        line = linearise(torus, angles, part)
        rest, other = (most_likely(rows_of(line, angles, part, sigma, flex), part) for flex in (True, False))
        if rest is None or other is None:
            return None
        quiet = len(poses) == 1 and rest.probability > QUIET
        if (quiet or rest.statistic * clear < least) and explained > plain.drift + BETTER:
            return _bump(whole, problem, fit, poses, offset)
        if quiet:
            return None
        explained += other.statistic
        change, least = rest, min(least, rest.statistic)
    return None


def _divided(problem: Problem, torus: Torus, pose: int, displacement: Array) -> tuple[Problem, Torus]:
    """The problem with a placement of their own for the poses of a placement from ``pose`` on, and a chain to start
    from."""
    p = int(problem.placement[pose])
    here = np.flatnonzero(problem.placement == p)
    moved = torus.T_world_torus[p] @ exp_se3(displacement)
    return problem.apart(here[here >= pose]), replace(
        torus,
        T_world_torus=np.concatenate([torus.T_world_torus, moved[None]]),
        referenced=np.append(torus.referenced, torus.referenced[p]),
    )


def _bump(whole: Problem, divided: Problem, fit: Estimate, poses: list[int], offset: Array) -> Bump | None:
    """What the fit to the ``divided`` problem tells of the moves at ``poses``; ``offset`` (3,) is that without them."""
    if fit.torus is None or fit.covariance is None:
        return None
    T, moves = fit.torus.T_world_torus, []
    for pose in poses:
        before = np.flatnonzero(whole.placement[:pose] == whole.placement[pose])[-1]
        old, new = T[divided.placement[before]], T[divided.placement[pose]]
        turn = log_so3_small((inverse(old) @ new)[None, :3, :3])[0]
        moves.append((float(np.linalg.norm(new[:3, 3] - old[:3, 3])), float(np.linalg.norm(turn))))
    shift, turn = max(moves)
    bias = np.abs(fit.torus.offset - offset) / np.sqrt(np.diagonal(fit.covariance.block("offset")))
    beyond = shift > (fit.sigma_t or 0.0) or turn > (fit.sigma_r or 0.0) or bias.max() > HARMFUL
    return Bump(tuple(sorted(poses)), shift, turn, bool(beyond))
