"""The noises of positions, orientations and readings from their own residuals: docs/estimation.md, section 16."""

import numpy as np
from scipy.special import chdtri

from solvers.chain.equations import Reduced
from solvers.chain.problem import KINDS, ChainProblem
from solvers.kinematic import LEAST_CHANGE, SIGMA_FLOOR
from solvers.se3 import Array

FIRST_READING = (2e-3, 1e-4)
"""Noise of the readings to begin with, rad and m."""
UNTOLD = 1e-6
"""Entry of Helmert's matrix below which a noise is too small beside the others to be told: about a hundredth."""
MEDIAN_CHI2_3 = float(chdtri(3, 0.5))


def first_sigma(problem: ChainProblem, residual: Array) -> Array:
    """(KINDS,): of the poses from the median squares, which outliers leave alone, of their ``residual`` (M, 6) at the
    start."""
    found = np.sqrt(np.median((residual**2).reshape(-1, 2, 3).sum(axis=2), axis=0) / MEDIAN_CHI2_3)
    return _given_or(problem, np.concatenate([found, FIRST_READING]))


def next_sigma(problem: ChainProblem, at: Reduced, step: Array, C: Array) -> Array:
    """All noises (KINDS,) by Helmert's equations after a step (D,), those of which the data tell nothing left as they
    are. C (D, D) is the covariance of the unknowns. No variance falls below `LEAST_CHANGE` of the one before in one
    step."""
    squares, A = at.squares_after(step), helmert(at, C)
    given = np.array([s is not None for s in problem.sigma]) | (np.diagonal(A) < UNTOLD)
    ratio = np.where(given, 1.0, LEAST_CHANGE)
    fixed = given
    while not fixed.all():
        found = np.linalg.solve(A[np.ix_(~fixed, ~fixed)], squares[~fixed] - A[np.ix_(~fixed, fixed)] @ ratio[fixed])
        if (found >= LEAST_CHANGE).all():
            ratio[~fixed] = found
            break
        fixed = fixed.copy()
        fixed[np.flatnonzero(~fixed)[found < LEAST_CHANGE]] = True
    return _given_or(problem, np.sqrt(ratio) * at.sigma)


def helmert(at: Reduced, C: Array) -> Array:
    """(KINDS, KINDS): the expected sum of squares of each kind by the variance of each, both in units of the assumed
    noise; with M the projector off all columns and P_a the rows of a kind, tr(M P_a M P_b)."""
    found = np.zeros((KINDS, KINDS))
    for (a, b), E in at.exchanged.items():
        shared = ((C @ at.H_by_kind[a]) * (C @ at.H_by_kind[b]).T).sum()
        found[a, b] = found[b, a] = at.counts[a, b] + (C * (E + E.T)).sum() + shared
    return found + np.diag(redundancy(at, C) - found.sum(axis=1))


def redundancy(at: Reduced, C: Array) -> Array:
    """(KINDS,) rows of each kind less what the fitted unknowns take of them."""
    return at.counts.sum(axis=1) - _drawn(at, C)


def _drawn(at: Reduced, C: Array) -> Array:
    """(KINDS,) degrees of freedom that the global unknowns take of each kind."""
    return np.einsum("ij,kij->k", C, at.H_by_kind)


def _given_or(problem: ChainProblem, estimated: Array) -> Array:
    """(KINDS,); exact readings have no rows, so their sigma is never used."""
    given = np.array([np.nan if s is None else s for s in problem.sigma])
    return np.maximum(np.where(np.isfinite(given), given, estimated), SIGMA_FLOOR)
