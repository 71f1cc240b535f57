"""From a recording to a result: recording -> problem -> solver -> assessment -> result."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

import solvers
from carm_kin.calibration.assembly import refused_result, result_of
from carm_kin.calibration.known_length import KnownLength, scaled, with_scale
from carm_kin.calibration.options import options_of
from carm_kin.calibration.problem import to_problem
from carm_kin.calibration.settings import AUTO, CIRCLE, effects_of, options_class, solver_for
from carm_kin.errors import InputError
from carm_kin.recording.duplicates import IDLE, NotMeasured
from carm_kin.recording.formats import RecordingLike, as_recording
from carm_kin.recording.recording import Recording
from carm_kin.recording.stations import refitted
from carm_kin.results.parts import Outliers, Provenance, Rejection
from carm_kin.results.provenance import provenance_of
from carm_kin.results.result import CalibrationResult
from carm_kin.steps import step
from carm_kin.typed import check_from_zero
from solvers.effects.allowed import allowing_for
from solvers.estimate import Note
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.verdict.assess import Limits, assess
from solvers.verdict.mixed_units import mixed_units

EXTENT_M = (0.005, 100.0)
"""Positions that span less than the first while the sensor turns, or more than the second, are in a wrong unit."""
TURNED = 0.1
"""Range of an entry of the rotation matrices from which on the sensor counts as turning."""
MIN_PLACEMENT = 3
"""Fewest poses of a base placement."""


def calibrate(
    recording: RecordingLike,
    solver: str | None = None,
    *,
    locus: str = "circle",
    angular: str = "angular",
    orbital: str = "orbital",
    sigma_t_m: float | None = None,
    sigma_r_rad: float | None = None,
    sigma_label_rad: float | None = None,
    known_length: str | None = None,
    systematic: str | Sequence[str] = AUTO,
    limits: Limits = Limits(),
    command: str | None = None,
    **options: Any,
) -> CalibrationResult:
    """Calibrate a recording, or the one in a file.

    ``solver`` is one of `solvers.solver_names()`; by default ``kinematic``, or ``direct`` for a locus
    other than the circle of a C-arm. ``angular`` and ``orbital`` name the joints of the two axes.
    ``sigma_t_m`` and ``sigma_r_rad`` give the tracker's noise an axis; by default it is estimated.
    ``sigma_label_rad`` is the standard deviation of the labels of held joints, 0 for exact ones; by default that of
    rounding to their last digit.
    ``known_length`` tells the tracker's scale: ``400:400.8``, a gauge's true length and the same as tracked, or
    ``major_radius:80``, mm, with its one sigma behind ``+-``.
    ``systematic`` errors for which the ± and, by ``kinematic``, the estimate allow: ``auto``, ``none``, or the names of
    effects (`solvers.effects.columns.EFFECTS`).
    ``options`` are those of the solver. A refusal is a result of status ``refused``, not an exception.

    Raises InputError for an unknown solver or option, and where the recording lacks what the solver needs.
    """
    recording = as_recording(recording)
    name = solver_for(solver, locus)
    if known_length is not None:
        return _by_known_length(
            KnownLength.of(known_length),
            recording,
            lambda scaled: calibrate(
                scaled,
                solver,
                locus=locus,
                angular=angular,
                orbital=orbital,
                sigma_t_m=sigma_t_m,
                sigma_r_rad=sigma_r_rad,
                sigma_label_rad=sigma_label_rad,
                systematic=systematic,
                limits=limits,
                command=command,
                **options,
            ),
        )
    if locus != CIRCLE:
        options["locus"] = locus
    chosen = options_of(options_class(name), name, options)
    check_noise("sigma_t_m", sigma_t_m)
    check_noise("sigma_r_rad", sigma_r_rad)
    check_from_zero("sigma_label_rad", sigma_label_rad)
    not_measured = NotMeasured.of(recording.p_world_sensor, recording.R_world_sensor)
    again = not_measured.any_of
    if (~again).sum() < limits.min_poses:
        again = np.zeros(len(recording), dtype=bool)
    run = _Run(
        recording,
        lambda kept: replace(
            to_problem(kept, angular, orbital, sigma_label_rad), sigma_t=sigma_t_m, sigma_r=sigma_r_rad
        ),
        name,
        chosen,
        limits,
        effects_of(systematic),
        provenance_of(recording, command, options.get("seed")),
    )
    result = _calibrated(run, ~again)
    if not again.any():
        return result
    frozen = tuple(note for note in recording.warnings if note.code == "duplicated_poses")
    result = replace(result, warnings=(*frozen, *not_measured.notes(), *result.warnings))
    return _with_left_out(result, recording, not_measured)


def _by_known_length(
    known: KnownLength, recording: Recording, calibrated: Callable[[Recording], CalibrationResult]
) -> CalibrationResult:
    """The result of the recording in the scale that the known length tells."""
    plain = calibrated(recording) if known.name else None
    if plain is not None and plain.refusal:
        return plain
    scale = known.scale_by(plain)
    result = calibrated(scaled(recording, scale))
    return result if result.refusal else with_scale(result, known, scale)


@dataclass(frozen=True, eq=False)
class _Run:
    """What of a calibration does not depend on the poses that are kept."""

    whole: Recording
    problem_of: Callable[[Recording], Problem]
    name: str
    options: Any
    limits: Limits
    effects: tuple[str, ...]
    provenance: Provenance


def _calibrated(run: _Run, kept: np.ndarray) -> CalibrationResult:
    """The result of the ``kept`` poses (N,) of the recording."""
    name, options, limits, provenance = run.name, run.options, run.limits, run.provenance
    recording = run.whole if kept.all() else run.whole.select(kept)
    problem = run.problem_of(recording)
    if problem.R_world_sensor is None and name != "surface":
        raise InputError(f"the recording has no orientations (qw, qx, qy, qz), which '{name}' needs; use 'surface'")
    refusal = Note("too_few_poses", f"{len(problem)} poses; at least {limits.min_poses} are needed")
    if len(problem) >= limits.min_poses:
        refusal = (
            wrong_unit(problem.p_world_sensor, problem.R_world_sensor)
            or mixed_units(problem)
            or _small_placement(run.whole, kept)
        )
    if refusal:
        return refused_result(recording, name, asdict(options), refusal, provenance)
    try:
        with step(f"solve by {name}: {len(problem)} poses"):
            estimate = solvers.solve(name, problem, options)
        if recording.variance is not None and name == "kinematic":
            problem = refitted(problem, estimate, recording.variance)
            with step(f"solve by {name}: the stops by what they tell"):
                estimate = solvers.solve(name, problem, options)
    except np.linalg.LinAlgError:
        refusal = Note("unobservable", "the poses determine no machine: the equations are singular")
        return refused_result(recording, name, asdict(options), refusal, provenance)
    except ValueError as error:
        raise InputError(str(error)) from None
    with step("assess the estimate"):
        assessment = assess(problem, estimate, limits, run.effects)
    if assessment.idle.size:
        idle = np.isin(problem.placement, assessment.idle)
        rest = recording.select(~idle)
        result = _calibrated(replace(run, whole=rest), np.ones(len(rest), dtype=bool))
        return _without_idle(result, recording, idle)
    if assessment.systematic is not None:
        estimate = allowing_for(estimate, problem, assessment.systematic)
    return result_of(recording, problem, estimate, assessment, asdict(options), provenance)


def _without_idle(result: CalibrationResult, recording: Recording, idle: np.ndarray) -> CalibrationResult:
    """The ``result`` of the poses but for those of the mask ``idle`` (N,), whose placements have no angular motion."""
    labels = [recording.placements[k] for k in np.unique(recording.placement_number[idle])]
    named = ", ".join(f"'{label}'" for label in labels)
    note = Note(
        "placement_left_out",
        f"placement{'s' * (len(labels) > 1)} {named} ({idle.sum()} poses) left out: without angular motion there, "
        "where the base stood is unknown, and the poses tell nothing of the offset",
    )
    result = replace(result, warnings=(*result.warnings, note))
    return _with_left_out(result, recording, NotMeasured({IDLE: idle}))


def _with_left_out(result: CalibrationResult, recording: Recording, not_measured: NotMeasured) -> CalibrationResult:
    """The result with the poses that had no part in it counted and listed."""
    again = not_measured.any_of
    numbers = tuple(int(i) for i in recording.pose_number[again])
    fitted = result.outliers.indices
    known = (
        Rejection(reason, int(poses.sum()), tuple(int(i) for i in recording.pose_number[poses]))
        for reason, poses in not_measured.reasons.items()
        if poses.any()
    )
    angles = None
    if result.angles_rad is not None:
        angles = np.full((len(recording), 2), np.nan)
        angles[~again] = result.angles_rad
    return replace(
        result,
        poses=len(recording),
        outliers=Outliers(
            len(fitted) + len(numbers), tuple(sorted((*fitted, *numbers))), (*result.outliers.reasons, *known)
        ),
        angles_rad=angles,
    )


def check_noise(name: str, value: float | None) -> None:
    """Raise InputError for a noise that is not a finite number above 0."""
    if value is not None and not 0 < value < np.inf:
        raise InputError(f"{name} must be a finite number above 0, not {value}")


def wrong_unit(p_world_sensor: Array, R_world_sensor: Array | None) -> Note | None:
    """A refusal for positions (N, 3) of a size that no C-arm has while its sensor turns, (N, 3, 3)."""
    extent = float(np.ptp(p_world_sensor, axis=0).max(initial=0.0))
    turned = R_world_sensor is None or np.ptp(R_world_sensor, axis=0).max() > TURNED
    large = extent > EXTENT_M[1]
    if not large and not (turned and extent < EXTENT_M[0]):
        return None
    mistake = "millimetres read as metres" if large else "metres read as millimetres"
    return Note(
        "misfit",
        f"the positions span {extent * 1e3:.3g} mm, which no C-arm and no pointer does. Likely cause: a wrong unit in "
        f"the names of the position columns ({mistake})",
    )


def _small_placement(recording: Recording, kept: np.ndarray) -> Note | None:
    counts = np.bincount(recording.placement_number[kept], minlength=len(recording.placements))
    few = np.flatnonzero(counts < MIN_PLACEMENT)
    if not few.size:
        return None
    return Note(
        "too_few_poses",
        f"placement '{recording.placements[few[0]]}' has {counts[few[0]]} poses that are not repeated; "
        f"at least {MIN_PLACEMENT} are needed",
    )
