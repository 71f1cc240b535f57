"""Runout of an axis: how far its point and its direction wander while the body turns about it once.

Of a body that turns by theta about a line, the line's point s of the body stands at z in the plane across and at a
along it, and its direction leans by w. As a Fourier sum of theta, complex across, the terms of order 0 and 1 of z and w
are where the best line lies in the world and in the body, the term of order 0 of a where s lies along it. The other
orders up to `ORDER` are the runout; what they leave is the noise.
"""

from dataclasses import dataclass

import numpy as np

from solvers.likelihood.f_test import f_tail
from solvers.se3 import Array, orthonormal_complement

ORDER = 2
"""Of the wander."""
CHANCE = 1e-3
"""Noise makes a wander seldom enough below this probability."""
PLACES = 360
"""Of a long recording that are compared."""


@dataclass(frozen=True)
class Wander:
    """The greatest distance between two places on the way, m or rad."""

    size: float
    sigma: float
    """One standard deviation, by white noise."""
    told: bool
    """Whether noise seldom makes so much."""


@dataclass(frozen=True)
class Runout:
    """Of an axis; peak to peak, as a dial gauge has it."""

    radial: Wander
    """m, of its point in the plane across it."""
    axial: Wander
    """m, along it."""
    wobble: Wander
    """rad, of its direction."""


def runout(theta: Array, point: Array, direction: Array, axis: Array) -> Runout | None:
    """Of N poses at the turns ``theta`` (N,), rad, that put a point and the direction of the body's axis at ``point``
    (N, 3), m, and ``direction`` (N, 3) in the world, where the ``axis`` (3,) stands, both unit. None of too few."""
    if len(theta) <= 4 * ORDER + 2:
        return None
    across = orthonormal_complement(axis) @ [1, 1j]
    turns, one = theta[:, None] * np.arange(1, ORDER + 1), np.ones((len(theta), 1))
    line = np.concatenate([one, np.exp(1j * turns[:, :1])], axis=1)
    plane = np.concatenate([one, np.exp(1j * turns), np.exp(-1j * turns)], axis=1)
    along = np.concatenate([one, np.cos(turns), np.sin(turns)], axis=1)
    shown = np.argsort(theta)[np.linspace(0, len(theta) - 1, min(len(theta), PLACES)).astype(int)]
    return Runout(
        _wander(plane, line, point @ across, shown),
        _wander(along, one, point @ axis, shown),
        _wander(plane, line, direction @ across, shown),
    )


def _wander(every: Array, own: Array, values: Array, shown: np.ndarray) -> Wander:
    """Of ``values`` (N,), real or complex, what the columns ``every`` (N, K) explain beyond the ``own`` (N, L), between
    the poses ``shown``."""
    Q, Q_own = (np.linalg.svd(A, full_matrices=False)[0] for A in (every, own))
    whole = Q @ (Q.conj().T @ values)
    way = whole - Q_own @ (Q_own.conj().T @ values)
    parts = 2 if np.iscomplexobj(values) else 1
    more, dof = parts * (Q.shape[1] - Q_own.shape[1]), parts * (len(values) - Q.shape[1])
    variance = max(float((np.abs(values - whole) ** 2).sum()) / dof, np.finfo(float).tiny)
    apart = np.abs(way[shown, None] - way[shown])
    i, j = (shown[k] for k in np.unravel_index(np.argmax(apart), apart.shape))
    leverage = (np.abs(Q[i] - Q[j]) ** 2).sum() - (np.abs(Q_own[i] - Q_own[j]) ** 2).sum()
    F = float((np.abs(way) ** 2).sum()) / more / variance
    return Wander(float(apart.max()), float(np.sqrt(max(leverage, 0.0) * variance)), f_tail(more, dof, F) < CHANCE)
