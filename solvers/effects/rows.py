"""Rows of blocks that follow one another, and their moments, also where the noise lasts."""

from dataclasses import dataclass, replace

import numpy as np

from solvers.effects.variance import Mixed
from solvers.se3 import Array

MOST = 0.98
"""Greatest correlation of neighbours."""
SIGNIFICANT = 2.5
"""Standard deviations from which on a correlation is one."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows F = [U Z y] of k kinds, with noise of which neighbours have the correlation ρ (Prais and Winsten 1954).

    The rows (F_t - ρ F_t-1) / √(1 - ρ²), and of a stretch's first block F_1, have independent noise.
    """

    F: Array
    """(w, 3 k, B), three rows of each kind in each of B blocks."""
    follows: np.ndarray
    """(B,) whether a block has the one before as its neighbour."""
    model: Mixed
    """Without correlation."""

    @staticmethod
    def of(F: Array, stretch: np.ndarray, model: Mixed) -> "Rows":
        """From the rows (3 k, w, B) of blocks in contiguous stretches (B,), and a model that lacks their moments."""
        F = np.ascontiguousarray(F.swapaxes(0, 1))
        follows = np.append(False, np.diff(stretch) == 0)
        return Rows(F, follows, replace(model, moments=_moments(F)))

    def independent(self, rho: Array) -> Array:
        """(w, 3 k, B) the rows of independent noise where neighbours of each kind are correlated by ``rho`` (k,)."""
        if not rho.any():
            return self.F
        r = np.where(self.follows, np.repeat(rho, 3)[:, None], 0.0)
        return (self.F - r * np.roll(self.F, 1, axis=-1)) / np.sqrt(1 - r**2)

    def whitened(self, rho: Array, at: Mixed) -> Mixed:
        """The model with the variances of ``at`` where neighbours of each kind are correlated by ``rho`` (k,)."""
        if not rho.any():
            return self.model.at(at.variance, at.noise)
        constant = -0.5 * float((self.followers * np.log(1 - rho**2)).sum())
        moments = _moments(self.independent(rho))
        return replace(self.model, moments=moments, constant=constant, variance=at.variance, noise=at.noise)

    def correlation(self, fit: Mixed) -> Array:
        """(k,) of neighbours in what ``fit`` leaves of each kind; 0 where it is not significant."""
        left = np.einsum("wrb,w->rb", self.F, fit.residual).reshape(len(fit.noise), 3, -1)
        squares = np.maximum((left**2).sum(axis=(1, 2)), np.finfo(float).tiny)
        rho = (left[..., 1:] * left[..., :-1])[..., self.follows[1:]].sum(axis=(1, 2)) / squares
        rho = rho * self.model.rows / np.maximum(self.followers, 1.0)
        told = rho > SIGNIFICANT / np.sqrt(np.maximum(self.followers, 1.0))
        return np.where(told, np.minimum(rho, MOST), 0.0)

    @property
    def followers(self) -> Array:
        """(k,) number of rows that follow another."""
        return self.follows.mean() * self.model.rows


def _moments(F: Array) -> Array:
    """(k, w, w) sums over rows and blocks of the products of the columns (w, 3 k, B)."""
    kinds = np.split(F, F.shape[1] // 3, axis=1)
    return np.array([rows @ rows.T for rows in (np.ascontiguousarray(kind).reshape(len(F), -1) for kind in kinds)])
