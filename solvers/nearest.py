"""The angles at which a pose of the two-axis chain comes nearest to a given pose: its inverse kinematics.

A full pose on the torus has one pair of angles, since the x row and the y column of
Rx(alpha) Rz(epsilon) Ry(beta) tell them separately. A position alone has two candidates. With the sensor at
(b sin(gamma), t_y, b cos(gamma)) in `carm`, its coordinate along the angular axis is

    x = b cos(epsilon) sin(phi) - t_y sin(epsilon),    phi = beta + gamma,

so phi or pi - phi, and alpha then turns that point into the given half plane. docs/estimation.md, 13, says which of
the two lies on the surface.
"""

import numpy as np

from solvers.likelihood import linearise
from solvers.problem import Problem
from solvers.se3 import Array, inverse
from solvers.torus import Torus

STEPS = 60
"""Most steps of one search."""
SETTLED_RAD = 1e-11
"""A shorter step ends it."""


def nearest(torus: Torus, problem: Problem, sigma: tuple[float, float], start: Array) -> Array:
    """alpha, beta (2, N), rad, of the least chi-square |dp|^2 / sigma_t^2 + |dw|^2 / sigma_r^2 of each pose.

    ``sigma`` is (m, rad), ``start`` (2, N). Levenberg-Marquardt with a damping for each pose, so that no step makes
    a pose worse. Without orientations the distance of the positions is minimised.
    """
    angles, damping = start.copy(), np.full(len(problem), 1e-9)
    residual, by_angle = _weighted(torus, problem, sigma, angles)
    for _ in range(STEPS):
        G = np.swapaxes(by_angle, 1, 2) @ by_angle
        diagonal = np.einsum("nii->ni", G)
        diagonal *= 1 + damping[:, None]
        diagonal += 1e-300
        step = -np.linalg.solve(G, np.swapaxes(by_angle, 1, 2) @ residual[:, :, None])[:, :, 0].T
        trial = angles + step
        residual_there, by_angle_there = _weighted(torus, problem, sigma, trial)
        better = (residual_there**2).sum(axis=1) <= (residual**2).sum(axis=1)
        angles = np.where(better, trial, angles)
        residual = np.where(better[:, None], residual_there, residual)
        by_angle = np.where(better[:, None, None], by_angle_there, by_angle)
        damping = np.where(better, 0.1 * damping, np.maximum(10 * damping, 1e-6))
        if np.abs(step).max(initial=0.0) < SETTLED_RAD:
            break
    return np.angle(np.exp(1j * angles))


def both(torus: Torus, problem: Problem) -> Array:
    """(2, 2, N): the first and the second candidate, alpha and beta, rad, of each position in closed form.

    Where no point of the torus has the position's x, phi is +-90 degrees and the two are one.
    """
    q = inverse(torus.T_sensor_carm)[:3, 3]
    p = _in_torus(torus, problem)
    reach = np.hypot(q[0], q[2]) * np.cos(torus.non_orthogonality)
    sine = (p[:, 0] + q[1] * np.sin(torus.non_orthogonality)) / max(reach, np.finfo(float).tiny)
    beta = np.arcsin(np.clip(sine, -1, 1)) - np.arctan2(q[0], q[2])
    first = np.stack([_alpha(torus, p, beta), np.angle(np.exp(1j * beta))])
    return np.stack([first, other(torus, problem, first)])


def other(torus: Torus, problem: Problem, angles: Array) -> Array:
    """alpha, beta (2, N), rad, of the candidate that has the same x as that at ``angles`` (2, N)."""
    q = inverse(torus.T_sensor_carm)[:3, 3]
    beta = np.pi - 2 * np.arctan2(q[0], q[2]) - angles[1]
    return np.stack([_alpha(torus, _in_torus(torus, problem), beta), np.angle(np.exp(1j * beta))])


def _alpha(torus: Torus, p: Array, beta: Array) -> Array:
    """alpha (N,) that brings the sensor at ``beta`` (N,) nearest to ``p`` (N, 3), in the torus frame."""
    zero = np.zeros_like(beta)
    at = torus.T_torus_carm(np.stack([zero, beta], axis=1)) @ np.append(inverse(torus.T_sensor_carm)[:3, 3], 1.0)
    return np.angle(np.exp(1j * (np.arctan2(p[:, 2], p[:, 1]) - np.arctan2(at[:, 2], at[:, 1]))))


def _in_torus(torus: Torus, problem: Problem) -> Array:
    """(N, 3) positions in the torus frame of their placement, m."""
    R = torus.T_world_torus[problem.placement, :3, :3]
    return np.einsum("nji,nj->ni", R, problem.p_world_sensor - torus.center[problem.placement])


def _weighted(torus: Torus, problem: Problem, sigma: tuple[float, float], angles: Array) -> tuple[Array, Array]:
    """Residuals (N, K) and their derivatives by the angles (N, K, 2), each over its noise."""
    line = linearise(torus, angles, problem)
    scale = 1 / np.repeat(sigma, 3)[: len(line.residual)]
    return line.residual.T * scale, np.moveaxis(line.by_angle, -1, 0) * scale[:, None]
