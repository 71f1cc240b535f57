"""Non-isocentric scans: the point of the C-arm that stands still while lift and horizontal travel move with the orbit.

The rotation centre of a C-arm that is not isocentric, or whose centre is not where the patient is, can be led on a
circle while the C turns, so that another point v of the C-arm frame stands still: at alpha = 0 by the travel
(horizontal, lift) = -(Ry(beta) v)_{x,z} + const. The sensor then still moves on a circle, about that virtual centre.
Where the calibration found the C to bend, the poses are first put where a rigid one would have them.
"""

from dataclasses import replace

import numpy as np

from carm_kin.calibrated.check import taken_as_exact
from carm_kin.calibrated.rotation_centre import chain_at, noise_of
from carm_kin.calibrated.straightened import straightened
from carm_kin.calibration.known_length import in_scale_of
from carm_kin.errors import InputError
from carm_kin.recording.duplicates import NotMeasured
from carm_kin.recording.formats import RecordingLike, as_recording
from carm_kin.recording.recording import Recording
from carm_kin.results.parts import NoiseLevel, Outliers, Rejection
from carm_kin.results.provenance import provenance_of
from carm_kin.results.result import CalibrationResult, ResultLike, as_result
from carm_kin.results.virtual_centre_result import CentreSigma, Spread, VirtualCentre
from carm_kin.steps import step
from solvers.estimate import MEANINGLESS_M, Covariance, Note
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.still_point import StillPoint, still_point
from solvers.torus import Torus
from solvers.verdict.limits import Limits, least_arc, uncertainty
from solvers.verdict.mixed_units import mixed_units

MIN_POSES = 6
PROBABILITY = 1e-6
"""Less probable spreads are not taken for noise."""
LEAST_USED = 0.7
"""Share of the measured poses at which the orbital axis has to stand still: else it moved."""
OUTLIER_SIGMAS = 6.0
"""A pose whose orbital axis is off the others' by more standard deviations, of its own and of the calibrated axis, is
left out."""
BASE_TURNED_RAD = float(np.radians(0.5))
"""The axes may enclose an angle that differs by so much from the calibrated one, or by the noise of a pose."""


@step("find the virtual centre")
def virtual_centre(
    result: ResultLike,
    scan: RecordingLike,
    *,
    placement: str | None = None,
    tolerance_m: float = 1e-3,
    sigma_t_m: float | None = None,
    sigma_r_rad: float | None = None,
    command: str | None = None,
) -> VirtualCentre:
    """The virtual centre of one orbital scan, alpha held, of a calibrated C-arm; both may be paths.

    A centre counts as fixed if the noise explains its spread, or if what the noise leaves is within ``tolerance_m``.
    ``placement`` names the calibrated place of the base, by default that of the scan's own label. The base may have
    travelled since; only where it has not turned are alpha, beta and the travel given. ``sigma_t_m`` and
    ``sigma_r_rad`` are the noise of the scan's poses; by default that of the calibration.

    Raises InputError for a result without a complete chain, an unknown placement, a scan without orientations or with
    several placements, and a tolerance or noise that is not above 0.
    """
    if not 0 < tolerance_m < np.inf:
        raise InputError(f"tolerance_m must be a finite number above 0, not {tolerance_m}")
    result = as_result(result)
    scan = in_scale_of(result, as_recording(scan))
    T = scan.T_world_sensor
    if len(scan.placements) > 1:
        raise InputError(f"a scan is made at one placement of the base, not at {', '.join(scan.placements)}")
    own = [label for label in scan.placements if label in {known.label for known in result.placements}]
    torus = chain_at(result, own[0] if placement is None and own else placement)
    sigma = noise_of(result, sigma_t_m, sigma_r_rad)
    not_measured = NotMeasured.of(scan.p_world_sensor, scan.R_world_sensor)
    again = not_measured.any_of
    off = _axis_off(T[~again], torus)
    astray = np.zeros(len(scan), dtype=bool)
    astray[~again] = off > OUTLIER_SIGMAS * np.hypot(sigma[1], _sigma_of_axis(result.covariance))
    used = ~again & ~astray
    blank = VirtualCentre(
        "refused",
        tolerance_m,
        len(scan),
        int(used.sum()),
        _outliers(scan, {**not_measured.reasons, "the orbital axis stands elsewhere than at the other poses": astray}),
        NoiseLevel(*sigma, estimated=None in (sigma_t_m, sigma_r_rad) and result.noise.estimated),
        (*scan.warnings, *not_measured.notes(), *taken_as_exact(result), *_conventions(result)),
        provenance_of(scan, command, None),
    )
    measured = Problem.of_poses(T[~again, :3, 3], T[~again, :3, :3])
    refusal = mixed_units(measured) or _refusal(used, again, off)
    if refusal is not None:
        return replace(blank, refusal=refusal)
    scan = scan.select(used)
    angles = torus.angles(Problem.of_poses(scan.p_world_sensor, scan.R_world_sensor))
    turned = abs(_base_turn(scan, torus)) > max(BASE_TURNED_RAD, OUTLIER_SIGMAS * sigma[1])
    straight = straightened(result, torus, scan, np.ones(len(scan), dtype=bool), None if turned else angles)
    blank = replace(blank, warnings=(*blank.warnings, *straight.notes))
    found = _found(blank, straight.recording, torus, sigma, straight.covariance)
    return _with_turn_told(found, scan, torus) if turned else _with_angles(found, angles, torus)


def _base_turn(scan: Recording, torus: Torus) -> float:
    """By how much the orbital axis stands off the calibrated angle to the angular axis, rad."""
    y = (scan.T_world_sensor[:, :3, :3] @ torus.orbital_axis).mean(axis=0)
    sine = -(y @ torus.angular_axis[0]) / np.linalg.norm(y)
    return float(np.arcsin(np.clip(sine, -1, 1)) - torus.non_orthogonality)


def _conventions(result: CalibrationResult) -> tuple[Note, ...]:
    """The calibration's warnings of zeros that no label tells: the C-arm frame and the travel depend on them."""
    return tuple(note for note in result.warnings if note.code.endswith("_zero_convention"))


def _axis_off(T: Array, torus: Torus) -> Array:
    """(N,) angles, rad, of the orbital axis at each pose (N, 4, 4) from where it stands at most of them."""
    y = T[:, :3, :3] @ torus.orbital_axis
    if not len(y):
        return np.zeros(0)
    most = np.median(y, axis=0)
    return np.arctan2(np.linalg.norm(np.cross(y, most), axis=1), y @ most)


def _sigma_of_axis(covariance: Covariance | None) -> float:
    """Of the calibrated orbital axis in the worst direction, rad: off by it, it makes a cone during the scan."""
    if covariance is None:
        return 0.0
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance.block("orbital_axis_sensor"))[-1], 0.0)))


def _outliers(scan: Recording, masks: dict[str, np.ndarray]) -> Outliers:
    numbers = {reason: tuple(int(i) for i in scan.pose_number[mask]) for reason, mask in masks.items()}
    reasons = tuple(Rejection(reason, len(poses), poses) for reason, poses in numbers.items() if poses)
    every = sorted(pose for reason in reasons for pose in reason.indices)
    return Outliers(len(every), tuple(every), reasons)


def _refusal(used: np.ndarray, again: np.ndarray, off: Array) -> Note | None:
    measured = int((~again).sum())
    if measured >= MIN_POSES and used.sum() < LEAST_USED * measured:
        return Note(
            "axis_moves",
            f"the calibrated orbital axis does not stand still: it turns by up to {np.degrees(off.max()):.1f} deg. "
            "Only the orbital joint may turn during a scan; or was the sensor moved on the C (see carm-kin check)?",
        )
    if used.sum() < MIN_POSES:
        return Note("too_few_poses", f"{used.sum()} usable poses; at least {MIN_POSES} are needed")
    return None


def _found(
    blank: VirtualCentre, scan: Recording, torus: Torus, sigma: tuple[float, float], covariance: Covariance | None
) -> VirtualCentre:
    """The centre of the used poses, fixed or not."""
    from scipy.special import chdtrc

    T_world_carm = scan.T_world_sensor @ torus.T_sensor_carm
    arc, least = _turn(T_world_carm), least_arc(sigma[1], Limits())
    if arc < least:
        message = f"the scan turns by {np.degrees(arc):.2g} deg, of which nothing is told: at least"
        return replace(blank, refusal=Note("too_uncertain", f"{message} {np.degrees(least):.2g} deg are needed"))
    problem = Problem.of_poses(scan.p_world_sensor, scan.R_world_sensor)
    point = still_point(problem, torus.T_sensor_carm, sigma)
    probability = float(chdtrc(point.dof, point.chi2))
    spread = _spread(scan, T_world_carm, point, point.least, sigma, probability)
    moves = probability < PROBABILITY
    if moves and spread.beyond_noise_m > blank.tolerance_m:
        return _at(blank, scan, torus, point.least, spread)
    excess = float(np.sqrt(point.chi2 / point.dof)) if moves else 1.0
    errors = _sigma(T_world_carm, torus, point, covariance, excess)
    worst = float(max(np.linalg.eigvalsh(excess**2 * point.C_v)[-1], 0.0) ** 0.5)
    if worst > MEANINGLESS_M:
        turn = np.degrees(_turn(T_world_carm))
        message = f"the scan turns by {turn:.2g} deg, which leaves the centre {uncertainty(worst)}: scan a longer arc"
        return replace(blank, refusal=Note("too_uncertain", message))
    spread = _spread(scan, T_world_carm, point, point.v, sigma, probability)
    notes = (_moves(spread, excess),) if moves else ()
    found = _at(blank, scan, torus, point.v, spread)
    return replace(found, status="fixed", sigma=errors, warnings=(*blank.warnings, *notes))


def _at(blank: VirtualCentre, scan: Recording, torus: Torus, v: Array, spread: Spread) -> VirtualCentre:
    """What the centre ``v`` (3,) of the C-arm frame means, with the status ``not_fixed``."""
    T_world_carm = scan.T_world_sensor @ torus.T_sensor_carm
    pivots, centres = T_world_carm[:, :3, 3], T_world_carm @ np.append(v, 1.0)
    c = centres[:, :3].mean(axis=0)
    y = T_world_carm[:, :3, 1].mean(axis=0)
    along = (pivots - c) @ (y / np.linalg.norm(y))
    radius = float(np.linalg.norm(v))
    across = np.sqrt(np.maximum(((pivots - c) ** 2).sum(axis=1) - along**2, 0.0))
    return replace(
        blank,
        status="not_fixed",
        centre_carm_m=v,
        centre_sensor_m=(torus.T_sensor_carm @ np.append(v, 1.0))[:3],
        centre_world_m=c,
        path_radius_m=radius,
        path_rms_m=float(np.sqrt(((across - radius) ** 2 + along**2).mean())),
        spread=spread,
        turn_rad=_turn(T_world_carm),
        used_poses=tuple(int(i) for i in scan.pose_number),
        pivots_world_m=pivots,
        centres_world_m=centres[:, :3],
    )


def _spread(
    scan: Recording, T_world_carm: Array, point: StillPoint, v: Array, sigma: tuple[float, float], probability: float
) -> Spread:
    """Of the places (N, 3) where the poses put ``v``; what two noises make of it depends on the lever."""
    centres = (T_world_carm @ np.append(v, 1.0))[:, :3]
    distance = np.linalg.norm(centres - centres.mean(axis=0), axis=1)
    lever = np.linalg.norm(centres - scan.p_world_sensor, axis=1)[0]
    left = point.dof / (point.dof + 5)
    noise = left * (3 * sigma[0] ** 2 + 2 * (lever * sigma[1]) ** 2)
    square, worst = float((distance**2).mean()), int(np.argmax(distance))
    return Spread(
        rms_m=square**0.5,
        noise_m=float(noise**0.5),
        beyond_noise_m=float(max(square - noise, 0.0) ** 0.5),
        largest_m=float(distance[worst]),
        largest_pose=int(scan.pose_number[worst]),
        chi2_per_dof=point.chi2 / point.dof,
        probability=probability,
    )


def _sigma(
    T_world_carm: Array, torus: Torus, point: StillPoint, covariance: Covariance | None, excess: float
) -> CentreSigma:
    """With the calibration's own: its pivot is where v is counted from, and along the axis where the centre is."""
    R_sc, y = torus.T_sensor_carm[:3, :3], T_world_carm[0, :3, 1]
    C_t = np.zeros((3, 3)) if covariance is None else R_sc.T @ covariance.block("offset_sensor_pivot") @ R_sc
    C_v, along = excess**2 * point.C_v, np.diag([0.0, C_t[1, 1], 0.0])
    across = np.diag([1.0, 0.0, 1.0])
    C_carm = C_v + across @ C_t @ across
    u = point.v / max(float(np.linalg.norm(point.v)), np.finfo(float).tiny)
    C_world = excess**2 * point.C_c + C_t[1, 1] * np.outer(y, y)
    C_sensor = R_sc @ (C_v + along) @ R_sc.T
    carm, sensor, world = (np.sqrt(np.maximum(np.diagonal(C), 0.0)) for C in (C_carm, C_sensor, C_world))
    return CentreSigma(carm, sensor, world, float(np.sqrt(max(u @ C_carm @ u, 0.0))))


def _moves(spread: Spread, excess: float) -> Note:
    return Note(
        "spread_beyond_noise",
        f"the centre moves by {spread.beyond_noise_m * 1e3:.2g} mm (rms) beyond the noise, which the tolerance allows; "
        f"the standard deviations are those of {excess:.2g} times the noise",
    )


def _turn(T_world_carm: Array) -> float:
    """Range of the turn about the orbital axis, rad, counted on from pose to pose."""
    R = np.swapaxes(T_world_carm[:1, :3, :3], 1, 2) @ T_world_carm[:, :3, :3]
    return float(np.ptp(np.unwrap(np.arctan2(R[:, 0, 2] - R[:, 2, 0], R[:, 0, 0] + R[:, 2, 2]))))


def _with_angles(found: VirtualCentre, angles: Array, torus: Torus) -> VirtualCentre:
    """With alpha, beta and the travel, by the angles (N, 2) of the poses."""
    if found.centre_world_m is None or found.pivots_world_m is None:
        return found
    return replace(
        found,
        alpha_rad=float(np.angle(np.exp(1j * angles[:, 0]).mean())),
        beta_rad=angles[:, 1],
        travel_torus_m=(found.pivots_world_m - found.centre_world_m) @ torus.T_world_torus[0, :3, :3],
    )


def _with_turn_told(found: VirtualCentre, scan: Recording, torus: Torus) -> VirtualCentre:
    """Without alpha, beta and the travel: the base has turned since the calibration."""
    if found.centre_world_m is None:
        return found
    note = Note(
        "base_turned",
        f"the orbital axis stands {np.degrees(abs(_base_turn(scan, torus))):.2g} deg off the calibrated angle to the "
        "angular axis: the base was turned, or is at another placement; alpha, beta and the travel are not told",
    )
    return replace(found, warnings=(*found.warnings, note))
