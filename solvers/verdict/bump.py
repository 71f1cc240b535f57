"""Whether base or sensor were moved in mid-recording by too little for outliers.

Found by `solvers.verdict.change`, then confirmed.

A flex of the gantry, its play, noise that drifts and wrong labels make steps in time, too. A move of the base differs:
no function of the angles, no play and no ramp explains it better, and once its parts have a placement each, no step is
left.
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers import kinematic
from solvers.estimate import Estimate, Note
from solvers.likelihood.linearise import Linearisation, linearise
from solvers.problem import Problem
from solvers.se3 import Array, exp_se3, inverse, log_so3_small
from solvers.torus import Torus
from solvers.verdict.change import LEAST_POSES, SENSOR, Change, correlation_beside, most_likely, rows_of
from solvers.verdict.play import lowered_by_play

FALSE_ALARM = 1e-6
"""Probability of a change where there is none, under independent noise."""
QUIET = 0.01
"""Nothing is left if noise alone makes the greatest change with this probability;"""
CLEAR = 10.0
"""or if the first change explained so many times more than the next one would."""
CLEAR_OF_TWO = 5.0
"""The same of two moves."""
BETTER = 10.0
"""Moves have to lower the weighted sum of squares by so much more than a drift, a function of an angle or play."""
HARMFUL = 2.0
"""Standard deviations of the offset by which a move may change it without harm."""


@dataclass(frozen=True)
class Bump:
    """A move in mid-recording."""

    note: Note
    """`base_moved` or `sensor_moved`, with pose and size in words."""
    harmful: bool
    """Whether it exceeds the noise of a pose, or changes the offset by more than `HARMFUL`."""


def bump_of(
    problem: Problem, estimate: Estimate, angles: Array, sigma: tuple[float, float], line: Linearisation
) -> Bump | None:
    """The moves that explain the residuals ``line`` of the used poses at ``angles`` (2, n), if any do."""
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
    slip = most_likely(rows, part, of=SENSOR)
    if change is None or slip is None:
        return None
    of_sensor = slip.statistic > change.statistic
    lasts = correlation_beside(rows, part, slip, SENSOR) if of_sensor else correlation_beside(rows, part, change)
    slip, plain, change = slip.over(lasts), plain.over(lasts), change.over(lasts)
    if max(plain.probability, change.probability) > FALSE_ALARM:
        return None
    by_angle = (most_likely(rows, part, by=angle) for angle in angles)
    if any(rival.over(lasts).statistic + BETTER > change.statistic for rival in by_angle if rival):
        return None
    if lowered_by_play(rows, angles, part) / lasts + BETTER > max(slip.statistic, change.statistic):
        return None
    if slip.statistic > max(change.statistic, slip.drift) + BETTER:
        return _slip(torus, int(np.flatnonzero(used)[slip.pose]), slip.displacement, sigma)
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
        if fit.torus is None or fit.angles is None or fit.used is None or fit.used.sum() < LEAST_POSES:
            return None
        torus, used, angles, part = fit.torus, fit.used, fit.angles[fit.used].T, problem.select(fit.used)
        line = linearise(torus, angles, part)
        rows = rows_of(line, angles, part, sigma, flex=True)
        rest, other = most_likely(rows, part), most_likely(rows_of(line, angles, part, sigma, flex=False), part)
        if rest is None or other is None:
            return None
        lasts = correlation_beside(rows, part, rest)
        rest, other = rest.over(lasts), other.over(lasts)
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
    size = max(moves)
    bias = np.abs(fit.torus.offset - offset) / np.sqrt(np.diagonal(fit.covariance.block("offset")))
    first, *others = sorted(poses)
    also = "".join(f", and again at pose {pose}" for pose in others)
    words = (
        f"the base seems to have been moved {_by(*size)} at pose {first}{also}; give each part a 'placement' of its own"
    )
    return Bump(Note("base_moved", words), _visible(size, (fit.sigma_t, fit.sigma_r)) or bias.max() > HARMFUL)


def _slip(torus: Torus, pose: int, displacement: Array, sigma: tuple[float, float]) -> Bump:
    """A move of the sensor on the C. Its turn about the orbital axis is not seen: that of the least shift is told."""
    p = inverse(torus.T_sensor_carm)[:3, 3]
    v, w = displacement[:3], displacement[3:]
    shift, about_axis = v + np.cross(w, p), np.cross([0.0, 1.0, 0.0], p)
    shift = shift - about_axis * (shift @ about_axis) / max(about_axis @ about_axis, 1e-12)
    size = float(np.linalg.norm(shift)), float(np.linalg.norm(w[[0, 2]]))
    words = f"the sensor seems to have been moved on the C {_by(*size)} at pose {pose}; calibrate each part by itself"
    return Bump(Note("sensor_moved", words), _visible(size, sigma))


def _by(shift: float, turn: float) -> str:
    return f"by about {shift * 1e3:.1f} mm and {np.degrees(turn):.2f} deg"


def _visible(size: tuple[float, float], sigma: tuple[float | None, float | None]) -> bool:
    """Whether shift or turn exceed the noise of one pose."""
    return size[0] > (sigma[0] or 0.0) or size[1] > (sigma[1] or 0.0)
