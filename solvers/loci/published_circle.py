"""The energy as published (Lee et al. 2020, Eq. 6), for comparison: distance to a circle and to its plane.

Every point of the orbital axis moves on a circle about the same centre in the same plane, so the
offset is undetermined along that axis: where a solver comes to rest is left to the start and the noise.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from solvers.estimate import Estimate, Note
from solvers.loci import reported_by_name
from solvers.problem import Problem
from solvers.se3 import Array, orthonormal_complement
from solvers.start.axes import axes_of
from solvers.torus import Axes

C, N, RADIUS, T = slice(0, 3), slice(3, 6), 6, slice(7, 10)


@dataclass(frozen=True)
class Locus:
    """theta = [c, n | R, t]."""

    size: int = 10
    own: int = 6

    def residual(self, theta: ca.SX, R: ca.SX, p: ca.SX, lever: ca.SX) -> ca.SX:
        """``|R t + p - c| - R`` and ``<R t + p - c, n>``; the norm is kept off zero by 1e-9 m."""
        arm = R @ theta[T] + p - theta[C]
        return ca.vertcat(ca.sqrt(ca.sumsqr(arm) + 1e-18) - theta[RADIUS], ca.dot(arm, theta[N]))

    def basis(self, theta: Array) -> Array:
        """c, two directions of n, R and t."""
        columns = np.zeros((self.size, 9))
        columns[C, 0:3] = np.eye(3)
        columns[N, 3:5] = orthonormal_complement(theta[N])
        columns[6:10, 5:9] = np.eye(4)
        return columns

    def normalised(self, theta: Array) -> Array:
        """n of unit length."""
        theta = theta.copy()
        theta[..., N] /= np.linalg.norm(theta[..., N], axis=-1, keepdims=True)
        return theta

    def start(self, problem: Problem) -> Array:
        """The closed form."""
        return self.theta(axes_of(problem))

    def theta(self, axes: Axes) -> Array:
        """(P, 10) of the given axes."""
        shared = [abs(axes.major_radius), *axes.offset]
        own = np.concatenate([axes.center, axes.angular_axis], axis=1)
        return np.concatenate([own, np.broadcast_to(shared, (len(own), 4))], axis=1)

    def reported(self, theta: Array) -> tuple[tuple[str, ...], Array]:
        """Centre and plane; offset and radius have no finite variance."""
        P, bases = len(theta), [self.basis(x) for x in theta]
        size = 5 * P + 4

        def rows(entries: slice, k: int) -> Array:
            J = np.zeros((3, size))
            J[:, 5 * k : 5 * k + 5] = bases[k][entries, :5]
            return J

        centers, axes = [rows(C, k) for k in range(P)], [rows(N, k) for k in range(P)]
        return reported_by_name({}, {"torus_center_world": centers, "angular_axis_world": axes})

    def estimate(self, theta: Array, problem: Problem, null_direction_sensor: Array, **more: Any) -> Estimate:
        """Offset, radius, centre and plane as they came to rest, with the null direction."""
        direction = null_direction_sensor[-3:] / np.linalg.norm(null_direction_sensor[-3:])
        components = ", ".join(f"{x:+.4f}" for x in direction)
        words = f"along the orbital axis, ({components}) in the sensor frame"
        note = Note(
            "gauge_undetermined",
            f"gauge 'published' leaves the offset undetermined {words}: offset and major radius are those of the "
            "point of that axis to which the start and the noise led; use gauge 'tangent'",
        )
        return Estimate(
            "direct",
            center=theta[:, C],
            offset=theta[0, T],
            angular_axis=theta[:, N],
            major_radius=float(abs(theta[0, RADIUS])),
            null_direction_sensor=direction,
            unobservable=(f"the offset {words}",),
            notes=(note,),
            **more,
        )
