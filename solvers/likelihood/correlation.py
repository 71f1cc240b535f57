"""How many poses the noise of one pose lasts, and what that does to a covariance: docs/estimation.md, "Noise that is
correlated in time".

The correlation time T of a stationary noise is the variance of a mean over the variance that it would have were all
poses independent: T = 1 + 2 sum rho_k, with rho_k the correlation of poses that are k apart.
"""

from dataclasses import dataclass

import numpy as np

from solvers.estimate import Correlation
from solvers.problem import Problem
from solvers.se3 import Array

GAP = 3.5
"""Steps of time beyond which two poses are no neighbours."""
FIRST_OCTAVES = 16
"""Lag up to which a correlation must have shown, else T is 1."""
SIGNIFICANT = 3.5
"""Standard deviations by which the sum up to a lag must exceed that of white noise for it;"""
CONTINUES = 2.0
"""and by which an octave of lags must add to it for another one to be looked at."""
MOST_ABSORBED = 0.5
"""Share of the slow noise that the unknowns are believed to take away, at most."""
MOST_POSES, PIECE = 10_000, 1000
"""Poses from which T is found, and the length of the pieces that are picked where there are more."""
FEWEST = 4
"""Pairs of values a lag below which the sum ends."""
EXACT = 1e-12
"""Mean square below which there is no noise."""


@dataclass(frozen=True, eq=False)
class Stretches:
    """Poses that follow one another in time, under the same conditions."""

    order: np.ndarray
    """(n,) the poses as they follow one another."""
    number: np.ndarray
    """(n,) the stretch of each pose of `order`; it never falls."""

    @staticmethod
    def of(problem: Problem, used: np.ndarray | None = None) -> "Stretches":
        """Of the ``used`` (N,) poses: each within one placement and one sweep."""
        return Stretches.within([problem.placement, *problem.held.T], problem.time_s, used)

    @staticmethod
    def within(labels: list[np.ndarray], time_s: Array | None, used: np.ndarray | None = None) -> "Stretches":
        """Of the ``used`` (N,) poses that have all ``labels``, each (N,), in common and no gap in ``time_s`` (N,)
        between them; the number of the pose stands for a time that is not known."""
        n = len(labels[0])
        clock = np.arange(n, dtype=float) if time_s is None else time_s
        order = np.lexsort((clock, *labels))
        if used is not None:
            order = order[used[order]]
        same = np.ones(max(len(order) - 1, 0), dtype=bool)
        for label in labels:
            same &= np.diff(label[order]) == 0
        step = np.diff(clock[order])
        steps = step[same & (step > 0)]
        same &= step <= GAP * (np.median(steps) if steps.size else 0.0)
        return Stretches(order, np.concatenate([[0], np.cumsum(~same)])[: len(order)])


def correlation_of(residual: Array, stretches: Stretches, unknowns: float = 0.0) -> Correlation:
    """Of both kinds of noise, from the weighted residuals (6, N) or (3, N) with each pose's own angles at their best,
    of which a fit of so many ``unknowns`` left them."""
    kinds = np.split(residual.T, residual.shape[0] // 3, axis=1)
    return Correlation(*(correlation_time(part, stretches, unknowns) for part in kinds))


def correlation_time(values: Array, stretches: Stretches, unknowns: float = 0.0) -> float:
    """T of noise (N, d) of mean zero in poses, 1 where nothing tells it from white noise.

    The sum of the correlations ends at the first octave of lags that adds nothing significant. Each of the
    ``unknowns`` of the fit that left ``values`` takes as much of the slow noise as a share T of a value of white
    noise; that is added again.
    """
    values, number = _picked(values, stretches)
    S = values.T @ values
    variance = float(np.trace(S))
    if variance <= EXACT * values.size:
        return 1.0
    dimension = variance**2 / float((S**2).sum())
    total = _summed(values, number, variance / len(values), dimension)
    found = max(1.0, 1 + 2 * total)
    absorbed = unknowns * found / max(dimension * len(stretches.order), 1.0)
    return found / (1 - min(absorbed, MOST_ABSORBED)) if total > 0 else 1.0


def scores_time(scores: Array, stretches: Stretches) -> float:
    """T of the gradients (N, k) of the poses at the optimum, in coordinates in which all their directions count alike.

    The covariance of an estimator with these scores is the one for independent poses, times T.
    """
    values, vectors = np.linalg.eigh(scores.T @ scores)
    kept = values > 1e-12 * values[-1]
    white = scores @ (vectors[:, kept] / np.sqrt(values[kept])) * np.sqrt(len(scores))
    return correlation_time(white, stretches, unknowns=float(kept.sum()))


def with_correlation(C: Array, information: tuple[Array, ...], times: tuple[float, ...]) -> Array:
    """The covariance C (D, D) = inv(H) of white noise with noise of these correlation ``times`` instead: C (sum
    T_k H_k) C, where the ``information`` H_k (D, D) of the kinds, with that of kinds that are white, adds up to H."""
    found = C
    for H, T in zip(information, times, strict=True):
        if T > 1:
            found = found + (T - 1) * (C @ H @ C)
    return found


def _picked(values: Array, stretches: Stretches) -> tuple[Array, np.ndarray]:
    """The values in their order, and their stretches; of very many, evenly picked pieces."""
    order, number = stretches.order, stretches.number
    if len(order) > MOST_POSES:
        piece = np.arange(len(order)) // PIECE
        kept = piece % -(-len(order) // MOST_POSES) == 0
        order, number = order[kept], (number + piece)[kept]
    return values[order], number


def _summed(values: Array, number: np.ndarray, variance: float, dimension: float) -> float:
    """The sum of the correlations, 0 where it is not significant; ``variance`` is the mean square of a pose."""
    total = before = 0.0
    significant, lag, octave, pairs = False, 0, 1, 0
    while significant or lag < FIRST_OCTAVES:
        for lag in range(octave // 2 + 1, octave + 1):
            same = number[lag:] == number[:-lag]
            pairs = int(same.sum())
            if pairs * dimension < FEWEST * lag:
                return total if significant else 0.0
            total += float(np.einsum("nk,nk->n", values[lag:], values[:-lag])[same].mean()) / variance
        error = np.sqrt(1 / (pairs * dimension))
        significant |= total > SIGNIFICANT * np.sqrt(lag) * error
        scatter = np.sqrt((lag - lag // 2) * max(1 + 2 * total, 1.0)) * error
        if significant and total - before <= CONTINUES * scatter:
            return before or total
        before, octave = total, 2 * lag
    return 0.0
