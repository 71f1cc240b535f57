"""Poses that repeat the one before them: a tracker that freezes fakes precision with them."""

import numpy as np

from solvers.se3 import Array

REASON = "identical to the pose before"
"""What the list of outliers says of them."""
TOLERANCE = 1e-6
"""Poses are identical up to this, m and entries of the rotation matrix: rounding to single precision."""


def repeated(p_world_sensor: Array, R_world_sensor: Array | None) -> np.ndarray:
    """(N,) mask of the poses that equal the one before them, of positions (N, 3), m, and orientations (N, 3, 3).

    Of a frozen stretch the first pose stays, whatever the times and labels of the others. No tracker with noise
    measures the same pose twice, so they are no measurements. Where only positions were recorded, these decide.
    """
    again = np.zeros(len(p_world_sensor), dtype=bool)
    again[1:] = (np.abs(np.diff(p_world_sensor, axis=0)) <= TOLERANCE).all(axis=1)
    if R_world_sensor is not None:
        again[1:] &= (np.abs(np.diff(R_world_sensor, axis=0)) <= TOLERANCE).all(axis=(1, 2))
    return again
