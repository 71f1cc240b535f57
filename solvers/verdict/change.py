"""Where in a recording the base or the sensor may have been moved: a score scan over the poses. docs/estimation.md,
section 12.

The alternative "the poses from k on have ``T_world_torus (+) delta``", or ``T_sensor_carm (+) delta``, is tested at
the estimate for every k at once, with all angles and all unknowns of the machine as nuisance. The poses count as
ordered in time.
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers.likelihood.correlation import Stretches, correlation_of, correlation_time
from solvers.likelihood.f_test import f_tail
from solvers.likelihood.linearise import LOCAL, AngleModel, Linearisation
from solvers.likelihood.reduced import RESIDUAL, OwnAngles, row_scale, shape_roots, shaped, weighted
from solvers.problem import Problem
from solvers.se3 import Array, rot_y

LEAST_POSES = 6
"""A change is looked for no nearer to the ends of a placement."""
CANDIDATES = 250
"""Poses of a placement at which a change is looked for at first; then at every pose near the best of them."""
UNSEEN = 1e-6
"""Share of the information on a direction that the nuisance must leave for it to count as seen."""
EXACT = 1e-3
"""Mean square of the weighted residuals below which they are rounding, not noise."""
ROUNDING = 1e-9
"""Share of the greatest information below which that on another coordinate is rounding: a roll that no label sees."""
ORDERS = (1, 2, 3)
"""Harmonics of both angles that make up a flex."""
FREEDOM = 4
"""Residuals of a pose, less its two angles."""
BASE, SENSOR = slice(0, 6), slice(8, 14)
"""The local unknowns of which a move is tested."""


@dataclass(frozen=True, eq=False)
class Change:
    """The most likely move within a placement."""

    pose: int
    """The first pose after it."""
    displacement: Array
    """(6,) right perturbation [v, w] of what moved, m and rad; 0 where it is not seen."""
    statistic: float
    """By how much the change lowers the weighted sum of squares."""
    drift: float
    """By how much a drift through the same placement would, linear and quadratic in the number of the pose."""
    dof: tuple[int, int]
    """Directions of the change that are seen, and what is left of the residuals beside them."""
    variance: float
    """Mean square of the weighted residuals that the change leaves."""
    poses: int
    """At which a change was looked for."""
    correlation: float = 1.0
    """For how many poses the noise lasts: the statistics are divided by it."""

    @property
    def probability(self) -> float:
        """That noise alone makes so great a statistic anywhere (a bound)."""
        seen, left = self.dof
        if min(seen, left) <= 0:
            return 1.0
        F = self.statistic / seen / max(self.variance, EXACT)
        return min(1.0, self.poses / self.correlation * f_tail(seen, max(left / self.correlation, 1.0), F))

    def over(self, correlation: float) -> "Change":
        """The same where the noise lasts for so many poses."""
        by = correlation / self.correlation
        return replace(self, statistic=self.statistic / by, drift=self.drift / by, correlation=correlation)


def rows_of(line: Linearisation, angles: Array, problem: Problem, sigma: tuple[float, float], flex: bool) -> Array:
    """The weighted columns of the poses (6, C, N), each less what the pose's own angles take of it. Their products are
    the information and the gradient.

    C are the 14 local unknowns, those of a ``flex`` (position and rotation by `ORDERS` of both angles), and last the
    residual. Both angles count as unknown at every pose: labels and readings, which may be wrong, play no part.
    """
    model = AngleModel.of(problem.without_labels())
    B, A = weighted(line, model, sigma)
    waves = [_flex(angles, line, model, sigma)] if flex else []
    B = np.concatenate([B[:, :LOCAL], *waves, B[:, RESIDUAL:]], axis=1)
    return OwnAngles.of(B, A, model, np.zeros_like(angles)).left_of(B, A)


def most_likely(rows: Array, problem: Problem, by: Array | None = None, of: slice = BASE) -> Change | None:
    """The change that lowers the sum of squares most, from `rows_of`; None where there is none to look for. The poses
    are ordered ``by`` (N,), in time unless given; what moves is the `BASE` or the `SENSOR`."""
    normal = _Normal.of(rows, problem)
    best: Change | None = None
    for p in range(problem.placements):
        here = np.flatnonzero(problem.placement == p)
        first, last = LEAST_POSES, len(here) - LEAST_POSES
        if last < first:
            continue
        if by is not None:
            here = here[np.argsort(by[here])]
        U = rows if by is None and problem.placements == 1 else rows[..., here]
        products = np.einsum("rin,rkn->ikn", U[:, of], U)
        step = max(1, len(here) // CANDIDATES)
        cuts = np.arange(first, last + 1, step)
        after = _after(products, cuts)
        near = cuts[np.argmax(normal.lowered(p, after, after[..., of])[0])]
        cuts = np.arange(max(first, near - step), min(last, near + step) + 1)
        after = _after(products, cuts)
        lowered, seen, delta = normal.lowered(p, after, after[..., of])
        k = int(np.argmax(lowered))
        if best is None or lowered[k] > best.statistic:
            dof = FREEDOM * len(problem) - normal.rank - seen[k]
            best = Change(
                pose=int(here[cuts[k]]),
                displacement=delta[k],
                statistic=float(lowered[k]),
                drift=_drift(normal, p, products, of),
                dof=(int(seen[k]), int(dof)),
                variance=float(normal.cost - lowered[k]) / max(dof, 1),
                poses=len(problem),
            )
    return best


def left_of(rows: Array, problem: Problem) -> float:
    """The weighted sum of squares that the columns of `rows_of` leave of the residuals."""
    return _Normal.of(rows, problem).cost


def correlation_beside(rows: Array, problem: Problem, change: Change, of: slice = BASE) -> float:
    """For how many poses what the ``change``, in time, and all columns of ``rows`` leave lasts: the longest of both
    kinds of noise and of what lies along the change."""
    later = np.flatnonzero(problem.placement == problem.placement[change.pose])
    later = later[later >= change.pose]
    rows = rows.copy()
    rows[:, -1, later] += np.einsum("rin,i->rn", rows[:, of][..., later], change.displacement)
    normal = _Normal.of(rows, problem)
    step = -(normal.C @ normal.g)[normal.columns]
    left = rows[:, -1] + np.einsum("rin,ni->rn", rows[:, :-1], step[problem.placement])
    along = (np.einsum("rin,i->rn", rows[:, of], change.displacement) * left).sum(axis=0)
    stretches, unknowns = Stretches.of(problem), float(normal.rank + change.dof[0])
    return max(correlation_of(left, stretches, unknowns).longest, correlation_time(along[:, None], stretches))


def _drift(normal: "_Normal", p: int, products: Array, of: slice) -> float:
    """By how much a displacement that grows as a polynomial of the pose lowers the sum of squares."""
    time = np.linspace(-1.0, 1.0, products.shape[-1])
    moments = [products @ time**k for k in range(5)]
    after = np.concatenate([moments[1], moments[2]])
    squares = np.block([[moments[j + k][:, of] for k in (1, 2)] for j in (1, 2)])
    return float(normal.lowered(p, after[None], squares[None])[0][0])


def _after(products: Array, cuts: np.ndarray) -> Array:
    """Sums (K, 6, C) of the poses' products (6, C, n) from each cut on."""
    bins = np.add.reduceat(products, cuts, axis=-1)
    return np.moveaxis(np.cumsum(bins[..., ::-1], axis=-1)[..., ::-1], -1, 0)


@dataclass(frozen=True, eq=False)
class _Normal:
    """The normal equations of the nuisance."""

    C: Array
    """(D, D) pseudo-inverse of the information."""
    g: Array
    """(D,) gradient."""
    cost: float
    """Sum of squares that the best nuisance leaves."""
    rank: int
    columns: np.ndarray
    """(P, C - 1) positions of a placement's local unknowns among all."""

    @staticmethod
    def of(rows: Array, problem: Problem) -> "_Normal":
        """From `rows_of`."""
        P, width = problem.placements, rows.shape[1]
        size = 6 * P + width - 7
        shared = 6 * P + np.arange(width - 7)
        columns = np.stack([np.concatenate([6 * p + np.arange(6), shared]) for p in range(P)])
        H = np.zeros((size + 1, size + 1))
        for p in range(P):
            U = rows if P == 1 else rows[..., problem.placement == p]
            index = np.append(columns[p], size)
            H[np.ix_(index, index)] += np.matmul(U, U.swapaxes(1, 2)).sum(axis=0)
        scale = 1 / np.sqrt(np.maximum(np.diagonal(H)[:-1], 1e-300))
        values, vectors = np.linalg.eigh(H[:-1, :-1] * np.outer(scale, scale))
        kept = values > 1e-12 * values[-1]
        V = scale[:, None] * vectors[:, kept]
        C = (V / values[kept]) @ V.T
        g = H[:-1, -1]
        return _Normal(C, g, float(H[-1, -1] - g @ C @ g), int(kept.sum()), columns)

    def lowered(self, p: int, after: Array, squares: Array) -> tuple[Array, np.ndarray, Array]:
        """By how much K displacements in placement p, of M unknowns each, lower the sum of squares (K,), how many of
        their directions are seen (K,), and the displacements (K, M). ``after`` (K, M, C) are their products with all,
        ``squares`` (K, M, M) with themselves."""
        D, mine = after[..., :-1], self.columns[p]
        CD = self.C[np.ix_(mine, mine)] @ D.swapaxes(1, 2)
        g = after[..., -1] - np.einsum("kil,l->ki", D, (self.C @ self.g)[mine])
        own = np.diagonal(squares, axis1=1, axis2=2)
        scale = np.sqrt(np.where(own > ROUNDING * own.max(axis=1, keepdims=True), own, np.inf))
        values, vectors = np.linalg.eigh((squares - D @ CD) / (scale[:, :, None] * scale[:, None]))
        seen = values > UNSEEN
        z = np.einsum("kij,ki->kj", vectors, g / scale)
        inverse = np.where(seen, 1 / np.where(seen, values, 1.0), 0.0)
        delta = -np.einsum("kij,kj->ki", vectors, inverse * z) / scale
        return (inverse * z**2).sum(axis=1), seen.sum(axis=1), delta


def _flex(angles: Array, line: Linearisation, model: AngleModel, sigma: tuple[float, float]) -> Array:
    """(6, 12 K, N) weighted columns of a position and a rotation that follow the angles, in the frame that alpha turns
    and beta does not."""
    waves = np.stack([f(k * a) for a in angles for k in ORDERS for f in (np.cos, np.sin)])
    turned = np.moveaxis(rot_y(angles[1]), 0, -1)
    columns = (turned[:, :, None] * waves).swapaxes(0, 1).reshape(3, -1, angles.shape[1])
    nothing = np.zeros_like(columns)
    both = np.concatenate([np.concatenate([columns, nothing]), np.concatenate([nothing, columns])], axis=1)
    both = both * row_scale(model, sigma)[:, None]
    return both if line.R_world_carm is None else shaped(both, shape_roots(model, line.R_world_carm))
