"""Variance components of a linear model by restricted maximum likelihood.

    y = U x + Z c + e,    c_g ~ N(0, λ_g I),    e_k ~ N(0, d_k I)

with groups g of columns of Z and kinds k of rows, and x without a prior. Everything is computed from the moments
``F_kᵀ F_k`` of F = [U Z y]. With V = D + Z Λ Zᵀ and P = V⁻¹ - V⁻¹ U (Uᵀ V⁻¹ U)⁻¹ Uᵀ V⁻¹ the restricted
log-likelihood is -½ (log|V| + log|Uᵀ V⁻¹ U| + yᵀ P y) (Patterson and Thompson 1971). It is climbed by Newton's steps
in log λ and log d with the average information (Gilmour, Thompson and Cullis 1995).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from solvers.se3 import Array

RIDGE = 1e-11
"""Relative to the information of an unknown, added to it."""
PAD = 1e-12
"""Relative to y'y, added to it."""
LONGEST_STEP = 2.0
"""Greatest change of the logarithm of a variance in a step."""
DAMPING = 0.05
"""Of Newton's steps, relative to the information of a logarithm."""
SETTLED = 0.02
"""Gain in log-likelihood below which a step is the last."""
MOST_STEPS = 25
ROUNDING = 1e-6
"""Of a log-likelihood, relative."""
SMALL = 48
"""Size up to which a triangular matrix is inverted as a whole."""
NOTHING = 0.02
"""A group whose data tell less than so many of its coefficients, and whose variance falls, is none."""
LEAST_FREEDOM = 5.0
"""Degrees of freedom of a kind of noise, at least."""


@dataclass(frozen=True, eq=False)
class Mixed:
    """The model at one set of variances."""

    moments: Array
    """(K, w, w) FᵀF of each kind of rows, w = u + m + 1: U, Z, y."""
    fixed: Array
    """(w, w) the same of rows of variance 1: readings and labels."""
    rows: Array
    """(K,) number of rows, less what was eliminated before."""
    unknowns: int
    """u."""
    group: np.ndarray
    """(m,) the group of each column of Z."""
    variance: Array
    """(G,) λ; 0 where a group has no effect."""
    noise: Array
    """(K,) d."""
    constant: float = 0.0
    """Added to the log-likelihood: that of what made the rows independent."""

    @cached_property
    def _live(self) -> np.ndarray:
        """Columns of Z whose variance is not 0, as a mask (m,)."""
        return self.variance[self.group] > 0

    @cached_property
    def index(self) -> np.ndarray:
        """Positions of U and of the live columns of Z."""
        return np.concatenate([np.arange(self.unknowns), self.unknowns + np.flatnonzero(self._live)])

    @cached_property
    def scale(self) -> Array:
        """Of the unknowns to unit information, of the coefficients to unit variance."""
        information = self._normal_unscaled.diagonal()[: self.unknowns]
        roots = np.sqrt(self.variance[self.group[self._live]])
        return np.concatenate([1 / np.sqrt(np.maximum(information, np.finfo(float).tiny)), roots])

    @cached_property
    def _normal_unscaled(self) -> Array:
        return np.tensordot(1 / self.noise, self.moments, 1) + self.fixed

    @cached_property
    def equations(self) -> Array:
        """Henderson's mixed-model equations of unknowns and live coefficients, scaled."""
        i, u = self.index, self.unknowns
        K = self._normal_unscaled[np.ix_(i, i)] * np.outer(self.scale, self.scale)
        K[np.arange(u), np.arange(u)] += RIDGE
        K[np.arange(u, len(i)), np.arange(u, len(i))] += 1.0
        return K

    @cached_property
    def _with_y(self) -> Array:
        """Cholesky factor of the equations with their right side and y'y bordering them: below L stand L⁻¹ b and, last,
        the root of what is left of y'y."""
        i = np.append(self.index, -1)
        scale = np.append(self.scale, 1.0)
        K = np.zeros((len(i), len(i)))
        K[:-1, :-1] = self.equations
        K[-1] = K[:, -1] = self._normal_unscaled[i, -1] * scale
        K[-1, -1] += PAD * K[-1, -1] + np.finfo(float).tiny
        return np.asarray(np.linalg.cholesky(K), dtype=float)

    @cached_property
    def _root(self) -> Array:
        """L⁻¹ of the scaled equations L Lᵀ."""
        return _lower_inverse(self._with_y[:-1, :-1])

    @cached_property
    def _inverse(self) -> Array:
        """Of the scaled equations."""
        return np.asarray(self._root.T @ self._root, dtype=float)

    @cached_property
    def _solution(self) -> Array:
        """Unknowns and coefficients, scaled."""
        return self._root.T @ self._with_y[-1, :-1]

    @property
    def solution(self) -> Array:
        """x̂ (u,), the best linear unbiased estimate."""
        return (self.scale * self._solution)[: self.unknowns]

    @property
    def coefficients(self) -> Array:
        """ĉ (m,), the best linear prediction."""
        c = np.zeros(len(self.group))
        c[self._live] = (self.scale * self._solution)[self.unknowns :]
        return c

    @property
    def covariance(self) -> Array:
        """(u + m, u + m) of x̂ - x and ĉ - c."""
        full = np.zeros((self.unknowns + len(self.group),) * 2)
        full[np.ix_(self.index, self.index)] = self._inverse * np.outer(self.scale, self.scale)
        return full

    @cached_property
    def residual(self) -> Array:
        """(w,) coefficients of F that give what is left of y."""
        v = np.zeros(self.moments.shape[-1])
        v[self.index] = -self.scale * self._solution
        v[-1] = 1.0
        return v

    @cached_property
    def _squares(self) -> Array:
        """(K,) of what is left of y, by kind."""
        return np.einsum("i,kij,j->k", self.residual, self.moments, self.residual)

    @property
    def log_likelihood(self) -> float:
        """Restricted, but for a constant."""
        logs = np.log(np.diagonal(self._with_y)[:-1]).sum() - np.log(self.scale[: self.unknowns]).sum()
        noise = (self.rows * np.log(self.noise)).sum()
        return self.constant - 0.5 * float(2 * logs + noise + self._with_y[-1, -1] ** 2)

    @cached_property
    def told(self) -> Array:
        """(G,) of how many coefficients of each group the data tell (MacKay's γ)."""
        own = 1 - np.diagonal(self._inverse)[self.unknowns :]
        return np.bincount(self.group[self._live], own, len(self.variance)).astype(float)

    @cached_property
    def _freedom(self) -> Array:
        """(K,) rows less what unknowns and coefficients take of them."""
        i = self.index
        C = self._inverse * np.outer(self.scale, self.scale)
        taken = np.array([(C * M[np.ix_(i, i)]).sum() for M in self.moments]) / self.noise
        return np.maximum(self.rows - taken, LEAST_FREEDOM)

    @property
    def gradient(self) -> Array:
        """(G + K,) of the log-likelihood by log λ and log d; 0 where λ is 0."""
        square = self._solution[self.unknowns :] ** 2
        by_group = np.bincount(self.group[self._live], square, len(self.variance)) - self.told
        return 0.5 * np.concatenate([by_group, self._squares / self.noise - self._freedom])

    @property
    def average_information(self) -> Array:
        """(G + K, G + K), ½ w_aᵀ P w_b with w = ∂V/∂log P y, which is Z_g ĉ_g or the rows of a kind of the residual."""
        K, width = len(self.noise), self.moments.shape[-1]
        groups = len(self.variance)
        w = np.zeros((groups + K, K + 1, width))
        live = self.index[self.unknowns :]
        c = self.coefficients[self._live]
        w[self.group[self._live], :, live] = c[:, None]
        for k in range(K):
            w[groups + k, k] = self.residual
        every = np.concatenate([self.moments / self.noise[:, None, None], self.fixed[None]])
        weighted = np.matmul(w.swapaxes(0, 1), every)
        inner = np.einsum("kai,bki->ab", weighted, w, optimize=True)
        B = weighted.sum(axis=0)[:, self.index] * self.scale
        return 0.5 * (inner - B @ self._inverse @ B.T)

    def from_nothing(self) -> tuple[Array, Array]:
        """Derivative (G,) of the log-likelihood by λ of the groups that have none, and its variance, were there no
        effect; 0 and 1 for the others."""
        score, information = np.zeros(len(self.variance)), np.ones(len(self.variance))
        i, K = self.index, self._normal_unscaled
        for g in np.flatnonzero(self.variance == 0):
            z = self.unknowns + np.flatnonzero(self.group == g)
            cross = self._root @ (K[np.ix_(i, z)] * self.scale[:, None])
            Zy = K[z, -1] - K[np.ix_(z, i)] @ (self.scale * self._solution)
            S = K[np.ix_(z, z)] - cross.T @ cross
            score[g], information[g] = 0.5 * (Zy @ Zy - np.trace(S)), 0.5 * (S**2).sum()
        return score, information

    def at(self, variance: Array, noise: Array) -> "Mixed":
        """The model at other variances."""
        return replace(self, variance=variance, noise=noise)


def most_likely(model: Mixed) -> Mixed:
    """The model at the most likely variances, from those of ``model``; a group without effect gets 0, which stays.

    Noise that the rows do not tell apart from the effects is not let below a tenth of where it starts.
    """
    least, groups = 0.1 * model.noise, len(model.variance)
    for _ in range(MOST_STEPS):
        live = np.concatenate([model.variance, model.noise]) > 0
        g, A = model.gradient[live], model.average_information[np.ix_(live, live)]
        step = np.zeros(len(live))
        damped = A + DAMPING * np.diag(np.maximum(np.diagonal(A), 0.5))
        step[live] = np.clip(np.linalg.solve(damped, g), -LONGEST_STEP, LONGEST_STEP)
        trial = _climbed(model, step, least)
        gone = (trial.variance > 0) & (trial.told < NOTHING) & (step[:groups] < 0)
        if gone.any():
            trial = trial.at(np.where(gone, 0.0, trial.variance), trial.noise)
        settled = np.abs(step[live] @ g) < SETTLED
        model = trial
        if settled:
            break
    return model


def _climbed(model: Mixed, step: Array, least: Array) -> Mixed:
    """The model after the ``step`` of the logarithms, shortened until it climbs; as it is where none does."""
    groups = len(model.variance)
    for shorter in (1.0, 0.4, 0.16, 0.06, 0.02):
        by = np.exp(shorter * step)
        trial = model.at(model.variance * by[:groups], np.maximum(model.noise * by[groups:], least))
        if trial.log_likelihood >= model.log_likelihood - ROUNDING * abs(model.log_likelihood):
            return trial
    return model


def _lower_inverse(L: Array) -> Array:
    """Inverse of a lower triangular matrix, by halves."""
    n = len(L)
    if n <= SMALL:
        return np.asarray(np.linalg.inv(L), dtype=float)
    h = n // 2
    inverse = np.zeros_like(L)
    inverse[:h, :h], inverse[h:, h:] = _lower_inverse(L[:h, :h]), _lower_inverse(L[h:, h:])
    inverse[h:, :h] = -inverse[h:, h:] @ L[h:, :h] @ inverse[:h, :h]
    return inverse
