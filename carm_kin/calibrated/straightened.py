"""A new recording of a C that bends, as a rigid one would have made it: what a saved calibration is compared with."""

from dataclasses import dataclass, replace

import numpy as np

from carm_kin.calibrated.margin import SIGMAS
from carm_kin.recording.recording import Recording
from carm_kin.results.deformation import Deformation
from carm_kin.results.result import CalibrationResult
from solvers.estimate import Covariance, Note
from solvers.problem import Problem
from solvers.se3 import Array, rot_x
from solvers.torus import Torus

SAME_PLACE_M, SAME_AXIS_RAD = 5e-3, float(np.radians(0.5))
"""Within these of a calibrated placement the base stands where it stood."""


@dataclass(frozen=True, eq=False)
class Straightened:
    """Poses less what the saved calibration says of the C's deformation; as they are where it says nothing."""

    recording: Recording
    covariance: Covariance | None
    """Of the saved calibration, its offset as uncertain as at these poses."""
    bending_m: float = 0.0
    """One standard deviation of what less is known of the deformation at them than within the calibrated angles."""
    extrapolated: int = 0
    """Used poses outside of the angles over which the deformation was calibrated."""
    notes: tuple[Note, ...] = ()


def straightened(
    result: CalibrationResult, saved: Torus, recording: Recording, used: np.ndarray, angles: Array | None
) -> Straightened:
    """The ``recording`` at ``angles`` (N, 2), rad, as the chain ``saved`` counts them; None where they are not known.

    ``used`` (N,) are the poses that count.
    """
    bent = result.deformation
    if bent is None:
        return Straightened(recording, result.covariance)
    if angles is None:
        return _bent_somehow(result.covariance, bent, recording)
    T = bent.unbent(recording.T_world_sensor, saved.T_sensor_carm, *angles.T)
    here = (bent.sigma_m(*angles[used].T) ** 2).mean(axis=0)
    rigid = 0.0 if result.covariance is None else np.diagonal(result.covariance.block("offset_sensor_pivot"))
    outside = int(bent.extrapolated(*angles[used].T).sum())
    return Straightened(
        replace(recording, p_world_sensor=T[:, :3, 3], R_world_sensor=T[:, :3, :3]),
        _widened(result.covariance, np.maximum(here - rigid, 0.0)),
        float(np.sqrt(np.maximum(here - bent.variance_within, 0.0).sum())),
        outside,
        _outside(outside, int(used.sum()), bent) if outside else (),
    )


def angles_as_saved(saved: Torus, new: Torus, problem: Problem) -> Array | None:
    """(N, 2) alpha and beta, rad, of the poses of a ``new`` calibration, as the ``saved`` one counts them.

    Beta follows from the mount. The zero of alpha is told by labels in both recordings, or by a base that stands where
    it stood; None where neither does.
    """
    if saved.referenced.all() and new.referenced.all():
        alike = new.orbital_axis @ saved.orbital_axis > 0
        T = new.T_world_torus if alike else new.T_world_torus @ _half_turn()
    else:
        found = [_where_it_stood(saved.T_world_torus, T) for T in new.T_world_torus]
        if any(T is None for T in found):
            return None
        T = np.array(found)
    return replace(saved, T_world_torus=T).angles(problem)


def _where_it_stood(T_saved: Array, T_new: Array) -> Array | None:
    """The one of P placements (P, 4, 4) that is the new one (4, 4), but for the zero and the sense of alpha."""
    for T in T_saved:
        lean = np.arcsin(min(float(np.linalg.norm(np.cross(T[:3, 0], T_new[:3, 0]))), 1.0))
        if lean < SAME_AXIS_RAD and np.linalg.norm(T[:3, 3] - T_new[:3, 3]) < SAME_PLACE_M:
            return T
    return None


def _half_turn() -> Array:
    T = np.eye(4)
    T[:3, :3] = rot_x(np.pi)
    return T


def _bent_somehow(covariance: Covariance | None, bent: Deformation, recording: Recording) -> Straightened:
    """Where the angles are not known, the size of the deformation, rms, counts as `SIGMAS` standard deviations."""
    note = Note(
        "deformation_not_applied",
        "nothing tells at which of the calibrated angles these poses were taken, so that the deformation of the C, by "
        f"which the rotation centre walks {bent.walk_m * 1e3:.2g} mm, is not applied but allowed for in the ±: label "
        "the angular joint in both recordings, or leave base and tracker where they were",
    )
    square = np.mean([node.shift_sensor_pivot_m**2 for node in bent.nodes], axis=0) / SIGMAS**2
    return Straightened(recording, _widened(covariance, square), float(np.sqrt(square.sum())), notes=(note,))


def _widened(covariance: Covariance | None, variance: Array) -> Covariance | None:
    """With so much more variance (3,) of the offset, m²."""
    if covariance is None:
        return None
    rows = [covariance.names.index(f"offset_sensor_pivot_{axis}") for axis in "xyz"]
    matrix = covariance.matrix.copy()
    matrix[rows, rows] += variance
    return replace(covariance, matrix=matrix)


def _outside(count: int, of: int, bent: Deformation) -> tuple[Note, ...]:
    return (
        Note(
            "extrapolated",
            f"{count} of {of} poses lie outside of the angles over which the deformation of the C was calibrated "
            f"({bent.ranges}): there it is extrapolated, and its ± grows",
        ),
    )
