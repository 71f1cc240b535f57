"""Effects in a linear model: which of them the data ask for, and how much of each.

The rows are F = [U Z y], the columns of Z in groups of one variance. From none, those effects are taken up whose slope
of the restricted likelihood asks for them; noise that lasts is told from them by turns; at last those are left out that
gain no more than chance: docs/estimation.md, "Systematic effects".
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from solvers.effects.rows import Rows
from solvers.effects.variance import Mixed, most_likely
from solvers.likelihood.covariance import marginal_covariance
from solvers.se3 import Array

ASKED = 1.0
"""Standard deviations by which an effect must show in the residuals to be estimated."""
WORTH = 1.35
"""Gain in log-likelihood of an effect that is kept: chance makes it for one variance in twenty."""
SAME_RHO = 0.03
"""Change of a correlation that calls for no other round."""
ROUNDS = 3
"""In which noise that lasts is told from effects."""

Found = TypeVar("Found", bound="Components")


@dataclass(frozen=True)
class Group:
    """One variance of one effect."""

    effect: str
    kind: str
    """``position`` (m), ``rotation`` (rad) or ``time`` (s²)."""


@dataclass(frozen=True, eq=False)
class Components:
    """The effects at their most likely variances."""

    groups: tuple[Group, ...]
    rows: Rows
    model: Mixed
    rho: Array
    """(k,) correlation of the noise of neighbouring blocks, by kind."""

    @staticmethod
    def of(groups: tuple[Group, ...], rows: Rows) -> "Components":
        """The most likely variances, from no effect and noise that lasts as long as it seems to, or not at all."""
        nothing = most_likely(rows.model)
        lasting = rows.correlation(nothing)
        found = []
        for rho in [np.zeros_like(lasting), lasting] if lasting.any() else [lasting]:
            start = rows.whitened(rho, nothing)
            score, information = start.from_nothing()
            asked = score > ASKED * np.sqrt(information)
            start = start.at(np.where(asked, score / information, 0.0), start.noise)
            found.append(Components(groups, rows, start, rho).climbed())
        return max(found, key=lambda one: one.model.log_likelihood)

    def climbed(self: Found) -> Found:
        """The most likely variances and correlation of the noise, from these."""
        fit, rho = most_likely(self.model), self.rho
        for _ in range(ROUNDS):
            left = self.rows.correlation(fit)
            if np.abs(left - rho).max() < SAME_RHO:
                break
            fit, rho = most_likely(self.rows.whitened(left, fit)), left
        return replace(self, model=fit, rho=rho)

    def pruned(self: Found) -> Found:
        """Only the effects that gain what chance seldom makes, the one that gains least left out first."""
        found = self
        while found.names:
            least = min(found.names, key=found.gain_of)
            if found.gain_of(least) >= WORTH:
                break
            found = replace(found, model=most_likely(found._without(least)))
        return found

    @property
    def gain(self) -> float:
        """In log-likelihood, over no effect at the same noise."""
        return self.model.log_likelihood - self.model.at(0 * self.model.variance, self.model.noise).log_likelihood

    def gain_of(self, name: str) -> float:
        """In log-likelihood, over all effects but this one."""
        return self.model.log_likelihood - self._without(name).log_likelihood

    def _without(self, name: str) -> Mixed:
        kept = np.array([group.effect != name for group in self.groups], dtype=bool)
        return self.model.at(self.model.variance * kept, self.model.noise)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects that there are."""
        found = zip(self.groups, self.model.variance, strict=True)
        return tuple(dict.fromkeys(group.effect for group, variance in found if variance > 0))

    def columns_of(self, name: str) -> np.ndarray:
        """(m,) mask of the columns of an effect."""
        return np.array([group.effect == name for group in self.groups])[self.model.group]

    @cached_property
    def plain(self) -> Array:
        """(u, u) covariance of the unknowns under noise alone, white and of unit variance."""
        u = self.model.unknowns
        information = self.rows.model.moments.sum(axis=0)[:u, :u] + self.model.fixed[:u, :u]
        return marginal_covariance(information, np.ones(u, dtype=bool))

    @property
    def drawn(self) -> Array:
        """(u, m) C Uᵀ Z: by how much an estimate without effects is off by unit coefficients."""
        u = self.model.unknowns
        return self.plain @ self.rows.model.moments.sum(axis=0)[:u, u:-1]

    def capped(self: Found, most: Array) -> Found:
        """The same with no variance above ``most`` (G,)."""
        return replace(self, model=self.model.at(np.minimum(self.model.variance, most), self.model.noise))

    def rms(self, name: str, columns: Array) -> tuple[float, ...]:
        """Root mean square of what an effect is predicted to displace, of three rows at a time of its ``columns``
        (3 k, m, B), displacements by unit coefficients."""
        moved = np.einsum("imb,m->ib", columns, self.model.coefficients[self.columns_of(name)])
        squares = (moved.reshape(-1, 3, moved.shape[1]) ** 2).sum(axis=1).mean(axis=1)
        return tuple(np.sqrt(squares).tolist())

    def shares(self, gain: Array) -> dict[str, Array]:
        """G Z_g λ_g Z_gᵀ Gᵀ (K, K) of every effect, from ``gain`` = G Z (K, m)."""
        return {
            name: (gain[:, own] * self.model.variance[self.model.group[own]]) @ gain[:, own].T
            for name in self.names
            for own in [self.columns_of(name)]
        }
