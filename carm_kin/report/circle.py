"""Angles on a circle, cut where there are none."""

import numpy as np

from solvers.se3 import Array

WHOLE_RAD = float(np.radians(330))
"""Angles that span more count as a whole turn."""


def span(angle: Array) -> tuple[float, float]:
    """The shortest range (low, high), rad, that holds all the angles (N,), wrapped or not; low lies in -pi..pi.

    A whole turn is -pi..pi.
    """
    wrapped = np.sort(np.angle(np.exp(1j * angle)))
    gaps = np.diff(np.append(wrapped, wrapped[0] + 2 * np.pi))
    widest = int(np.argmax(gaps))
    if 2 * np.pi - gaps[widest] > WHOLE_RAD:
        return -np.pi, np.pi
    low = float(wrapped[(widest + 1) % len(wrapped)])
    return low, low + float(2 * np.pi - gaps[widest])


def cut(angle: Array, low: float, high: float) -> Array:
    """The angles (N,) shifted by whole turns into the turn about the middle of low..high."""
    middle = (low + high) / 2
    return middle + np.angle(np.exp(1j * (angle - middle)))
