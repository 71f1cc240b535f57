"""Whether a part of the poses is from another sensor, or from one mounted anew: docs/estimation.md, "Two sensors".

Which poses is either known, as those of a placement, or not, as with two tools under one name. Then the residuals fall
into two groups a constant displacement of the sensor apart.
"""

from dataclasses import dataclass

import numpy as np

from solvers.estimate import Note
from solvers.likelihood.linearise import Linearisation
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus
from solvers.verdict.change import FREEDOM, SENSOR, UNSEEN, rows_of
from solvers.verdict.f_test import f_tail

LEAST_POSES = 12
"""Fewest poses of a group."""
LEAST_GAP = 5.0
"""Standard deviations between the two groups. A sag or a play that sways with an angle splits into groups at most 4.1 of
their own apart, as the halves of a sine do."""
FALSE_ALARM = 1e-6
"""Probability of naming a sensor of its own where there is none, under independent noise."""
STARTS = 6
ITERATIONS = 60
SETTLED = 1e-6


@dataclass(frozen=True, eq=False)
class Displacement:
    """Of the sensor, at some of the poses."""

    delta: Array
    """(6,) shift and turn [v, w] in the carm frame, m and rad; 0 where it is not seen."""
    probability: float
    """That noise alone lowers the sum of squares as much."""
    lowered: float
    """By how much the weighted sum of squares falls."""

    def in_words(self, torus: Torus) -> str:
        """Its size at the sensor. The turn about the orbital axis is not seen: the least shift is told."""
        p = np.linalg.solve(torus.T_sensor_carm[:3, :3], -torus.T_sensor_carm[:3, 3])
        v, w = self.delta[:3], self.delta[3:]
        about_axis = np.cross([0.0, 1.0, 0.0], p)
        shift = v + np.cross(w, p)
        shift = shift - about_axis * (shift @ about_axis) / max(about_axis @ about_axis, 1e-12)
        return f"{np.linalg.norm(shift) * 1e3:.1f} mm and {np.degrees(np.linalg.norm(w[[0, 2]])):.2f} deg"


def two_sensors_of(
    problem: Problem, torus: Torus, angles: Array, sigma: tuple[float, float], line: Linearisation, numbers: np.ndarray
) -> Note | None:
    """A cause of a misfit from the residuals ``line`` of a problem's poses at ``angles`` (2, n): `two_sensors`, or
    `sensor_moved` between placements. ``numbers`` (n,) are the poses' among all."""
    if len(problem) < 2 * LEAST_POSES:
        return None
    rows = rows_of(line, angles, problem, sigma, flex=False)
    apart = _groups(rows)
    if apart is not None:
        found = displaced(rows, problem, apart)
        few = apart if apart.mean() <= 0.5 else ~apart
        if found.probability < FALSE_ALARM:
            return Note(
                "two_sensors",
                f"{few.sum()} of {len(few)} poses are of a sensor {found.in_words(torus)} beside that of the others "
                f"(poses {_listed(numbers[few])}): two tools under one name, or one that slips to and fro; keep one",
            )
    return _between_placements(rows_of(line, angles, problem, sigma, flex=True), problem, torus)


def _between_placements(rows: Array, problem: Problem, torus: Torus) -> Note | None:
    """The placement whose sensor stands most clearly elsewhere, no function of the angles explaining it."""
    if problem.placements < 2:
        return None
    tests = [displaced(rows, problem, problem.placement == p) for p in range(problem.placements)]
    p = int(np.argmin([test.probability for test in tests]))
    if tests[p].probability * problem.placements > FALSE_ALARM:
        return None
    first = int(np.flatnonzero(problem.placement == p)[0])
    return Note(
        "sensor_moved",
        f"the sensor seems to have been moved on the C by about {tests[p].in_words(torus)} between placements: that of "
        f"placement {p + 1}, from its pose {first} on, stands elsewhere than at the others; calibrate each by itself",
    )


def displaced(rows: Array, problem: Problem, poses: np.ndarray) -> Displacement:
    """The test of a displacement of the sensor at the ``poses`` (n,), a mask, with all unknowns of the machine as
    nuisance; ``rows`` (6, C, n) are those of `solvers.verdict.change.rows_of`."""
    P, width = problem.placements, rows.shape[1] - 1
    size = 6 * P + width - 6
    own = np.concatenate([rows[:, SENSOR] * poses, rows[:, -1:]], axis=1)
    H, D, E = np.zeros((size, size)), np.zeros((size, 7)), np.einsum("rin,rkn->ik", own, own)
    for p in range(P):
        here = problem.placement == p
        index = np.concatenate([6 * p + np.arange(6), 6 * P + np.arange(width - 6)])
        U = rows[:, :-1, here]
        H[np.ix_(index, index)] += np.einsum("rin,rkn->ik", U, U)
        D[index] += np.einsum("rin,rkn->ik", U, own[..., here])
    scale = 1 / np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    values, vectors = np.linalg.eigh(H * np.outer(scale, scale))
    kept = values > 1e-12 * values[-1]
    V = (scale[:, None] * vectors[:, kept]) / np.sqrt(values[kept])
    S = E - (V.T @ D).T @ (V.T @ D)
    diagonal = np.diagonal(E)[:6]
    unit = 1 / np.sqrt(np.where(diagonal > 1e-9 * diagonal.max(), diagonal, np.inf))
    values, vectors = np.linalg.eigh(S[:6, :6] * np.outer(unit, unit))
    seen = values > UNSEEN
    z = (vectors.T @ (S[:6, 6] * unit))[seen]
    delta = -unit * (vectors[:, seen] @ (z / values[seen]))
    lowered, rank = float((z**2 / values[seen]).sum()), int(seen.sum())
    dof = FREEDOM * len(problem) - int(kept.sum()) - rank
    if not rank or dof <= 0:
        return Displacement(delta, 1.0, 0.0)
    F = lowered / rank / max((float(S[6, 6]) - lowered) / dof, 1e-3)
    return Displacement(delta, f_tail(rank, dof, F), lowered)


def _groups(rows: Array) -> np.ndarray | None:
    """(n,) the poses of one of two groups of residuals, where these are at least `LEAST_GAP` apart.

    Two constant displacements by turns: assign each pose to the nearer one, fit each to its poses. Along the line
    between them a pose's residual is at 0 or 1, and the spread about these is the measure of the gap.
    """
    D, y = np.moveaxis(rows[:, SENSOR], -1, 0), -np.moveaxis(rows[:, -1], -1, 0)
    n, best = len(y), None
    information, pull = np.einsum("nri,nrk->nik", D, D), np.einsum("nri,nr->ni", D, y)
    far = np.argsort(-(y**2).sum(axis=1))
    for k in range(STARTS):
        # a start from the poses whose residuals lie to one side, as those of one with a great residual do
        seed = far[k * n // (4 * STARTS)]
        moved = D @ _fit(information[seed], pull[seed])
        second = np.einsum("nr,nr->n", moved, y - 0.5 * moved) > 0
        for _ in range(ITERATIONS):
            if min(second.sum(), (~second).sum()) < LEAST_POSES:
                break
            a, b = (_fit(information[part].sum(axis=0), pull[part].sum(axis=0)) for part in (~second, second))
            between, rest = D @ (b - a), y - D @ a
            new = np.einsum("nr,nr->n", between, rest - 0.5 * between) > 0
            if (new == second).all():
                along = np.einsum("nr,nr->n", between, rest) / np.maximum((between**2).sum(axis=1), 1e-12)
                spread = float(np.sqrt(np.mean((along - second) ** 2)))
                if best is None or spread < best[0]:
                    best = spread, second
                break
            second = new
    return best[1] if best and best[0] * LEAST_GAP <= 1 else None


def _fit(H: Array, g: Array) -> Array:
    """The displacement (6,) of the least squares, none in the directions that the poses do not see."""
    scale = 1 / np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    return scale * np.linalg.lstsq(H * np.outer(scale, scale), g * scale, rcond=1e-9)[0]


def _listed(numbers: np.ndarray) -> str:
    return ", ".join(map(str, numbers[:5])) + (f", ... {numbers[-1]}" if len(numbers) > 5 else "")
