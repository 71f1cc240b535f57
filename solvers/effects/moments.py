"""Sums of products of rows that follow one another, and what they become where the noise lasts."""

from dataclasses import dataclass, replace

import numpy as np

from solvers.effects.variance import Mixed
from solvers.se3 import Array

MOST = 0.98
"""Greatest correlation of neighbours."""
SIGNIFICANT = 2.5
"""Standard deviations from which on a correlation is one."""


@dataclass(frozen=True, eq=False)
class Moments:
    """Of rows F = [U Z y] of K kinds, with noise of which neighbours have the correlation ρ (Prais and Winsten 1954).

    The rows (F_t - ρ F_t-1) / √(1 - ρ²), and of a stretch's first block F_1, have independent noise. Their moments are
    (S + ρ² S_edges - ρ (S_lag + S_lagᵀ)) / (1 - ρ²), so that another ρ costs no more than a sum.
    """

    every: Array
    """(K, w, w) Σ F Fᵀ over all blocks,"""
    edges: Array
    """(K, w, w) the same, less those of the first and of the last block of each stretch, and"""
    lag: Array
    """(K, w, w) Σ F_t F_t-1ᵀ."""
    followers: Array
    """(K,) number of rows that follow another."""
    model: Mixed
    """Without correlation."""

    @staticmethod
    def of(kinds: list[Array], stretch: np.ndarray, model: Mixed) -> "Moments":
        """From the rows (rows, w, B) of each kind, of blocks in contiguous stretches (B,)."""
        same = np.diff(stretch) == 0
        edge = 1.0 - np.append(True, ~same) - np.append(~same, True)
        every = np.array([_product(F, F) for F in kinds])
        return Moments(
            every=every,
            edges=np.array([_product(F * edge, F) for F in kinds]),
            lag=np.array([_product(F[..., 1:][..., same], F[..., :-1][..., same]) for F in kinds]),
            followers=same.sum() / len(stretch) * model.rows,
            model=replace(model, moments=every),
        )

    def whitened(self, rho: Array, at: Mixed) -> Mixed:
        """The model with the variances of ``at`` where neighbours of each kind are correlated by ``rho`` (K,)."""
        r = rho[:, None, None]
        moments = (self.every + r**2 * self.edges - r * (self.lag + self.lag.swapaxes(1, 2))) / (1 - r**2)
        constant = -0.5 * float((self.followers * np.log(1 - rho**2)).sum())
        return replace(self.model, moments=moments, constant=constant, variance=at.variance, noise=at.noise)

    def correlation(self, fit: Mixed) -> Array:
        """(K,) of neighbours in what ``fit`` leaves; 0 where it is not significant."""
        v = fit.residual
        rho = np.array(
            [
                v @ lag @ v / max(v @ every @ v, np.finfo(float).tiny)
                for lag, every in zip(self.lag, self.every, strict=True)
            ]
        )
        rho = rho * self.model.rows / np.maximum(self.followers, 1.0)
        told = rho > SIGNIFICANT / np.sqrt(np.maximum(self.followers, 1.0))
        return np.where(told, np.minimum(rho, MOST), 0.0)


def _product(left: Array, right: Array) -> Array:
    """Sum over rows and blocks of the products of the columns of (rows, w, B) each."""
    return np.matmul(left, right.swapaxes(1, 2)).sum(axis=0)
