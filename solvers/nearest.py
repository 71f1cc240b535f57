"""The angles at which a pose of the two-axis chain comes nearest to a given pose: its inverse kinematics.

With theta the angle between the orientations and |dp| the distance of the positions

    chi2 = |dp|^2 / sigma_t^2 + (2 sin(theta / 2))^2 / sigma_r^2 = const + u(alpha)^T M u(beta)

with u(a) = (1, cos a, sin a) and one 3x3 matrix M for each pose, since position and orientation of the chain are linear
in both u. So the best beta for a given alpha is known in closed form, and the other way round. docs/estimation.md, 13,
derives M.
"""

import numpy as np

from solvers.problem import Problem
from solvers.se3 import Array, inverse
from solvers.torus import Torus

GRID = 144
"""Values of alpha from which the best is taken."""
STEPS = 80
"""Most steps from there."""
ROUNDING = 1e-14
"""What rounding makes of a value, as a share of the terms that it is the sum of."""


def nearest(torus: Torus, problem: Problem, sigma: tuple[float, float]) -> Array:
    """alpha, beta (2, N), rad, in (-pi, pi], of the least chi2 of each pose; ``sigma`` is (m, rad).

    From the least over a grid of alpha with the best beta each, and from the second solution of that position, which
    may be as near. Without orientations the distance of the positions is minimised.
    """
    M = _forms(torus, problem, sigma)
    one = _refined(M, _start(M))
    two = _refined(M, other(torus, problem, one))
    return np.angle(np.exp(1j * np.where(_value(M, two) < _value(M, one), two, one)))


def other(torus: Torus, problem: Problem, angles: Array) -> Array:
    """alpha, beta (2, N), rad: the second solution of each position, at the same place along the angular axis.

    With the sensor at (b sin(gamma), t_y, b cos(gamma)) in `carm` that place is b cos(epsilon) sin(beta + gamma)
    - t_y sin(epsilon), so beta + gamma and pi less it have it in common. alpha brings the sensor nearest
    to the position.
    """
    q = inverse(torus.T_sensor_carm)[:3, 3]
    beta = np.pi - 2 * np.arctan2(q[0], q[2]) - angles[1]
    alpha = _best((_forms(torus, Problem.of_poses(problem.p_world_sensor, None), (1.0, 1.0)) @ _u(beta))[:, :, 0])
    return np.angle(np.exp(1j * np.stack([alpha, beta])))


def _forms(torus: Torus, problem: Problem, sigma: tuple[float, float]) -> Array:
    """M (N, 3, 3) of the first placement."""
    R_wt, R_sc = torus.T_world_torus[0, :3, :3], torus.T_sensor_carm[:3, :3]
    q, R = inverse(torus.T_sensor_carm)[:3, 3], torus.major_radius
    W = _turned(torus, q) + np.outer([0, 0, R], [1, 0, 0])
    M = -2 * _against((problem.p_world_sensor - torus.center[0]) @ R_wt) @ W
    M[:, 0] += 2 * R * np.array([0, q[2], -q[0]])
    M /= sigma[0] ** 2
    if problem.R_world_sensor is not None:
        R_torus_carm = R_wt.T @ problem.R_world_sensor @ R_sc
        for k in range(3):
            M -= _against(R_torus_carm[:, :, k]) @ _turned(torus, np.eye(3)[k]) / sigma[1] ** 2
    return M


def _turned(torus: Torus, q: Array) -> Array:
    """(3, 3): Rz(epsilon) Ry(beta) q over u(beta)."""
    c, s = np.cos(torus.non_orthogonality), np.sin(torus.non_orthogonality)
    return np.array([[-s * q[1], c * q[0], c * q[2]], [c * q[1], s * q[0], s * q[2]], [0.0, q[2], -q[0]]])


def _against(p: Array) -> Array:
    """(N, 3, 3): p^T Rx(alpha) over u(alpha), for p (N, 3)."""
    P = np.zeros((len(p), 3, 3))
    P[:, 0, 0] = p[:, 0]
    P[:, 1, 1], P[:, 1, 2] = p[:, 1], p[:, 2]
    P[:, 2, 1], P[:, 2, 2] = p[:, 2], -p[:, 1]
    return P


def _u(angle: Array) -> Array:
    """(N, 3, 1)."""
    return np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)[:, :, None]


def _start(M: Array) -> Array:
    """The least over a grid of alpha."""
    angles, least = np.zeros((2, len(M))), np.full(len(M), np.inf)
    for alpha in np.linspace(-np.pi, np.pi, GRID, endpoint=False):
        v = M[:, 0] + np.cos(alpha) * M[:, 1] + np.sin(alpha) * M[:, 2]
        value = v[:, 0] - np.hypot(v[:, 1], v[:, 2])
        better = value < least
        least = np.where(better, value, least)
        angles = np.where(better, [np.full(len(v), alpha), _best(v)], angles)
    return angles


def _refined(M: Array, angles: Array) -> Array:
    """Newton steps of each pose until one gains no more than rounding."""
    rounding, left, angles = ROUNDING * np.abs(M).sum(axis=(1, 2)), np.arange(len(M)), angles.copy()
    for _ in range(STEPS):
        step, gain = _newton(M[left], angles[:, left])
        angles[:, left] += step
        left = left[gain > rounding[left]]
        if not left.size:
            break
    return angles


def _value(M: Array, angles: Array) -> Array:
    return (np.swapaxes(_u(angles[0]), 1, 2) @ M @ _u(angles[1]))[:, 0, 0]


def _best(v: Array) -> Array:
    """The angle (N,) of the least v^T u, for v (N, 3)."""
    return np.arctan2(-v[:, 2], -v[:, 1])


def _newton(M: Array, angles: Array) -> tuple[Array, Array]:
    """The step (2, N), downhill where the curvature is negative as well, and what it gains (N,): any amount near a
    saddle."""
    sine, cosine = np.sin(angles), np.cos(angles)
    zero, one = np.zeros_like(sine), np.ones_like(sine)
    u, d, dd = (np.stack(x, axis=1) for x in ((one, cosine, sine), (zero, -sine, cosine), (zero, -cosine, -sine)))
    g = np.stack([_between(d[0], M, u[1]), _between(u[0], M, d[1])], axis=1)
    mixed = _between(d[0], M, d[1])
    H = np.stack([_between(dd[0], M, u[1]), mixed, mixed, _between(u[0], M, dd[1])], axis=1).reshape(-1, 2, 2)
    curvature, V = np.linalg.eigh(H)
    along = np.einsum("nji,nj->ni", V, g) / np.maximum(np.abs(curvature), np.finfo(float).tiny)
    step = -np.einsum("nij,nj->in", V, along)
    return step, np.where(curvature[:, 0] < 0, np.inf, -(g.T * step).sum(axis=0))


def _between(left: Array, M: Array, right: Array) -> Array:
    return np.einsum("jn,njk,kn->n", left, M, right)
