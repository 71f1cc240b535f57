"""The point of a body that stays where it is while the body turns: ``R_i t + p_i = c``, with noise in R_i and p_i.

Least squares draws t towards zero where the orientations are noisy. The equations here have expectation zero at the
true t: docs/estimation.md, "A fixed point", derives them.
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers.likelihood.correlation import Stretches, scores_time
from solvers.problem import Problem
from solvers.se3 import Array

SAMPLE = 3
"""Poses of one hypothesis; two determine t but for the axis between them."""
HYPOTHESES = 300
"""With 60% of outliers 19 of them are without."""
SCORED = 600
"""Poses on which hypotheses are ranked."""
SHARE = 0.3
"""A hypothesis is ranked by the distance below which this share of the poses lies."""
NEAR = 4.0
"""Poses within so many of these distances support a hypothesis: 5 sigma where 30% are outliers."""
GROWTH = 3.2
"""Poses agree within so many medians of those that agreed before: 4.9 sigma in space."""
FLOOR_M = 5e-6
"""Poses always agree within this."""
RIDGE = 1e-3
"""Turns below this, rad, tell a hypothesis nothing."""
STREAM = 0x9140
"""Keeps the draws apart from those of a simulation with the same seed."""
STEPS = 20
"""Most refinements; two or three are usual."""
LEAST_LEVER = 10.0
"""In standard deviations of the equation: along a shorter lever the two noises are not told apart."""
LEAST_RATIO = 1e-4
"""Of the squared noise along the lever and across it."""
MOST_APART = 16.27
"""Squared distance, in standard deviations, of two answers from one recording: 99.9% of chi-square with 3."""
EXACT_M = 1e-9
"""Residuals below this are rounding."""


@dataclass(frozen=True)
class Noise:
    """Of R_i t + p_i - c."""

    along: float
    """Variance along the lever, m^2: that of the positions."""
    turn: float
    """Variance of the orientations an axis, rad^2."""
    turn_variance: float
    """Of ``turn``, rad^4."""


@dataclass(frozen=True, eq=False)
class Pivot:
    """The point in the sensor's frame and in the world, m."""

    t: Array
    """(3,); a component along an untold direction is a guess that no one may see."""
    c: Array
    """(P, 3)."""
    covariance: Array
    """(K + 3 P, K + 3 P) of the components of t along the told directions, and of c."""
    residual: Array
    """(N, 3) R_i t + p_i - c, in the world."""
    noise: Noise
    lasts: float
    """For how many poses the noise lasts, 1 where it is white; the covariance heeds it."""

    def widened_to(self, other: "Pivot") -> "Pivot":
        """With how far an ``other`` answer, to which the poses have other weights, is off, where noise of the kind
        assumed would not set them so far apart (Hausman): which of them is right is not known."""
        apart = np.concatenate([other.t - self.t, (other.c - self.c).ravel()])
        V = other.covariance[:3, :3]
        if apart[:3] @ np.linalg.pinv(V) @ apart[:3] <= MOST_APART:
            return self
        return replace(self, covariance=self.covariance + np.outer(apart, apart))


def agreeing(problem: Problem, seed: int = 0) -> np.ndarray:
    """(N,) the poses that agree with one fixed point a placement: samples of three, the best refitted."""
    t, c, near = _best_hypothesis(problem, seed)
    used = distances(problem, t, c) <= max(near, FLOOR_M)
    for _ in range(STEPS):
        if used.sum() < SAMPLE:
            break
        t, c = least_squares(problem, used)
        distance = distances(problem, t, c)
        again = distance <= max(GROWTH * float(np.median(distance[used])), FLOOR_M)
        if (again == used).all():
            break
        used = again
    return used


def least_squares(problem: Problem, used: np.ndarray) -> tuple[Array, Array]:
    """t (3,) of least sum of squares over the ``used`` poses (N,), and c (P, 3), medians where none is used."""
    R, p, placement = problem.rotations, problem.p_world_sensor, problem.placement
    S, b = np.zeros((3, 3)), np.zeros(3)
    for k in range(problem.placements):
        here = used & (placement == k)
        if here.any():
            dR, dp = R[here] - R[here].mean(axis=0), p[here] - p[here].mean(axis=0)
            S += np.einsum("nij,nik->jk", dR, dR)
            b += np.einsum("nij,ni->j", dR, dp)
    t = np.asarray(np.linalg.lstsq(S, -b, rcond=1e-12)[0], dtype=float)
    v = p + R @ t
    some = [used & (placement == k) for k in range(problem.placements)]
    c = [v[here].mean(axis=0) if here.any() else np.median(v[placement == k], axis=0) for k, here in enumerate(some)]
    return t, np.array(c)


def fit(problem: Problem, directions: Array, turn: float, turn_variance: float) -> Pivot:
    """The point from poses that all agree, its components along the ``directions`` (K, 3) the unknowns.

    With three directions the noise along and across the lever is estimated, unless it is given, and weighs the
    equation; with fewer the lever is not known, the weights are one, and ``turn`` (rad^2) with its variance is the
    noise of the orientations. Raises LinAlgError where the poses do not determine them.
    """
    t, c = least_squares(problem, np.ones(len(problem), dtype=bool))
    equation = _Equation(problem, directions)
    if len(directions) < 3:
        residual = problem.rotations @ t + problem.p_world_sensor - c[problem.placement]
        noise = Noise(equation.variance(residual), turn, turn_variance)
        return equation.answer(*equation.solved(t, c, noise, weighted=False), noise, weighted=False)
    noise, weighted = equation.noise(t, c)
    for _ in range(STEPS):
        t, c = equation.solved(t, c, noise, weighted)
        before, (noise, weighted) = noise, equation.noise(t, c)
        if (
            abs(noise.along - before.along) <= 1e-6 * before.along
            and abs(noise.turn - before.turn) <= 1e-6 * noise.turn
        ):
            break
    found = equation.answer(t, c, noise, weighted)
    if not weighted:
        return found
    unweighted = equation.answer(*equation.solved(t, c, noise, weighted=False), noise, weighted=False)
    return found.widened_to(unweighted)


def whitened_square(problem: Problem, t: Array, c: Array, along: float, turn: float) -> float:
    """Sum of squares of R_i t + p_i - c over the variance along the lever and across it."""
    g = problem.rotations @ t + problem.p_world_sensor - c[problem.placement]
    u = problem.rotations @ (t / max(float(np.linalg.norm(t)), np.finfo(float).tiny))
    rho2 = float((np.einsum("ni,ni->n", u, g) ** 2).sum())
    return rho2 / along + (float((g**2).sum()) - rho2) / (along + turn * float(t @ t))


class _Equation:
    """The corrected equations of all poses; unknowns are t along the directions, then c of each placement."""

    def __init__(self, problem: Problem, directions: Array):
        self._problem, self._directions = problem, directions
        self._R, self._p, self._k = problem.rotations, problem.p_world_sensor, problem.placement
        self._size = len(directions) + 3 * problem.placements

    def solved(self, t: Array, c: Array, noise: Noise, weighted: bool) -> tuple[Array, Array]:
        """The root for this noise, by Newton's method from t and c."""
        slope = self._slope(t, c, noise, weighted)
        for _ in range(STEPS):
            step = np.asarray(-np.linalg.solve(slope, self._sum(t, c, noise, weighted)), dtype=float)
            t, c = self._moved(t, c, step)
            if np.abs(step).max() < 1e-12 * max(1.0, float(np.abs(t).max())):
                break
        return t, c

    def answer(self, t: Array, c: Array, noise: Noise, weighted: bool) -> Pivot:
        """With the covariance that trusts the scatter of the poses' terms, and the doubt about the turn noise."""
        n, K = len(self._p), len(self._directions)
        of_t, of_c = self._terms(t, c, noise, weighted)
        terms = np.zeros((n, self._size))
        terms[:, :K] = of_t @ self._directions.T
        for axis in range(3):
            terms[np.arange(n), K + 3 * self._k + axis] = of_c[:, axis]
        slope = self._slope(t, c, noise, weighted)
        free = max(n - self._size / 3, 1.0)
        doubt = Noise(noise.along, noise.turn + 1e-6, 0.0)
        m, kappa = _weights(t, noise, weighted)
        by_turn = self._sum(t, c, doubt, weighted, (m, kappa)) - self._sum(t, c, noise, weighted, (m, kappa))
        inverse = np.linalg.inv(slope)
        drawn = inverse @ (by_turn / 1e-6)
        lasts = scores_time(terms, Stretches.of(self._problem)) if terms.any() else 1.0
        covariance = inverse @ (terms.T @ terms) @ inverse.T * (n / free) * lasts
        covariance += noise.turn_variance * np.outer(drawn, drawn)
        return Pivot(t, c, (covariance + covariance.T) / 2, self._residual(t, c), noise, lasts)

    def noise(self, t: Array, c: Array) -> tuple[Noise, bool]:
        """The noise that the residuals show, the given one where there is one; and whether it may weigh."""
        problem, n = self._problem, len(self._p)
        g, lever2 = self._residual(t, c), float(t @ t)
        share = max(1 - self._size / (3 * n), 1 / n)
        u = self._R @ (t / max(np.sqrt(lever2), np.finfo(float).tiny))
        radial = np.einsum("ni,ni->n", u, g)
        along, total = float(radial.var()) / share, float((g**2).sum()) / n / share
        across = (total - along) / 2
        short = lever2 * LEAST_LEVER**-2 <= total / 3 or total < EXACT_M**2
        if problem.sigma_t is not None:
            along = problem.sigma_t**2
        if problem.sigma_r is not None:
            turn, doubt = problem.sigma_r**2, 0.0
        elif short:
            turn, doubt = 0.0, 0.0
        else:
            turn = max(across - along, 0.0) / lever2
            doubt = (across**2 + 2 * along**2) / n / lever2**2
        if short:
            return Noise(total / 3, turn, doubt), False
        return Noise(max(along, LEAST_RATIO * (along + turn * lever2)), turn, doubt), True

    def variance(self, residual: Array) -> float:
        """An axis."""
        return float((residual**2).sum()) / max(residual.size - self._size, 1)

    def _residual(self, t: Array, c: Array) -> Array:
        return self._R @ t + self._p - c[self._k]

    def _terms(
        self, t: Array, c: Array, noise: Noise, weighted: bool, weights: tuple[float, float] | None = None
    ) -> tuple[Array, Array]:
        """(N, 3) of t in the sensor's frame and (N, 3) of c in the world, each of expectation zero.

        With h_i = R_i^T g_i and M = m I + kappa u u^T these are M h_i - sigma_r^2 M t and
        -R_i (M h_i - sigma_r^2 (kappa - m) t).
        """
        m, kappa = weights or _weights(t, noise, weighted)
        h = np.einsum("nji,nj->ni", self._R, self._residual(t, c))
        u = t / max(float(np.linalg.norm(t)), np.finfo(float).tiny)
        Mh = m * h + kappa * np.outer(h @ u, u)
        of_t = Mh - noise.turn * (m + kappa) * t
        of_c = -np.einsum("nij,nj->ni", self._R, Mh - noise.turn * (kappa - m) * t)
        return of_t, of_c

    def _sum(
        self, t: Array, c: Array, noise: Noise, weighted: bool, weights: tuple[float, float] | None = None
    ) -> Array:
        of_t, of_c = self._terms(t, c, noise, weighted, weights)
        own = [of_c[self._k == k].sum(axis=0) for k in range(len(c))]
        return np.concatenate([self._directions @ of_t.sum(axis=0), *own])

    def _slope(self, t: Array, c: Array, noise: Noise, weighted: bool) -> Array:
        """Derivative (k, k) of `_sum` by the unknowns, the weights following t, by central differences."""
        h = 1e-4 * max(float(np.linalg.norm(t)), 1e-3)
        columns = []
        for e in h * np.eye(self._size):
            plus, minus = (self._sum(*self._moved(t, c, s * e), noise, weighted) for s in (1, -1))
            columns.append((plus - minus) / (2 * h))
        return np.stack(columns, axis=1)

    def _moved(self, t: Array, c: Array, step: Array) -> tuple[Array, Array]:
        K = len(self._directions)
        return t + step[:K] @ self._directions, c + step[K:].reshape(-1, 3)


def _weights(t: Array, noise: Noise, weighted: bool) -> tuple[float, float]:
    """m and kappa of M, times the variance across the lever."""
    if not weighted:
        return 1.0, 0.0
    return 1.0, noise.turn * float(t @ t) / noise.along


def distances(problem: Problem, t: Array, c: Array) -> Array:
    """(N,) of the pivot from its placement's c, m."""
    return np.linalg.norm(problem.rotations @ t + problem.p_world_sensor - c[problem.placement], axis=1)


def _best_hypothesis(problem: Problem, seed: int) -> tuple[Array, Array, float]:
    """t (3,), c (P, 3) and the distance, m, within which poses support it."""
    rng = np.random.default_rng([seed, STREAM])
    R, p, placement = problem.rotations, problem.p_world_sensor, problem.placement
    of_placement = [np.flatnonzero(placement == k) for k in range(problem.placements)]
    chosen = placement[rng.integers(len(p), size=HYPOTHESES)]
    sample = np.stack([rng.choice(of_placement[k], SAMPLE) for k in chosen])
    A = (R[sample[:, :1]] - R[sample[:, 1:]]).reshape(HYPOTHESES, -1, 3)
    y = (p[sample[:, 1:]] - p[sample[:, :1]]).reshape(HYPOTHESES, -1, 1)
    At = np.swapaxes(A, 1, 2)
    ts = np.linalg.solve(At @ A + RIDGE**2 * np.eye(3), At @ y)[..., 0]
    some = np.sort(rng.choice(len(p), min(SCORED, len(p)), replace=False))
    v = p[some] + np.einsum("nij,bj->bni", R[some], ts)
    own = (p[sample] + np.einsum("bmij,bj->bmi", R[sample], ts)).mean(axis=1)
    c = np.zeros((HYPOTHESES, problem.placements, 3))
    for k in range(problem.placements):
        here = placement[some] == k
        c[:, k] = np.median(v[:, here], axis=1) if here.any() else 0.0
        c[chosen == k, k] = own[chosen == k]
    distance = np.linalg.norm(v - c[:, placement[some]], axis=2)
    near = NEAR * float(np.quantile(distance, SHARE, axis=1).min())
    best = int(np.argmax((distance <= near).sum(axis=1)))
    return ts[best], c[best], near
