"""A saved calibration on a recording in which one axis turned, or none: what can be seen of a change, and what not.

One axis that turns tells a line of the sensor's frame, that axis itself. Where it is the orbital one, the saved offset
must lie on it and the saved orbital axis along it; where it is the angular one, it must enclose the saved angle with
the saved orbital axis and pass it at the distance of the saved major radius.
"""

from dataclasses import replace

import numpy as np

from carm_kin.calibrated.margin import against, worst
from carm_kin.calibrated.straightened import straightened
from carm_kin.calibration.calibrate import calibrate
from carm_kin.recording.recording import Recording
from carm_kin.results.check_result import Angle, Check, Length
from carm_kin.results.parts import ToldOffset
from carm_kin.results.result import CalibrationResult
from solvers.estimate import Covariance, Note
from solvers.se3 import Array
from solvers.torus import Torus

ORBITAL_COSINE = float(np.cos(np.radians(45.0)))
"""The axis that turned is the orbital one if it is nearer to it than this; the angular one is across it."""
LEAST_SINE = 0.5
"""Axes that enclose less have no distance worth comparing."""
EVERYTHING = ("any change of the offset, the axes, the major radius and the non-orthogonality: nothing turned",)
BESIDE_ORBITAL = (
    "a change of the offset along the orbital axis, of the major radius, of the non-orthogonality, and a slip of the "
    "sensor about the orbital axis: the angular axis did not turn",
)
BESIDE_ANGULAR = (
    "a change of the offset or of the orbital axis that leaves the angular axis where it is in the sensor: the orbital "
    "axis did not turn",
)


def check_of_one_axis(
    blank: Check,
    result: CalibrationResult,
    saved: Torus,
    recording: Recording,
    noise: tuple[float | None, float | None],
) -> Check:
    """The ``blank``, refused check with what the axis that turned is compared with, and what is not seen.

    ``noise`` is that of the recording's poses (m, rad), None where it is not known.
    """
    point = calibrate(recording, locus="point", sigma_t_m=noise[0], sigma_r_rad=noise[1])
    if point.told is None or len(point.told.untold_directions_sensor) != 1:
        return replace(blank, unseen=EVERYTHING)
    bent = straightened(result, saved, recording, np.ones(len(recording), dtype=bool), None)
    blank = replace(blank, used=point.used, warnings=(*blank.warnings, *bent.notes))
    of_saved = [] if bent.covariance is None else [bent.covariance]
    if abs(point.told.untold_directions_sensor[0] @ saved.orbital_axis) > ORBITAL_COSINE:
        return _orbital(blank, saved, point.told, of_saved)
    return _angular(blank, saved, point.told, of_saved)


def _orbital(blank: Check, saved: Torus, line: ToldOffset, of_saved: list[Covariance]) -> Check:
    axis = line.untold_directions_sensor[0]
    off = saved.offset - line.nearest_sensor_m
    across = off - axis * (axis @ off)
    apart, sigma_t = float(np.linalg.norm(across)), max(one.sigma_m for one in line.told)
    return replace(
        _alone(blank, "orbital"),
        offset=Length(*_both(blank.tolerance_m, apart, sigma_t, of_saved, "offset_sensor_pivot")),
        orbital_axis=Angle(
            *_both(
                blank.tolerance_rad,
                float(np.arcsin(min(np.linalg.norm(np.cross(axis, saved.orbital_axis)), 1.0))),
                line.untold_sigma_rad[0],
                of_saved,
                "orbital_axis_sensor",
            )
        ),
        unseen=BESIDE_ORBITAL,
    )


def _angular(blank: Check, saved: Torus, line: ToldOffset, of_saved: list[Covariance]) -> Check:
    axis, y = line.untold_directions_sensor[0], saved.orbital_axis
    lean, sigma_t = line.untold_sigma_rad[0], max(one.sigma_m for one in line.told)
    skew = abs(float(np.arcsin(min(abs(axis @ y), 1.0))) - abs(saved.non_orthogonality))
    found = replace(
        _alone(blank, "angular"),
        non_orthogonality=Angle(*_both(blank.tolerance_rad, skew, lean, of_saved, "axis_non_orthogonality")),
        unseen=BESIDE_ANGULAR,
    )
    normal: Array = np.cross(axis, y)
    if np.linalg.norm(normal) < LEAST_SINE:
        return found
    apart = abs(float((line.nearest_sensor_m - saved.offset) @ normal)) / float(np.linalg.norm(normal))
    change = abs(apart - abs(saved.major_radius))
    return replace(found, major_radius=Length(*_both(blank.tolerance_m, change, sigma_t, of_saved, "major_radius")))


def _alone(blank: Check, joint: str) -> Check:
    """Refused in the words of the saved calibration, which knows the axes' names."""
    assert blank.refusal is not None
    words = (
        f"the {joint} axis turned alone: what it tells agrees with the saved calibration, the rest is open; a check "
        "needs motion about both axes, as in a short calibration"
    )
    return replace(blank, refusal=Note(blank.refusal.code, words))


def _both(
    tolerance: float, difference: float, sigma: float, of_saved: list[Covariance], name: str
) -> tuple[float, float, float, bool]:
    return against(tolerance, difference, float(np.hypot(sigma, worst(of_saved, name))))
