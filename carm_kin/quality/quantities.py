"""What a trend follows, and how it is read from the calibrations."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carm_kin.quality.control_chart import Values
from carm_kin.results.result import CalibrationResult
from solvers.se3 import Array

OFFSET_CHANGE = "change of the offset"
OFFSET_COMPONENTS = tuple(f"offset, {axis}" for axis in "xyz")
MAJOR_RADIUS, MINOR_RADIUS, NON_ORTHOGONALITY = "major radius", "minor radius", "non-orthogonality"


@dataclass(frozen=True)
class Kind:
    """A length or an angle."""

    suffix: str
    """Of its fields: ``_m`` or ``_rad``."""
    unit: str
    """For a person."""
    scale: float
    """From metres or radians to this unit."""
    least_fail: float
    """A change that is no failure, where no tolerance is given."""


LENGTH = Kind("_m", "mm", 1e3, 1e-3)
ANGLE = Kind("_rad", "deg", float(np.degrees(1.0)), float(np.radians(0.5)))


def offsets(results: Sequence[CalibrationResult], n: int) -> Values:
    """The offsets (N, 3), the first n of them the baseline."""
    values = np.array([result.offset_sensor_pivot_m for result in results], dtype=float)
    return Values(values, np.array([_offset_covariance(result) for result in results]), n)


def scalars(results: Sequence[CalibrationResult], n: int) -> dict[str, tuple[Kind, Values]]:
    """Quantities of one number: those that every result gives with a deviation."""
    given = {
        MAJOR_RADIUS: (LENGTH, [(one.major_radius_m, one.sigma.major_radius_m) for one in results]),
        MINOR_RADIUS: (LENGTH, [(one.minor_radius_m, one.sigma.minor_radius_m) for one in results]),
        NON_ORTHOGONALITY: (ANGLE, [(_skew(one), one.sigma.axis_non_orthogonality_rad) for one in results]),
    }
    return {
        name: (kind, _values(pairs, n))
        for name, (kind, pairs) in given.items()
        if all(value is not None and sigma for value, sigma in pairs)
    }


def _values(pairs: Sequence[tuple[float | None, float | None]], n: int) -> Values:
    x, sigma = np.array(pairs, dtype=float).T
    return Values(x[:, None], sigma[:, None, None] ** 2, n)


def _offset_covariance(result: CalibrationResult) -> Array:
    if result.covariance is not None and len(block := result.covariance.block("offset")) == 3:
        return block
    assert result.sigma.offset_sensor_pivot_m is not None
    return np.diag(result.sigma.offset_sensor_pivot_m**2)


def _skew(result: CalibrationResult) -> float | None:
    """In the sense of a positive R; None where R is not told from 0, and thus the sense is not."""
    interval, skew = result.major_radius_interval_95_m, result.axis_non_orthogonality_rad
    if interval is None or interval[0] == 0 or skew is None:
        return None
    return skew if (result.major_radius_signed_m or 0.0) >= 0 else -skew
