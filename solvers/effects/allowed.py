"""The estimate that allows for systematic effects, and what its uncertainty is made of."""

from dataclasses import replace

import numpy as np

from solvers.effects.deformed import deformed
from solvers.effects.of_point import PointSystematic
from solvers.effects.systematic import Systematic
from solvers.estimate import Covariance, Estimate, SigmaPart
from solvers.likelihood.covariance import reported_jacobian
from solvers.likelihood.elimination import normal_equations
from solvers.likelihood.linearise import AngleModel, retract
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus

LEAST_GAIN = 8.0
"""In log-likelihood, from which on the effects move the estimate, and not only widen its ±."""
LEAST_BLOCKS = 100
"""Stretches of poses below which the effects only widen the ±: some stations do not tell them from the machine."""
FARTHEST = 5.0
"""Standard deviations of the estimate, with all effects, by which they may move it."""
KEPT = ("sigma_t", "sigma_r", "sigma_label", "shape", "used", "iterations", "converged", "notes")
"""What of an estimate the effects do not change."""


def allowing_for(estimate: Estimate, problem: Problem, found: Systematic | PointSystematic) -> Estimate:
    """The estimate of ``problem`` with the effects ``found`` beside it.

    That of `kinematic` moves to where noise and effects together are most likely, if the data ask for effects and the
    way is within what they explain; another one stays, with a covariance that heeds them.
    """
    if isinstance(found, PointSystematic):
        return found.allowed(estimate)
    stated = estimate.covariance
    if estimate.torus is None or stated is None:
        return estimate
    widened = _widened(estimate, estimate.torus, stated, found)
    few = len(found.scene.blocks.middle) < LEAST_BLOCKS
    if estimate.solver != "kinematic" or found.gain < LEAST_GAIN or few or widened.covariance is None:
        return widened
    move = (_reported(estimate.torus, found) @ found.step)[:3]
    if move @ np.linalg.solve(widened.covariance.block("offset"), move) > FARTHEST**2:
        return widened
    return _moved(estimate, estimate.torus, problem, found)


def _widened(estimate: Estimate, torus: Torus, stated: Covariance, found: Systematic) -> Estimate:
    """The same estimate with Cov + B Λ Bᵀ, B = C Jᵀ Z and C = inv(Jᵀ J) of noise that does not last."""
    J = _reported(torus, found)
    k = J.shape[1]
    shares = found.shares(J @ found.drawn[:k])
    white = J @ found.plain[:k, :k] @ J.T
    parts = {"noise": white, "correlation": stated.matrix - white, **shares}
    total = stated.matrix + sum(shares.values())
    return _with_parts(estimate, found, Covariance(stated.names, total), parts)


def _moved(estimate: Estimate, torus: Torus, problem: Problem, found: Systematic) -> Estimate:
    """The best linear unbiased estimate beside the effects: x̂ = G y with the gain G = A Fᵀ D⁻¹ of Henderson's
    equations, which takes the share G Z_g λ_g Z_gᵀ Gᵀ of each effect and G D Gᵀ of the noise."""
    there = retract(torus, found.full_step)
    J, names = _reported(there, found), reported_jacobian(there)[1]
    model, u = found.model, found.model.unknowns
    A = J @ model.covariance[: J.shape[1]]
    by_kind = model.moments / model.noise[:, None, None]
    shares = found.shares(A @ (by_kind.sum(axis=0) + model.fixed)[:-1, u:-1])
    white, lasting = np.zeros((2, len(names), len(names)))
    for M, factor in zip(by_kind, model.noise * (1 + found.rho) / (1 - found.rho), strict=True):
        part = A @ M[:-1, :-1] @ A.T
        white += part / max(factor, 1.0)
        lasting += part * (1 - 1 / max(factor, 1.0))
    white += A @ model.fixed[:-1, :-1] @ A.T
    parts = {"noise": white, "correlation": lasting, **shares}
    used = np.ones(len(problem), dtype=bool) if estimate.used is None else estimate.used
    sigma = (estimate.sigma_t or 0.0, estimate.sigma_r or 0.0)
    weighed = estimate.weighed(problem)
    angles = torus.angles(problem).T if estimate.angles is None else estimate.angles.T
    at = normal_equations(there, angles, weighed, AngleModel.of(weighed), sigma, used)
    angles = angles + at.angle_step(np.zeros(len(at.g)))
    kept = {name: getattr(estimate, name) for name in KEPT}
    moved = Estimate.of_torus(estimate.solver, there, angles=angles.T, correlation=found.correlation, **kept)
    moved = replace(moved, deformed=deformed(found, there))
    return _with_parts(moved, found, Covariance(names, np.sum([*parts.values()], axis=0)), parts)


def _with_parts(estimate: Estimate, found: Systematic, covariance: Covariance, parts: dict[str, Array]) -> Estimate:
    return replace(
        estimate,
        covariance=covariance,
        sigma_parts=tuple(SigmaPart(name, Covariance(covariance.names, matrix)) for name, matrix in parts.items()),
        effects=tuple(map(found.effect, found.names)),
    )


def _reported(torus: Torus, found: Systematic) -> Array:
    """(K, a) derivative of the reported quantities by the active unknowns."""
    return reported_jacobian(torus)[0][:, found.scene.blocks.active]
