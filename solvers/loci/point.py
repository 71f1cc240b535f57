"""A fixed pivot: pivot calibration of a pointer, ``R_i t + p_i = c``, by the equations of `solvers.pivot`."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from solvers import pivot
from solvers.estimate import Correlation, Covariance, Estimate, Told
from solvers.loci import reported_by_name
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.told import Turned, basis, turn_noise, turned

LEAST_POSES = 4
"""Fewer leave nothing of which a covariance could be made."""
REACH_M = 0.25
"""What is told of the offset holds within its sigma for a pivot that is no farther from the sensor along the untold
direction, which leans."""


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

    def solve(self, problem: Problem, seed: int, reject_outliers: bool) -> Estimate:
        """The offset as far as it is told, with outliers, untold directions and noisy orientations allowed for.

        Where the motion does not tell all of it, ``offset`` and ``covariance`` are None.
        """
        used = pivot.agreeing(problem, seed) if reject_outliers else np.ones(len(problem), dtype=bool)
        part = problem if used.all() else problem.select(used)
        if len(np.unique(part.placement)) < problem.placements or len(part) < LEAST_POSES:
            nothing = Told(np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.eye(3), np.full(3, np.inf))
            return Estimate("direct", center=np.full((problem.placements, 3), np.nan), used=used, told=nothing)
        noise = turn_noise(part)
        seen = turned(part, noise.sigma)
        kept = basis(seen)
        found = pivot.fit(part, kept, noise.sigma**2, noise.sigma_of_square**2)
        told, whole = _told(found, kept, seen, len(part)), len(kept) == 3
        return Estimate(
            "direct",
            center=found.c,
            offset=found.t if whole else None,
            major_radius=0.0 if whole else None,
            sigma_t=float(np.sqrt(found.noise.along)),
            sigma_r=float(np.sqrt(found.noise.turn)),
            used=used,
            residual=found.residual,
            covariance=self._covariance(found) if whole else None,
            unobservable=tuple(map(_in_words, told.untold)),
            told=told,
            correlation=Correlation(found.lasts, found.lasts),
        )

    def _covariance(self, found: pivot.Pivot) -> Covariance:
        """Of t and c, whose order in theta is the other way round."""
        names, J = self.reported(np.column_stack([found.c, np.broadcast_to(found.t, found.c.shape)]))
        turned_round = np.roll(np.arange(J.shape[1]), -3)
        return Covariance(names, J @ found.covariance[np.ix_(turned_round, turned_round)] @ J.T)


def _told(found: pivot.Pivot, kept: Array, seen: Turned, poses: int) -> Told:
    variance = np.diagonal(found.covariance)[: len(kept)]
    most = max(float(seen.spread[0]), np.finfo(float).tiny)
    # a null vector of S leans by the mean of what is left along it over what turns across it
    lean = np.sqrt((seen.spread[~seen.told] + 2 * found.noise.turn) / most / poses)
    variance = variance + (REACH_M * lean.max(initial=0.0)) ** 2
    return Told(kept, kept @ found.t, np.sqrt(variance), _facing(seen.directions[~seen.told]), lean)


def _facing(directions: Array) -> Array:
    """The directions (K, 3) with their greatest component above 0, and no -0."""
    greatest = np.take_along_axis(directions, np.abs(directions).argmax(axis=1)[:, None], axis=1)
    return directions * np.sign(greatest) + 0.0


def _in_words(direction: Array) -> str:
    x, y, z = np.round(direction, 3) + 0.0
    return f"the offset along ({x:.3f}, {y:.3f}, {z:.3f}) of the sensor's frame, about which alone the sensor turned"
