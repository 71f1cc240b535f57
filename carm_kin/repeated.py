"""Poses that repeat the one before them: a tracker that freezes fakes precision with them."""

import numpy as np

from carm_kin.recording import Recording

REASON = "identical to the pose before"
"""What the list of outliers says of them."""


def repeated(recording: Recording) -> np.ndarray:
    """(N,) mask of the poses that equal the one before them in every digit.

    Of a frozen stretch the first pose stays. No tracker with noise measures the same pose twice, so the
    others are no measurements. Where only positions were recorded, these decide.
    """
    again = np.zeros(len(recording), dtype=bool)
    again[1:] = (np.diff(recording.p_world_sensor, axis=0) == 0).all(axis=1)
    if recording.R_world_sensor is not None:
        again[1:] &= (np.diff(recording.R_world_sensor, axis=0) == 0).all(axis=(1, 2))
    return again
