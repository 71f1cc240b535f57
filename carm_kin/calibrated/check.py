"""Does a saved calibration still hold? A new short recording passes it or fails it.

Two questions are asked. With the saved machine and sensor mount held fixed and the torus placed anew (the base
may stand elsewhere), do the new poses fit? And does a free fit of the new recording give the same offset, orbital
axis, major radius and non-orthogonality, beyond the tolerance and three standard deviations of both fits? Both
angles of a pose are unknown in the first, so that it depends on no label. Where the saved calibration found the C to
bend, its poses are first put where a rigid one would have them, and its ± there counts.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from carm_kin.calibrated.check_one_axis import check_of_one_axis
from carm_kin.calibrated.margin import SIGMAS, against, worst
from carm_kin.calibrated.straightened import Straightened, angles_as_saved, straightened
from carm_kin.calibration.calibrate import calibrate
from carm_kin.calibration.cross_validate import placed, torus_of
from carm_kin.calibration.known_length import in_scale_of
from carm_kin.calibration.problem import to_problem
from carm_kin.errors import InputError
from carm_kin.recording.formats import RecordingLike, as_recording
from carm_kin.recording.recording import Recording
from carm_kin.results.check_result import Angle, Check, Length
from carm_kin.results.provenance import provenance_of
from carm_kin.results.result import CalibrationResult, ResultLike, as_result
from carm_kin.results.shown import angle_determined, length_determined
from solvers.estimate import Note
from solvers.kinematic import fit_angles
from solvers.likelihood.covariance import active_unknowns, marginal_covariance
from solvers.likelihood.linearise import MOUNT_ROLL
from solvers.likelihood.placing import Fit, place
from solvers.problem import Problem
from solvers.torus import SENSE_RADIUS_M, Torus

ONE_AXIS = ("one_axis_only", "unobservable")
"""Refusals of a recording in which one axis turned at most."""
MACHINE = 7
"""Unknowns of the machine and the mount that the saved calibration holds fixed."""
UNSEEN_SLIP = (
    "a slip of the sensor about the orbital axis: it changes neither the offset nor the axes, and looks like another "
    "orbital angle unless both recordings hold labels of that joint"
)


def check(
    result: ResultLike,
    recording: RecordingLike,
    *,
    tolerance_m: float = 1e-3,
    tolerance_rad: float = float(np.radians(0.5)),
    angular: str = "angular",
    orbital: str = "orbital",
    sigma_t_m: float | None = None,
    sigma_r_rad: float | None = None,
    sigma_label_rad: float | None = None,
    command: str | None = None,
) -> Check:
    """Apply a saved calibration to a new recording of the same C-arm and sensor; both may be paths.

    The recording needs motion about both axes and enough poses. Where one axis turned alone, what it tells is compared
    and may fail; it passes nothing, and ``unseen`` names what it could not show. Where three standard deviations of the
    offset's or the axis' change exceed the tolerance, it could not show what it is asked for and is refused. Labels are
    used where there are any; ``sigma_label_rad`` is their standard deviation, 0 for exact ones, by default that of
    rounding to their last digit. ``sigma_t_m`` and ``sigma_r_rad`` give the tracker's noise.

    Raises InputError for a result that is refused or without a complete chain, a tolerance that is not above 0,
    and a recording that cannot be calibrated.
    """
    for name, value in (("tolerance_m", tolerance_m), ("tolerance_rad", tolerance_rad)):
        if not 0 < value < np.inf:
            raise InputError(f"{name} must be a finite number above 0, not {value}")
    result = as_result(result)
    recording = in_scale_of(result, as_recording(recording))
    saved = torus_of(result, tuple(placement.label for placement in result.placements))
    again = partial(
        calibrate,
        solver="kinematic",
        angular=angular,
        orbital=orbital,
        sigma_t_m=sigma_t_m,
        sigma_r_rad=sigma_r_rad,
        sigma_label_rad=sigma_label_rad,
        fix_non_orthogonality=saved.non_orthogonality == 0,
    )
    new = again(recording)
    blank = Check(
        "refused",
        tolerance_m,
        tolerance_rad,
        new.poses,
        new.used,
        warnings=new.warnings,
        provenance=provenance_of(recording, command, None),
    )
    if new.refusal and new.refusal.code in ONE_AXIS:
        blank = replace(blank, refusal=_advised(new.refusal))
        return _judged(check_of_one_axis(blank, result, saved, recording, (sigma_t_m, sigma_r_rad)))
    if new.refusal:
        return replace(blank, refusal=_advised(new.refusal))
    recording = recording.select(placed(recording, new))
    posed = partial(to_problem, angular=angular, orbital=orbital, sigma_label_rad=sigma_label_rad)
    angles = angles_as_saved(saved, torus_of(new, recording.placements), posed(recording))
    straight = straightened(result, saved, recording, _used(recording, new), angles)
    if straight.recording is not recording:
        new = again(straight.recording)
    blank = replace(blank, used=new.used, extrapolated=straight.extrapolated, warnings=(*new.warnings, *straight.notes))
    if new.refusal:
        return replace(blank, refusal=_advised(new.refusal))
    problem = posed(straight.recording).select(_used(recording, new))
    return _judged(_compared(blank, result, saved, new, torus_of(new, recording.placements), problem, straight))


def _used(recording: Recording, new: CalibrationResult) -> np.ndarray:
    """(N,) mask of the poses that agree with one C-arm."""
    return ~np.isin(recording.pose_number, new.outliers.indices)


def _advised(refusal: Note) -> Note:
    if refusal.code in ("one_axis_only", "unobservable", "too_few_poses", "too_uncertain"):
        message = f"{refusal.message}; a check needs motion about both axes, as in a short calibration"
        return Note(refusal.code, message)
    return refusal


def _compared(
    blank: Check,
    result: CalibrationResult,
    saved: Torus,
    new: CalibrationResult,
    torus: Torus,
    problem: Problem,
    straight: Straightened,
) -> Check:
    """The differences of the two calibrations; ``problem`` holds the used poses."""
    sign = 1.0 if _same_zero(saved, torus) or torus.orbital_axis @ saved.orbital_axis > 0 else -1.0
    axis, moved = sign * torus.orbital_axis, torus.offset - saved.offset
    turned = np.cross(saved.orbital_axis, axis)
    both = [c for c in (straight.covariance, new.covariance) if c is not None]
    noise = (new.noise.translation_m or 0.0, new.noise.rotation_rad or 0.0)
    fixed, free = place(problem, saved, torus, noise), place(problem, torus, torus, noise)
    mm, deg = blank.tolerance_m, blank.tolerance_rad
    moved_by, noise_of_it = _excess(fixed, free, 0)
    found = replace(
        blank,
        offset=Length(*against(mm, float(np.linalg.norm(moved)), worst(both, "offset_sensor_pivot"))),
        orbital_axis=Angle(
            *against(
                deg,
                float(np.arctan2(np.linalg.norm(turned), saved.orbital_axis @ axis)),
                worst(both, "orbital_axis_sensor"),
            )
        ),
        orbital_zero=Angle(*against(deg, *_turn(saved, torus, problem))) if _same_zero(saved, torus) else None,
        major_radius=Length(
            *against(mm, abs(abs(torus.major_radius) - abs(saved.major_radius)), worst(both, "major_radius"))
        ),
        non_orthogonality=Angle(*against(deg, _skewness(saved, torus), worst(both, "axis_non_orthogonality"))),
        pose_position=Length(*against(mm, moved_by, float(np.hypot(noise_of_it, straight.bending_m)))),
        pose_rotation=Angle(*against(deg, *_excess(fixed, free, 1))),
        unseen=() if _same_zero(saved, torus) else (UNSEEN_SLIP,),
        warnings=(*blank.warnings, *taken_as_exact(result)),
    )
    return _without_undetermined(found)


def _without_undetermined(found: Check) -> Check:
    """What is not determined is no number but named among what is not seen."""
    radius, skew = found.major_radius, found.non_orthogonality
    unseen = found.unseen
    if radius and not length_determined(radius.sigma_m):
        found, unseen = replace(found, major_radius=None), (*unseen, "a change of the major radius: not determined")
    if skew and not angle_determined(skew.sigma_rad):
        words = "a change of the non-orthogonality: not determined"
        found, unseen = replace(found, non_orthogonality=None), (*unseen, words)
    return replace(found, unseen=unseen)


def _same_zero(saved: Torus, torus: Torus) -> bool:
    return saved.orbital_referenced and torus.orbital_referenced


def taken_as_exact(result: CalibrationResult) -> tuple[Note, ...]:
    """A warning where the saved calibration has no uncertainty."""
    if result.covariance:
        return ()
    message = f"the saved calibration by '{result.solver}' gives no uncertainty: it is taken as exact"
    return (Note("no_saved_covariance", message),)


def _turn(saved: Torus, torus: Torus, problem: Problem) -> tuple[float, float]:
    """Turn of the carm frame about the orbital axis, rad, and its sigma, taken as equal in both recordings."""
    R = saved.T_sensor_carm[:3, :3].T @ torus.T_sensor_carm[:3, :3]
    at = fit_angles(problem, torus)[1]
    active = active_unknowns(problem, fix_non_orthogonality=torus.non_orthogonality == 0)
    variance = marginal_covariance(at.H, active)[MOUNT_ROLL - 6, MOUNT_ROLL - 6]
    return float(abs(np.arctan2(R[0, 2] - R[2, 0], R[0, 0] + R[2, 2]))), float(np.sqrt(2 * max(variance, 0.0)))


def _skewness(saved: Torus, torus: Torus) -> float:
    """Difference of the two non-orthogonalities, rad, whose sign is that of R's by convention."""
    a, b = saved.non_orthogonality, torus.non_orthogonality
    if min(abs(saved.major_radius), abs(torus.major_radius)) < SENSE_RADIUS_M:
        return min(abs(a - b), abs(a + b))
    return abs(a - b) if saved.major_radius * torus.major_radius > 0 else abs(a + b)


def _excess(fixed: Fit, free: Fit, kind: int) -> tuple[float, float]:
    """Rms error a pose of the saved machine beyond that of the new one, and what the noise alone makes of it."""
    square = max(fixed.mean_square(kind) - free.mean_square(kind), 0.0)
    sigma = fixed.sigma[kind] * np.sqrt(MACHINE / fixed.residual.shape[1])
    return float(np.sqrt(square)), float(sigma)


def _judged(found: Check) -> Check:
    """Passed, failed, or refused where the recording could not show a change of the size of the tolerance, or a change
    of everything."""
    compared = {
        "the offset differs": found.offset,
        "the orbital axis in the sensor differs": found.orbital_axis,
        "the sensor has turned about the orbital axis": found.orbital_zero,
        "the major radius differs": found.major_radius,
        "the non-orthogonality differs": found.non_orthogonality,
        "the positions miss the saved calibration": found.pose_position,
        "the orientations miss the saved calibration": found.pose_rotation,
    }
    failures = tuple(f"{words} by {_in_words(c)}" for words, c in compared.items() if c and not c.within)
    if failures:
        return replace(found, status="failed", failures=failures, refusal=None)
    if found.refusal:
        return found
    if (refusal := _blind(found)) is not None:
        return replace(found, refusal=refusal)
    return replace(found, status="passed")


def _blind(found: Check) -> Note | None:
    """A refusal where the offset or the orbital axis is less certain than the tolerance."""
    offset, axis, end = found.offset, found.orbital_axis, "record more poses on longer arcs, or allow more"
    start = "the two recordings together tell a change of the"
    if offset and SIGMAS * offset.sigma_m > found.tolerance_m:
        so_far = f"{SIGMAS * offset.sigma_m * 1e3:.2g} mm, the tolerance is {found.tolerance_m * 1e3:.3g} mm"
        return Note("too_uncertain", f"{start} offset only to {so_far}: {end}")
    if axis and SIGMAS * axis.sigma_rad > found.tolerance_rad:
        so_far = f"{np.degrees(SIGMAS * axis.sigma_rad):.2g} deg, the tolerance is "
        return Note(
            "too_uncertain", f"{start} orbital axis only to {so_far}{np.degrees(found.tolerance_rad):.3g} deg: {end}"
        )
    return None


def _in_words(change: Length | Angle) -> str:
    if isinstance(change, Length):
        return f"{change.difference_m * 1e3:.2f} mm, more than {change.limit_m * 1e3:.2f} mm"
    return f"{np.degrees(change.difference_rad):.2f} deg, more than {np.degrees(change.limit_rad):.2f} deg"
