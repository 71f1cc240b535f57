"""Held-out check: every part of a recording predicted by the fit to the other parts.

A fold is a share of the sweeps where there are sweeps, else one contiguous block of every base placement.
Of a fit only the machine and where it stands are kept. The angles of the held-out poses that no exact label
gives are fitted to these poses themselves, one a sweep where a joint is held, and so absorb a part of their residuals.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from carm_kin.calibration.calibrate import calibrate
from carm_kin.calibration.cross_validate_point import placement_gone, point_errors, point_refusal
from carm_kin.calibration.known_length import in_scale_of
from carm_kin.calibration.problem import to_problem
from carm_kin.calibration.settings import POINT
from carm_kin.errors import InputError, RefusedError
from carm_kin.recording.formats import RecordingLike, as_recording
from carm_kin.recording.recording import Recording
from carm_kin.results.held_out import CrossValidation, Errors, HeldOut, overall_of, row_of
from carm_kin.results.result import CalibrationResult
from carm_kin.steps import step
from solvers.estimate import Note
from solvers.kinematic import fit_angles
from solvers.likelihood.labels import unlabelled
from solvers.likelihood.linearise import linearise
from solvers.likelihood.slipping import let_go
from solvers.problem import ANGULAR, ORBITAL, Problem
from solvers.torus import Torus

LEAST_SPREAD_RAD = float(np.radians(1.0))
"""A joint whose angle spreads by less within the poses of a placement does not move there."""


@step("predict the held-out parts")
def cross_validate(
    recording: RecordingLike,
    folds: int = 5,
    solver: str | None = None,
    *,
    angular: str = "angular",
    orbital: str = "orbital",
    counted: np.ndarray | None = None,
    known_length: str | None = None,
    **options: Any,
) -> CrossValidation:
    """Predict every part of the recording, which may be a path, with the fit to the other parts.

    ``folds`` is their number; ``solver`` and ``options`` are those of `carm_kin.calibrate`; a ``known_length`` tells
    the scale of the whole recording. The poses of the mask ``counted`` (N,) are scored, by default those that the fit
    to the whole recording does not reject. A fold without which the rest does not determine the machine or a placement
    is refused by itself, and says why.

    Raises InputError for a number of folds that the recording does not allow and a solver that gives neither a
    complete chain nor a point, RefusedError where the whole recording is refused or told in part.
    """
    recording = as_recording(recording)
    number = fold_of_poses(recording, folds)
    whole = calibrate(recording, solver, angular=angular, orbital=orbital, known_length=known_length, **options)
    if whole.refusal:
        raise RefusedError(whole.refusal.code, whole.refusal.message)
    if whole.status == "partial":
        raise RefusedError("partial", f"not told: {'; '.join(whole.observability.unobservable)}")
    recording = in_scale_of(whole, recording)
    told = placed(recording, whole)
    recording, number = recording.select(told), number[told]
    counted = None if counted is None else counted[told]
    of_point = options.get("locus") == POINT
    if not of_point:
        torus_of(whole, recording.placements)
    sound = ~np.isin(recording.pose_number, whole.outliers.indices) if counted is None else counted
    problem = to_problem(recording, angular, orbital, options.get("sigma_label_rad"))
    rows: list[HeldOut] = []
    sums: list[Errors] = []
    for fold in range(folds):
        held = number == fold
        label, scored = f"fold {fold + 1}", held & sound
        sweeps = tuple(sweep.label for sweep in recording.sweeps if held[sweep.poses[0]])
        fit = calibrate(recording.select(~held), solver, angular=angular, orbital=orbital, **options)
        unfit, predicted = (point_refusal, point_errors) if of_point else (_refusal, _predicted)
        refusal = unfit(recording, problem, fit, ~held & sound) or nothing_left(scored)
        if refusal is None:
            sums.append(predicted(recording, problem, fit, scored))
        rows.append(row_of(label, sweeps, scored.sum(), None if refusal else sums[-1], refusal))
    return CrossValidation(folds, overall_of(rows, sums), tuple(rows))


def errors_of(
    recording: Recording,
    result: CalibrationResult,
    counted: np.ndarray,
    angular: str = "angular",
    orbital: str = "orbital",
) -> Errors:
    """Errors of the ``counted`` (N,) poses by a result, the angles that no label tells fitted to them.

    Raises InputError where the result has no complete chain.
    """
    told = placed(recording, result)
    recording = recording.select(told)
    return _predicted(recording, to_problem(recording, angular, orbital), result, counted[told])


def placed(recording: Recording, result: CalibrationResult) -> np.ndarray:
    """(N,) mask of the poses of whose placement the result tells where it stands."""
    told = {placement.label for placement in result.placements}
    return np.array([label in told for label in recording.placements])[recording.placement_number]


def fold_of_poses(recording: Recording, folds: int) -> np.ndarray:
    """(N,) the fold of each pose, 0 to ``folds`` - 1.

    Sweeps are dealt out in turn, those of the same moving joint and placement one after the other; poses
    without a sweep are cut into contiguous blocks, placement by placement. Raises InputError for fewer than 2 folds,
    and for more than there are sweeps or poses of a placement to fill them with.
    """
    if folds < 2:
        raise InputError(f"cross-validation needs at least 2 folds, not {folds}")
    number = np.zeros(len(recording), dtype=int)
    sweeps = sorted(recording.sweeps, key=lambda sweep: (sweep.placement, sweep.moving))
    for k, sweep in enumerate(sweeps):
        number[sweep.poses] = k % folds
    loose = np.flatnonzero(recording.sweep_number < 0)
    if not loose.size and len(sweeps) < folds:
        raise InputError(f"{len(sweeps)} sweeps can be held out one by one, not in {folds} folds")
    for placement, label in enumerate(recording.placements):
        here = loose[recording.placement_number[loose] == placement]
        if 0 < len(here) < folds:
            raise InputError(f"placement '{label}' has {len(here)} poses without a sweep, too few for {folds} folds")
        for k, block in enumerate(np.array_split(here, folds)):
            number[block] = k
    return number


def torus_of(result: CalibrationResult, placements: tuple[str, ...]) -> Torus:
    """The chain in a result, its ``placements`` in this order.

    Raises InputError where the result is refused, has no complete chain, or lacks a placement.
    """
    if result.refusal:
        raise InputError(f"the calibration is refused ({result.refusal.code}): it holds no C-arm")
    if result.T_sensor_carm is None or result.major_radius_signed_m is None:
        raise InputError(f"a result of the solver '{result.solver}' holds no complete chain; use 'kinematic'")
    found = {placement.label: placement for placement in result.placements}
    missing = [label for label in placements if label not in found or found[label].T_world_torus is None]
    if missing:
        raise InputError(f"the result does not tell where placement '{missing[0]}' stands")
    return Torus(
        np.array([found[label].T_world_torus for label in placements]),
        result.major_radius_signed_m,
        result.axis_non_orthogonality_rad or 0.0,
        result.T_sensor_carm,
        np.array([found[label].referenced for label in placements], dtype=bool),
        result.orbital_referenced,
    )


def _refusal(recording: Recording, problem: Problem, fit: CalibrationResult, rest: np.ndarray) -> Note | None:
    """Why the fit to the ``rest`` (N,) cannot predict the other poses."""
    if refusal := placement_gone(recording, rest) or fit.refusal:
        return refusal
    if not placed(recording, fit).all():
        label = recording.placements[recording.placement_number[~placed(recording, fit)][0]]
        return Note("one_axis_only", f"no angular motion of placement '{label}' is left to fit")
    torus = torus_of(fit, recording.placements)
    angles = torus.angles(problem)
    for k, label in enumerate(recording.placements):
        of_placement = angles[rest & (problem.placement == k)]
        for joint, name in ((ANGULAR, "angular"), (ORBITAL, "orbital")):
            if _spread(of_placement[:, joint]) < LEAST_SPREAD_RAD:
                return Note("one_axis_only", f"no {name} motion of placement '{label}' is left to fit")
    return None


def nothing_left(scored: np.ndarray) -> Note | None:
    """Why a fold without a ``scored`` pose (mask) has no errors."""
    return None if scored.any() else Note("all_rejected", "the fit to all poses rejects every pose of this fold")


def _spread(angle: np.ndarray) -> float:
    """Circular standard deviation, rad."""
    return float(np.sqrt(max(0.0, -2 * np.log(max(abs(np.exp(1j * angle).mean()), 1e-300)))))


def _predicted(recording: Recording, problem: Problem, fit: CalibrationResult, scored: np.ndarray) -> Errors:
    """Errors of the ``scored`` (N,) poses, their unknown angles fitted to them with the noise of the fit."""
    torus = torus_of(fit, recording.placements)
    problem = unlabelled(problem)
    label = problem.label.copy()
    label[~torus.referenced[problem.placement], ANGULAR] = np.nan
    if not torus.orbital_referenced:
        label[:, ORBITAL] = np.nan
    noise = fit.noise
    known = replace(problem, label=label, sigma_t=noise.translation_m, sigma_r=noise.rotation_rad)
    part, _ = let_go(known.select(scored), torus, np.ones(int(scored.sum()), dtype=bool))
    angles, at = fit_angles(part, torus)
    residual = linearise(torus, angles, part).residual
    return Errors(
        len(part),
        float((residual[:3] ** 2).sum()),
        float((residual[3:] ** 2).sum()),
        at.cost - at.reading_cost,
        float(sum(at.redundancy)),
    )
