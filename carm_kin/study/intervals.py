"""Statistics of many runs with their 95% confidence intervals. NaN counts as no value."""

from collections.abc import Callable

import numpy as np

from solvers.se3 import Array

LEVEL = 0.95
RESAMPLES = 2000

Interval = tuple[float, float]
Statistic = Callable[[Array], Array]
"""Of the runs along the last axis."""


def rms(values: Array) -> Array:
    """Root mean square along the last axis."""
    return np.sqrt((values**2).mean(axis=-1))


def mean(values: Array) -> Array:
    """Mean along the last axis."""
    return values.mean(axis=-1)


def median(values: Array) -> Array:
    """Median along the last axis."""
    return np.median(values, axis=-1)


def ratio_of_rms(values: Array) -> Array:
    """The RMS of the first row over that of the second; ``values`` is (2, ..., N)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return rms(values[0]) / rms(values[1])


def estimated(values: Array, statistic: Statistic) -> tuple[float | None, Interval | None]:
    """A statistic of N runs and its interval by the bootstrap: the runs drawn anew, with replacement.

    ``values`` is (N,) or (K, N), of which runs are drawn as columns. None where a run is left out of every row, and
    no interval for a single run.
    """
    there = np.atleast_2d(values)[:, np.isfinite(np.atleast_2d(values)).all(axis=0)]
    runs = there.shape[1]
    if runs == 0:
        return None, None
    shaped = there if values.ndim > 1 else there[0]
    value = float(statistic(shaped))
    if runs == 1 or not np.isfinite(value):
        return (value if np.isfinite(value) else None), None
    drawn = np.random.default_rng(0).integers(runs, size=(RESAMPLES, runs))
    low, high = np.quantile(statistic(shaped[..., drawn]), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return value, (float(low), float(high))


def share(hits: Array) -> tuple[float | None, Interval | None]:
    """The share of ones among N zeros and ones, and its exact interval by Clopper and Pearson."""
    there = hits[np.isfinite(hits)]
    if not there.size:
        return None, None
    from scipy.stats import binomtest

    found = binomtest(int(there.sum()), there.size)
    exact = found.proportion_ci(LEVEL, method="exact")
    return float(found.statistic), (float(exact.low), float(exact.high))
