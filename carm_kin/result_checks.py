"""What in a result that was read from a file cannot be."""

from typing import TYPE_CHECKING

import numpy as np

from solvers.se3 import Array

if TYPE_CHECKING:
    from carm_kin.result import CalibrationResult

TOLERANCE = 1e-6
"""How far the axes and rotations of a file may be from unit length and orthonormality."""


def contradiction(result: "CalibrationResult", interval_m: tuple[float, ...] | None) -> str | None:
    """What in a result that was read cannot be, in words; ``interval_m`` is the interval of |R| that stood with it."""
    unit = [result.orbital_axis_sensor, *(placement.angular_axis_world for placement in result.placements)]
    rigid = [result.T_sensor_carm, *(placement.T_world_torus for placement in result.placements)]
    lengths = [result.major_radius_m, result.minor_radius_m, result.sigma.major_radius_m, result.sigma.minor_radius_m]
    refused = result.refusal is not None
    numbers = [result.offset_sensor_pivot_m, result.axis_non_orthogonality_rad, result.covariance, *unit, *rigid]
    numbers += lengths
    checks = {
        "status must be 'ok' without a refusal or 'refused' with one": result.status
        != ("refused" if refused else "ok"),
        "a refused result must hold no numbers": refused and any(x is not None for x in numbers),
        "an axis is no unit vector": any(x is not None and abs(x @ x - 1) > TOLERANCE for x in unit),
        "a transform is no rigid motion": any(x is not None and not _is_rigid(x) for x in rigid),
        "a length is below 0": any(x is not None and x < 0 for x in lengths),
        "the interval of the major radius is not the one that follows from its sigma": not _same_interval(
            result.major_radius_interval_95_m, interval_m
        ),
        "the numbers of poses, used poses and outliers contradict each other": not (
            0 <= result.used <= result.poses and result.outliers.count == len(result.outliers.indices)
        ),
        "the reasons of the outliers name other poses or count them wrong": not _counted(result),
        "the covariance is not symmetric": result.covariance is not None
        and not np.allclose(result.covariance.matrix, result.covariance.matrix.T, rtol=TOLERANCE),
    }
    return next((words for words, wrong in checks.items() if wrong), None)


def _counted(result: "CalibrationResult") -> bool:
    """Whether the reasons divide some of the outliers among them."""
    reasons = result.outliers.reasons
    named = [pose for reason in reasons for pose in reason.indices]
    once = len(set(named)) == len(named) and set(named) <= set(result.outliers.indices)
    return once and all(reason.count == len(reason.indices) for reason in reasons)


def _same_interval(expected: tuple[float, float] | None, stated: tuple[float, ...] | None) -> bool:
    if expected is None or stated is None or len(stated) != 2:
        return expected is stated is None
    return bool(np.allclose(stated, expected, rtol=0.0, atol=TOLERANCE * expected[1]))


def _is_rigid(T: Array) -> bool:
    R = T[:3, :3]
    orthonormal = np.abs(R.T @ R - np.eye(3)).max() < TOLERANCE and np.linalg.det(R) > 0
    return bool(orthonormal and (T[3] == (0, 0, 0, 1)).all())
