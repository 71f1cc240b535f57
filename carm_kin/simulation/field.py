"""A tracker that distorts: a smooth random displacement of what it sees, as a function of the place."""

from dataclasses import dataclass

import numpy as np

from carm_kin.errors import InputError
from solvers.se3 import Array, exp_so3

WAVES = 24
SHORTEST_M, LONGEST_M = 1.0, 2.0
"""Lengths of the waves."""
LEAST_WAY_M = 1e-6
"""A sensor that moves less stands still."""


@dataclass(frozen=True, eq=False)
class Field:
    """A sum of plane waves, m: sum_k amplitude_k cos(wave_k . p + phase_k)."""

    wave: Array
    """(K, 3) rad/m."""
    phase: Array
    """(K,) rad."""
    amplitude: Array
    """(K, 3)."""

    @staticmethod
    def random(rng: np.random.Generator) -> "Field":
        """Waves of `SHORTEST_M` to `LONGEST_M` in all directions; a component has the variance 1 m²."""
        direction = rng.normal(size=(WAVES, 3))
        number = 2 * np.pi / rng.uniform(SHORTEST_M, LONGEST_M, size=(WAVES, 1))
        wave = number * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        amplitude = rng.normal(size=(WAVES, 3)) * np.sqrt(2 / WAVES)
        return Field(wave, rng.uniform(0, 2 * np.pi, WAVES), amplitude)

    def shift(self, p: Array) -> Array:
        """(N, 3) displacement at positions (N, 3)."""
        return np.cos(p @ self.wave.T + self.phase) @ self.amplitude

    def turn(self, p: Array) -> Array:
        """(N, 3) rotation vector, rad, of a small body at positions (N, 3): half the curl of `shift`."""
        return -0.5 * np.sin(p @ self.wave.T + self.phase) @ np.cross(self.wave, self.amplitude)


def distorted(T: Array, rms_m: float, rng: np.random.Generator) -> Array:
    """Poses T (N, 4, 4), m, as a tracker sees them that distorts, with a field in the tracker's own frame.

    Less its mean, which only moves the tracker's frame, the displacement has the root mean square length ``rms_m``
    over the poses. Raises InputError where all positions are the same.
    """
    field, p = Field.random(rng), T[:, :3, 3]
    if np.ptp(p, axis=0).max() < LEAST_WAY_M:
        raise InputError("field_m: the sensor does not move, so that no distortion shows")
    shift = field.shift(p)
    varying = shift - shift.mean(axis=0)
    size = float(np.sqrt((varying**2).sum(axis=1).mean()))
    seen = T.copy()
    seen[:, :3, 3] += rms_m / size * varying
    seen[:, :3, :3] = exp_so3(rms_m / size * field.turn(p)) @ T[:, :3, :3]
    return seen
