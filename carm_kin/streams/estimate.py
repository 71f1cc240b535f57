"""The calibration of what has been captured so far, from a bounded number of poses."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carm_kin.calibrated.rotation_centre import RotationCentre
from carm_kin.calibration.calibrate import MIN_PLACEMENT, calibrate
from carm_kin.recording.recording import Recording
from carm_kin.results.result import CalibrationResult
from carm_kin.results.shown import NOT_DETERMINED, length_determined
from carm_kin.streams.live import Pose
from solvers.se3 import Array

OF_NOISE = ("noise", "correlation")
"""Parts of the ± that more poses make less."""


@dataclass(frozen=True, eq=False)
class Current:
    """The offset and how well it is known, with what the axes have swept."""

    poses: int
    """From which it follows."""
    refusal: str
    """Why there is no number; "" where there is one."""
    offset_m: Array | None = None
    """(3,)."""
    sigma_m: Array | None = None
    """(3,) one standard deviation."""
    worst_sigma_m: float | None = None
    """The same in the direction in which it is greatest."""
    swept_rad: tuple[tuple[float, float], tuple[float, float]] | None = None
    """First and last angle of the arcs that the angular and the orbital joint have swept."""
    centre: RotationCentre | None = None
    """The calibration in use at the placement of the last pose, where it found the C to bend."""


def current(poses: Sequence[Pose], of: int) -> Current:
    """The calibration from some ``poses``, evenly spread over ``of`` poses.

    It is that of the default solver, which starts at the closed form. The standard deviations are those that as many
    poses of the same noise give: of those of ``poses`` what is noise, times the root of the ratio of the numbers.
    Systematic effects are not taken away by more poses.
    """
    counts = Counter(pose.marks.placement for pose in poses)
    kept = [pose for pose in poses if counts[pose.marks.placement] >= MIN_PLACEMENT]
    if not kept:
        return Current(len(poses), "too few poses")
    marks = kept[-1].marks
    result = calibrate(_recording(kept), angular=marks.angular, orbital=marks.orbital)
    if result.refusal or result.covariance is None:
        return Current(len(kept), result.refusal.message if result.refusal else "no covariance")
    fewer = _of_all(result, len(kept) / max(of, len(kept)))
    worst = float(np.sqrt(np.linalg.eigvalsh(result.covariance.block("offset"))[-1]))
    if not length_determined(worst):
        return Current(len(kept), f"the offset is {NOT_DETERMINED}")
    sigma = result.sigma.offset_sensor_pivot_m
    return Current(
        len(kept),
        "",
        result.offset_sensor_pivot_m,
        None if sigma is None else sigma * fewer,
        worst * float(fewer.max()),
        _swept(result),
        RotationCentre(result, str(marks.placement)) if result.deformation else None,
    )


def _of_all(result: CalibrationResult, share: float) -> Array:
    """(3,) by how much the offset's standard deviations are less, the poses being a ``share`` of all."""
    square = {part.cause: part.offset_sensor_pivot_m**2 for part in result.sigma_parts}
    if not square:
        return np.full(3, np.sqrt(share))
    noise = sum((square[name] for name in OF_NOISE if name in square), np.zeros(3))
    return np.sqrt(1 - (1 - share) * noise / sum(square.values(), np.zeros(3)))


def _recording(poses: Sequence[Pose]) -> Recording:
    T = np.stack([pose.T for pose in poses])
    sweep, moving, placement, *held = zip(*(pose.marks.cells for pose in poses), strict=True)
    marks = poses[-1].marks
    joints = {
        joint: np.radians([float(cell) if cell else np.nan for cell in cells])
        for joint, cells in zip((marks.angular, marks.orbital), held, strict=True)
    }
    return Recording(
        T[:, :3, 3],
        T[:, :3, :3],
        sweep=np.array(sweep, dtype=object),
        moving=np.array(moving, dtype=object),
        placement=np.array(placement, dtype=object),
        joints=joints,
    )


def _swept(result: CalibrationResult) -> tuple[tuple[float, float], tuple[float, float]] | None:
    if result.angles_rad is None:
        return None
    angles = result.angles_rad[np.isfinite(result.angles_rad).all(axis=1)]
    return arc(angles[:, 0]), arc(angles[:, 1])


def arc(angles: Array) -> tuple[float, float]:
    """First and last angle, rad, of the shortest arc that holds all ``angles`` (N,), N >= 1."""
    turn = np.sort(np.mod(angles, 2 * np.pi))
    gap = np.diff(turn, append=turn[0] + 2 * np.pi)
    first = turn[(int(np.argmax(gap)) + 1) % len(turn)]
    length = 2 * np.pi - float(gap.max())
    first = float(np.angle(np.exp(1j * first)))
    return first, first + length
