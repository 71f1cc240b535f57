"""How a circular arc bends under a load: Euler-Bernoulli's beam, clamped at one end, for small deflections.

The arc lies in the x-z plane about the origin; its angle runs from z to x, so that a turn about y by b adds b to it. A
force F at a point r_F that is rigid with the free end loads the section at r with the moment

    m = (r_F - r) x F ,

which turns it by dtheta = sum_k c_k (m . e_k) e_k ds, k over bending in the plane (about y), bending out of it (about
the radius) and torsion (about the tangent). What is rigid with the free end turns and, at a point r_u, moves by

    theta = int dtheta ,   u = int dtheta x (r_u - r) .

This is what Castigliano's theorem gives with a unit load for each of the six.
"""

from dataclasses import dataclass

import numpy as np

from solvers.se3 import Array

NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)
"""Of Gauss' rule on [-1, 1]; the integrands are short Fourier sums over the arc, which it gives to rounding."""


@dataclass(frozen=True)
class Arc:
    """A circular arc and what a unit of its length yields to a unit moment, rad/(N m²)."""

    radius: float
    """m."""
    bending: float = 1.0
    """1 / EI about the normal of its plane."""
    sideways: float = 1.0
    """1 / EI about its radius."""
    torsion: float = 1.3
    """1 / GJ. With 1 for bending that of a thin square tube, GJ = 2 G I, G = E / 2.6."""

    def point(self, angle: Array) -> Array:
        """(..., 3) of the arc at angles (...), rad."""
        return self.radius * _radial(angle)

    def deflection(self, clamp: Array, end: Array, force: Array, loaded: Array, seen: Array) -> tuple[Array, Array]:
        """Shift (N, 3) of the point ``seen`` and turn (N, 3), rad, of all that is rigid with the free end.

        ``clamp`` and ``end`` are (N,) angles, rad; ``force`` (N, 3), N, acts at ``loaded``; both points are (3,), m.
        """
        shift, turn = np.zeros_like(force), np.zeros_like(force)
        middle, half = (end + clamp) / 2, (end - clamp) / 2
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            angle = middle + half * node
            at = self.point(angle)
            by = self._yield(np.cross(loaded - at, force), angle) * (self.radius * np.abs(half) * weight)[:, None]
            turn += by
            shift += np.cross(by, seen - at)
        return shift, turn

    def _yield(self, moment: Array, angle: Array) -> Array:
        """(N, 3) turn of a unit of length under moments (N, 3)."""
        axes = np.array([0.0, 1.0, 0.0]), _radial(angle), _radial(angle + np.pi / 2)
        parts = zip((self.bending, self.sideways, self.torsion), axes, strict=True)
        return sum((c * (moment * e).sum(axis=1, keepdims=True) * e for c, e in parts), np.zeros_like(moment))


def _radial(angle: Array) -> Array:
    """(..., 3) unit."""
    angle = np.asarray(angle, dtype=float)
    return np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)
