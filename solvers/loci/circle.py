"""The pivot of a C-arm, in the gauge that fixes it: the foot of the common perpendicular.

With y = R_i a the orbital axis in the world, n the angular axis and z = n x y normalised,
``R_i t + p_i - c - R z = 0`` states circle, plane and tangency together and is smooth at R = 0;
``<y, n> + sin(epsilon) = 0``, times a lever, determines the axes even there.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from solvers.estimate import Estimate
from solvers.loci import reported_by_name
from solvers.problem import Problem
from solvers.se3 import Array, orthonormal_complement
from solvers.start.axes import axes_of
from solvers.torus import Axes

C, N, RADIUS, T, A, SINE = slice(0, 3), slice(3, 6), 6, slice(7, 10), slice(10, 13), 13


@dataclass(frozen=True)
class Locus:
    """theta = [c, n | R, t, a, sin(epsilon)]."""

    fix_non_orthogonality: bool = True
    """Take the axes as perpendicular."""
    size: int = 14
    own: int = 6

    def residual(self, theta: ca.SX, R: ca.SX, p: ca.SX, lever: ca.SX) -> ca.SX:
        """The vector residual of the locus, then the angle between the axes."""
        n, y = theta[N], R @ theta[A]
        z = ca.cross(n, y)
        on_circle = R @ theta[T] + p - theta[C] - theta[RADIUS] * z / ca.norm_2(z)
        return ca.vertcat(on_circle, lever * (ca.dot(y, n) + theta[SINE]))

    def basis(self, theta: Array) -> Array:
        """c, two directions of n, R, t, two directions of a, and sin(epsilon) where it is free."""
        columns = np.zeros((self.size, 12))
        columns[C, 0:3] = np.eye(3)
        columns[N, 3:5] = orthonormal_complement(theta[N])
        columns[6:10, 5:9] = np.eye(4)
        columns[A, 9:11] = orthonormal_complement(theta[A])
        columns[SINE, 11] = 1
        return columns[:, :11] if self.fix_non_orthogonality else columns

    def normalised(self, theta: Array) -> Array:
        """n and a of unit length."""
        theta = theta.copy()
        for axis in (N, A):
            theta[..., axis] /= np.linalg.norm(theta[..., axis], axis=-1, keepdims=True)
        return theta

    def start(self, problem: Problem) -> Array:
        """The closed form."""
        return self.theta(axes_of(problem, self.fix_non_orthogonality))

    def theta(self, axes: Axes) -> Array:
        """(P, 14) of the given axes."""
        shared = [axes.major_radius, *axes.offset, *axes.orbital_axis, np.sin(axes.non_orthogonality)]
        own = np.concatenate([axes.center, axes.angular_axis], axis=1)
        return np.concatenate([own, np.broadcast_to(shared, (len(own), 8))], axis=1)

    def reported(self, theta: Array) -> tuple[tuple[str, ...], Array]:
        """All quantities of the chain, for the directions of n and a that theta has."""
        P, bases = len(theta), [self.basis(x) for x in theta]
        size = 5 * P + bases[0].shape[1] - 5

        def rows(entries: slice, k: int = 0) -> Array:
            J = np.zeros((len(theta[0, entries]), size))
            J[:, 5 * k : 5 * k + 5], J[:, 5 * P :] = bases[k][entries, :5], bases[k][entries, 5:]
            return J

        t, a = theta[0, T], theta[0, A]
        lever = t - a * (a @ t)
        lever /= max(float(np.linalg.norm(lever)), np.finfo(float).tiny)
        shared = {
            "offset_sensor_pivot": rows(T),
            "major_radius": rows(slice(RADIUS, RADIUS + 1)),
            "minor_radius": lever[None] @ rows(T) - (a @ t) * lever[None] @ rows(A),
            "axis_non_orthogonality": rows(slice(SINE, SINE + 1)) / np.sqrt(1 - theta[0, SINE] ** 2),
            "orbital_axis_sensor": rows(A),
        }
        own = {
            "torus_center_world": [rows(C, k) for k in range(P)],
            "angular_axis_world": [rows(N, k) for k in range(P)],
        }
        return reported_by_name(shared, own)

    def estimate(self, theta: Array, problem: Problem, null_direction_sensor: Array, **more: Any) -> Estimate:
        """The complete chain, its zeros set by the labels."""
        shared = theta[0]
        epsilon = float(np.arcsin(np.clip(shared[SINE], -1, 1)))
        axes = Axes(theta[:, C], theta[:, N], float(shared[RADIUS]), epsilon, shared[T], shared[A])
        return Estimate.of_torus("direct", axes.torus(problem), **more)
