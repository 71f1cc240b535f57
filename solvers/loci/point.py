"""A fixed pivot: standard pivot calibration of a pointer, ``R_i t + p_i = c``."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from solvers.estimate import Estimate
from solvers.loci import reported_by_name
from solvers.problem import Problem
from solvers.se3 import Array


@dataclass(frozen=True)
class Locus:
    """theta = [c | t]."""

    size: int = 6
    own: int = 3

    def residual(self, theta: ca.SX, R: ca.SX, p: ca.SX, lever: ca.SX) -> ca.SX:
        """The three components of ``R t + p - c``."""
        return R @ theta[3:6] + p - theta[:3]

    def basis(self, theta: Array) -> Array:
        """Every direction is free."""
        return np.eye(self.size)

    def normalised(self, theta: Array) -> Array:
        """Nothing to normalise."""
        return theta

    def start(self, problem: Problem) -> Array:
        """t = 0 and the mean position: the problem is linear, one step ends it."""
        p = problem.p_world_sensor
        centers = [p[problem.placement == k].mean(axis=0) for k in range(problem.placements)]
        return np.stack([np.concatenate([c, np.zeros(3)]) for c in centers])

    def reported(self, theta: Array) -> tuple[tuple[str, ...], Array]:
        """The offset and the centres."""
        P = len(theta)
        rows = np.eye(3 * P + 3)
        centers = [rows[3 * k : 3 * k + 3] for k in range(P)]
        return reported_by_name({"offset_sensor_pivot": rows[3 * P :]}, {"torus_center_world": centers})

    def estimate(self, theta: Array, problem: Problem, null_direction_sensor: Array, **more: Any) -> Estimate:
        """Offset (the tip in the pointer's frame) and centre; a radius of zero and no axes."""
        return Estimate("direct", center=theta[:, :3], offset=theta[0, 3:6], major_radius=0.0, **more)
