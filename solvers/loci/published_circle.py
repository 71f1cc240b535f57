"""The energy as published (Lee et al. 2020, Eq. 6), for comparison: distance to a circle and to its plane.

Every point of the orbital axis moves on a circle about the same centre in the same plane, so the
offset is undetermined along that axis: a solver stops wherever it started. `estimate` says so.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from solvers import closed_form
from solvers.estimate import Estimate, Note
from solvers.problem import Problem
from solvers.se3 import Array, orthonormal_complement
from solvers.torus import Axes

C, N, RADIUS, T = slice(0, 3), slice(3, 6), 6, slice(7, 10)


@dataclass(frozen=True)
class Locus:
    """theta = [c, n | R, t]."""

    size: int = 10
    own: int = 6
    needs_rotation_about_two_axes: bool = True

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
        return self.theta(closed_form.axes_of(problem))

    def theta(self, axes: Axes) -> Array:
        """(P, 10) of the given axes."""
        shared = [abs(axes.major_radius), *axes.offset]
        own = np.concatenate([axes.center, axes.angular_axis], axis=1)
        return np.concatenate([own, np.broadcast_to(shared, (len(own), 4))], axis=1)

    def estimate(self, theta: Array, problem: Problem, **more) -> Estimate:
        """Offset, radius, centre and plane as they came to rest, with the null direction."""
        direction = more["null_direction_sensor"]
        note = Note(
            "gauge_undetermined",
            "gauge 'published' leaves the offset undetermined along the orbital axis, in the sensor frame "
            f"({direction[0]:+.4f}, {direction[1]:+.4f}, {direction[2]:+.4f}): offset and major radius are those of the "
            "point of that axis where the solver happened to stop; use gauge 'tangent'",
        )
        return Estimate(
            "direct",
            center=theta[:, C],
            offset=theta[0, T],
            angular_axis=theta[:, N],
            major_radius=float(abs(theta[0, RADIUS])),
            notes=(note,),
            **more,
        )
