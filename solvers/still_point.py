"""The point of a body that stays where it is while the body turns about one axis and its base travels.

The body turns about the y axis of its `carm` frame. The point sought is v = (x, 0, z) of that frame, since a shift
along the axis changes nothing. At every pose R_i (t + v) + p_i = c, linear in v and in the place c of the point in
the world. docs/estimation.md, 14, derives the weights and compares the variance with the Cramer-Rao bound.
"""

from dataclasses import dataclass

import numpy as np

from solvers.likelihood.covariance import marginal_covariance
from solvers.problem import Problem
from solvers.se3 import Array, inverse


@dataclass(frozen=True, eq=False)
class StillPoint:
    """The most likely point, m. Covariances are those of the poses' noise."""

    v: Array
    """(3,) in `carm`; y = 0."""
    c: Array
    """(3,) in the world."""
    C_v: Array
    """(3, 3), m^2; 0 along y."""
    C_c: Array
    """(3, 3), m^2."""
    chi2: float
    """Weighted sum of squares of the point's distances from c."""
    dof: int
    least: Array
    """(3,) in `carm`: the point of the least sum of squares without weights, where no point stands still."""


def still_point(problem: Problem, T_sensor_carm: Array, sigma: tuple[float, float]) -> StillPoint:
    """The point for poses with the noise ``sigma`` (m, rad).

    The noise of the equation is sigma_t along the lever s_i from the sensor to the point, and
    sqrt(sigma_t^2 + |s_i|^2 sigma_r^2) across it. The lever is taken to the point that equal weights give.
    """
    R = problem.rotations @ T_sensor_carm[:3, :3]
    q = problem.p_world_sensor + problem.rotations @ T_sensor_carm[:3, 3]
    A = np.concatenate([R[:, :, [0, 2]], np.broadcast_to(-np.eye(3), R.shape)], axis=2)
    sensor = inverse(T_sensor_carm)[:3, 3]
    least = _solved(A, q, np.broadcast_to(np.eye(3), R.shape))[0]
    W = _weights(R, _in_plane(least) - sensor, sigma)
    x, H = _solved(A, q, W)
    e = q + A @ x
    C = marginal_covariance(H, np.ones(5, dtype=bool))
    C_v = np.zeros((3, 3))
    C_v[np.ix_([0, 2], [0, 2])] = C[:2, :2]
    chi2 = float(np.einsum("ni,nij,nj", e, W, e))
    return StillPoint(_in_plane(x), x[2:], C_v, C[2:, 2:], chi2, 3 * len(problem) - 5, _in_plane(least))


def _in_plane(x: Array) -> Array:
    return np.array([x[0], 0.0, x[1]])


def _weights(R: Array, lever: Array, sigma: tuple[float, float]) -> Array:
    """(N, 3, 3) inverse covariance of R_i v + q_i - c for the ``lever`` (3,) from the sensor, in `carm`."""
    across = 1 / (sigma[0] ** 2 + sigma[1] ** 2 * lever @ lever)
    u = R @ (lever / max(float(np.linalg.norm(lever)), np.finfo(float).tiny))
    return across * np.eye(3) + (sigma[0] ** -2 - across) * u[:, :, None] * u[:, None]


def _solved(A: Array, q: Array, W: Array) -> tuple[Array, Array]:
    """x (5,) = (v_x, v_z, c) that minimises the sum of e^T W e with e = q_i + A_i x, and half the second derivative."""
    AW = np.swapaxes(A, 1, 2) @ W
    H = (AW @ A).sum(axis=0)
    return np.linalg.lstsq(H, -(AW @ q[:, :, None]).sum(axis=0)[:, 0], rcond=1e-14)[0], H
