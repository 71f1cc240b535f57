"""What the digits of a joint's values say of their precision."""

import numpy as np

from solvers.se3 import Array

DIGITS = {"deg": (0, 6, 180 / np.pi), "rad": (2, 8, 1.0), "mm": (0, 6, 1e3)}
"""Unit -> the fewest and the most digits after the point that count, and the unit in rad or m."""
ROUNDING = 1e-5
"""How far a value may be off a multiple of the step, in steps."""


def written_step(values: Array, prismatic: bool = False) -> float:
    """The step, rad or m, of the last digit with which known ``values`` (N,), rad or m, seem to be written.

    The largest of 1, 0.1, ... 1e-6 deg (or mm), and of 0.01 to 1e-8 rad, of which all are multiples: of whole degrees
    1 deg. The smallest where there is none. NaN without known values.
    """
    known = np.unique(values[np.isfinite(values)])
    if not known.size:
        return float("nan")
    return max(_step(known, unit) for unit in (("mm",) if prismatic else ("deg", "rad")))


def _step(values: Array, unit: str) -> float:
    fewest, most, scale = DIGITS[unit]
    for digits in range(fewest, most):
        shown = values * scale * 10**digits
        if (np.abs(shown - np.round(shown)) <= ROUNDING).all():
            return 10.0**-digits / scale
    return 10.0**-most / scale
