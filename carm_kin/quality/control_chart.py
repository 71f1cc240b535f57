"""A control chart of individual values: reference, limits, and the rules that judge what follows the baseline.

docs/quality.md has the equations.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import erf, sqrt

import numpy as np

from solvers.se3 import Array

BASELINE, PASS, NOTE, ALERT, FAIL = "baseline", "pass", "note", "alert", "fail"
WORSE = (BASELINE, PASS, NOTE, ALERT, FAIL)
"""Each is worse than the one before."""
NOTE_WITHIN, ALERT_WITHIN = erf(2 / sqrt(2)), erf(3 / sqrt(2))
"""Probability of a normal value within 2 and within 3 standard deviations."""
MOST_DOF = 1e6
"""Above, a variance counts as known."""


@dataclass(frozen=True, eq=False)
class Values:
    """What was measured: the N results in the order of time, the first n of them the baseline."""

    values: Array
    """(N, K) in one unit."""
    covariances: Array
    """(N, K, K) as each result states it."""
    n: int

    @property
    def reference(self) -> Array:
        """(K,) the mean of the baseline."""
        return self.values[: self.n].mean(axis=0)

    def component(self, k: int) -> "Values":
        """Component k alone."""
        return Values(self.values[:, [k]], self.covariances[:, k, k][:, None, None], self.n)


@dataclass(frozen=True, eq=False)
class Scatter:
    """By how much results differ beyond what they state."""

    variances: Array
    """(K,)."""
    dof: float
    """Degrees of freedom of the estimate of each."""

    def component(self, k: int) -> "Scatter":
        """Component k alone."""
        return Scatter(self.variances[[k]], self.dof)


@dataclass(frozen=True, eq=False)
class Limits:
    """(N,) each: how far a result may be from the reference."""

    note: Array
    alert: Array
    fail: Array


def scatter_of(given: Values) -> Scatter:
    """From the successive differences of the baseline; none where it is one result.

    ``max(0, mean(d^2) / 2 - mean stated variance)`` over the differences d of neighbours; the first term has
    ``2 (n-1)^2 / (3n-4)`` degrees of freedom (von Neumann 1941).
    """
    n, K = given.n, given.values.shape[1]
    if n == 1:
        return Scatter(np.zeros(K), 1.0)
    stated = np.diagonal(given.covariances[:n], axis1=1, axis2=2)
    squares = (np.diff(given.values[:n], axis=0) ** 2 - stated[1:] - stated[:-1]).mean(axis=0) / 2
    return Scatter(np.maximum(squares, 0.0), 2 * (n - 1) ** 2 / (3 * n - 4))


def limits_of(given: Values, scatter: Scatter, tolerance: float | None, least_fail: float) -> Limits:
    """Of the distance of each result from the reference.

    The difference has the covariance S, of the result and of the reference, each stated and scattered. The limit is
    ``sqrt(tr S F)`` with F the quantile of the F distribution of ``(tr S)^2 / tr S^2`` and of the effective degrees of
    freedom (Welch and Satterthwaite). Fail is the tolerance, or without one the alert, but ``least_fail`` at least.
    """
    n = given.n
    each = given.covariances + np.diag(scatter.variances)
    own = np.where(np.arange(len(each)) < n, 1 - 2 / n, 1.0)
    S = own[:, None, None] * each + each[:n].sum(axis=0) / n**2
    scattered = np.maximum(own + 1 / n, 0.0) * np.sqrt((scatter.variances**2).sum() / scatter.dof)
    note, alert = (_limit(S, scattered, p) for p in (NOTE_WITHIN, ALERT_WITHIN))
    fail = np.maximum(alert, least_fail) if tolerance is None else np.full(len(alert), tolerance)
    return Limits(note, alert, fail)


def _limit(S: Array, uncertain: Array, p: float) -> Array:
    """(N,) the limits of probability p for covariances (N, K, K); ``uncertain`` (N,) is the standard deviation, over
    the root of 2, with which their traces are known."""
    from scipy.special import fdtri

    trace = np.maximum(np.trace(S, axis1=1, axis2=2), 0.0)
    known = trace > 0
    total = np.where(known, trace, 1.0)
    shape = np.where(known, total**2 / np.where(known, (S**2).sum(axis=(1, 2)), 1.0), 1.0)
    dof = 1 / np.maximum((uncertain / total) ** 2, 1 / MOST_DOF)
    return np.sqrt(trace * fdtri(shape, dof, p))


def judged(change: Array, limits: Limits, n: int) -> tuple[str, ...]:
    """The status of each result by its change (N,) with its sign.

    ``note`` beyond the note limit; ``alert`` beyond the alert limit, or beyond the note limit with one of the two
    results before it, on the same side (Western Electric rules 1 and 2); ``fail`` beyond the fail limit.
    """
    size, side = np.abs(change), np.sign(change) * (np.abs(change) > limits.note)
    found = [BASELINE] * n
    for i in range(n, len(change)):
        before = side[max(n, i - 2) : i]
        again = side[i] != 0 and bool((before == side[i]).any())
        rules = ((FAIL, size[i] > limits.fail[i]), (ALERT, size[i] > limits.alert[i] or again), (NOTE, side[i] != 0))
        found.append(next((status for status, holds in rules if holds), PASS))
    return tuple(found)


def worst(statuses: Sequence[str]) -> str:
    """The worst of them."""
    return max(statuses, key=WORSE.index)


def scatters_more_than_stated(given: Values) -> bool:
    """Whether the baseline of one component differs by more than its stated deviations explain: Cochran's Q beyond
    its quantile of three standard deviations."""
    from scipy.special import chdtrc

    x, weight = given.values[: given.n, 0], 1 / given.covariances[: given.n, 0, 0]
    Q = (weight * (x - (weight @ x) / weight.sum()) ** 2).sum()
    return given.n > 1 and bool(chdtrc(given.n - 1, Q) < 1 - ALERT_WITHIN)
