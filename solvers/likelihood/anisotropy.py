"""Noise that is not the same along all axes of the tracker: its covariances from the residuals of a fit.

docs/estimation.md, "Noise that is not isotropic". With e the errors of a pose, of which its own angles at their best
leave ê, expectation and maximisation give

    S ← mean (ê êᵀ + A inv(G) Aᵀ),    G = Aᵀ W A,

A the columns of the angles and W = inv(S) the weights of both kinds (Dempster, Laird and Rubin 1977).
"""

from dataclasses import dataclass

import numpy as np

from solvers.likelihood.linearise import AngleModel, linearise
from solvers.likelihood.reduced import inverse_blocks, row_scale
from solvers.problem import NoiseShape, Problem
from solvers.se3 import Array
from solvers.torus import Torus

PARTS = (slice(0, 3), slice(3, 6))
"""Rows of positions and of rotations."""
MOST_POSES = 2000
"""Poses from which the covariances are found."""
FREEDOM = 10
"""Numbers that two covariances of one trace each have beyond isotropic ones."""
SIGNIFICANT = 31.3
"""Chi-square of so many that is exceeded by chance once in 2,000."""
FIRST_ROUNDS, ROUNDS = 3, 30
SETTLED = 1e-3
"""Relative change of the covariances that ends the rounds."""
EXACT = 1e-6
"""Noise below this, m and rad, is rounding and has no shape."""
LEAST = 1 / 30
"""Least variance along an axis over that of the mean."""


def noise_shape(
    torus: Torus, angles: Array, problem: Problem, sigma: tuple[float, float], used: np.ndarray, lasts: float
) -> NoiseShape | None:
    """The shape of the noise from the residuals at ``angles`` (2, N) of the ``used`` (N,) poses, of an isotropic noise
    ``sigma`` (m, rad) that ``lasts`` for so many poses; None where it may be isotropic.

    The covariances are drawn to isotropic ones by the share of their likelihood that chance explains.
    """
    poses = np.flatnonzero(used)
    if not poses.size or min(sigma) < EXACT:
        return None
    step = -(-len(poses) // MOST_POSES)
    poses = poses[::step]
    residuals = _Residuals.of(torus, angles[:, poses], problem.select(poses), sigma)
    lasts = max(lasts / step, 1.0)
    S = np.array([np.eye(3), np.eye(3)])
    start = residuals.log_likelihood(S)
    for k in range(ROUNDS):
        new = residuals.maximised(S)
        settled = np.abs(new - S).max() < SETTLED
        S = new
        if k == FIRST_ROUNDS and 2 * (residuals.log_likelihood(S) - start) / lasts < SIGNIFICANT / 2:
            return None
        if settled:
            break
    gained = 2 * (residuals.log_likelihood(S) - residuals.most_likely_isotropic()) / lasts
    if not gained >= SIGNIFICANT:
        return None
    by_chance = FREEDOM / gained
    shapes = []
    for kind in S:
        kind = kind * 3 / np.trace(kind)
        values, vectors = np.linalg.eigh((1 - by_chance) * kind + by_chance * np.eye(3))
        values = np.maximum(values, LEAST)
        shapes.append((vectors * (3 * values / values.sum())) @ vectors.T)
    return NoiseShape(shapes[0], shapes[1])


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Over the isotropic noise, in the tracker's axes."""

    residual: Array
    """(6, n)."""
    by_angle: Array
    """(6, 2, n), 0 where an angle is not free."""
    model: AngleModel

    @staticmethod
    def of(torus: Torus, angles: Array, problem: Problem, sigma: tuple[float, float]) -> "_Residuals":
        line, model = linearise(torus, angles, problem), AngleModel.of(problem)
        R = torus.poses(angles.T, problem.placement)[:, :3, :3] @ torus.T_sensor_carm[:3, :3]
        scale = row_scale(model, sigma)
        residual, A = line.residual * scale, line.by_angle * scale[:, None] * model.free
        turned = [np.einsum("nij,j...n->i...n", R, x[part]) for x in (residual, A) for part in (slice(3), slice(3, 6))]
        return _Residuals(np.concatenate(turned[:2]), np.concatenate(turned[2:]), model)

    def _fitted(self, S: Array) -> tuple[Array, Array, Array, Array]:
        """W r, the entries of G and of its inverse, and the angles' steps (2, n) under covariances S (2, 3, 3)."""
        W = np.linalg.inv(S)
        Wr, WA = (
            np.concatenate([np.einsum("ij,j...->i...", w, x[part]) for w, part in zip(W, PARTS, strict=True)])
            for x in (self.residual, self.by_angle)
        )
        G = np.stack([(self.by_angle[:, i] * WA[:, j]).sum(axis=0) for i, j in ((0, 0), (0, 1), (1, 1))])
        inverse = inverse_blocks(G, self.model)
        g, h, k = inverse
        a, b = (self.by_angle * Wr[:, None]).sum(axis=0)
        return Wr, G, inverse, np.stack([g * a + h * b, h * a + k * b])

    def maximised(self, S: Array) -> Array:
        """The covariances (2, 3, 3) that follow upon S."""
        _, _, (g, h, k), step = self._fitted(S)
        left = self.residual - (self.by_angle * step).sum(axis=1)
        A = self.by_angle
        found = []
        for part in PARTS:
            first, second = A[part, 0] * g + A[part, 1] * h, A[part, 0] * h + A[part, 1] * k
            found.append(left[part] @ left[part].T + first @ A[part, 0].T + second @ A[part, 1].T)
        return np.array(found) / self.residual.shape[1]

    def log_likelihood(self, S: Array) -> float:
        """Of the residuals with the angles integrated out, but for a constant."""
        Wr, G, _, step = self._fitted(S)
        left = self.residual - (self.by_angle * step).sum(axis=1)
        logs = np.log(np.where(self.model.free.all(axis=0), G[0] * G[2] - G[1] ** 2, np.maximum(G[0] + G[2], 1e-300)))
        logs = np.where(self.model.free.any(axis=0), logs, 0.0).sum()
        n = self.residual.shape[1]
        return float(-0.5 * (n * np.log(np.linalg.det(S)).sum() + logs + (Wr * left).sum()))

    def most_likely_isotropic(self) -> float:
        """The greatest log-likelihood of covariances that are multiples of the unit."""
        S = np.array([np.eye(3), np.eye(3)])
        for _ in range(ROUNDS):
            S = np.array([np.eye(3) * np.trace(kind) / 3 for kind in self.maximised(S)])
        return self.log_likelihood(S)
