"""What a fixed point is worth, in words of its own: docs/refusals.md lists the codes."""

import numpy as np

from solvers import pivot
from solvers.estimate import Estimate, Note
from solvers.problem import Problem
from solvers.told import MIN_ARC_RAD, least_arc, turn_noise, turned
from solvers.verdict.limits import Limits, uncertain, uncertainty
from solvers.verdict.misread import misreadings
from solvers.verdict.residuals import correlated, correlation

QUIET_M = 0.001
"""Residuals below this are not asked for a cause, unless poses were rejected or neighbours agree."""
STILL_M = 0.002
"""A point stands still if it moves by less, an axis and rms."""
STILL_SHARE = 0.9
"""And if so many of the poses agree."""
LEAST_TOLD = 2
"""Directions without which nothing is told: a turn about one axis tells two."""


def refusal_of(part: Problem, estimate: Estimate, limits: Limits) -> Note | None:
    """Why an estimate of a fixed point from the used poses is refused, but for a cause of the misfit."""
    told = estimate.told
    share = 0.0 if estimate.used is None else 1 - estimate.used.mean()
    if len(part) < limits.min_poses:
        return Note("too_few_poses", f"{len(part)} usable poses; at least {limits.min_poses} are needed")
    if told is None or estimate.residual is None or share > limits.max_rejected_share:
        return Note("too_many_outliers", f"{share:.0%} of the poses agree with no fixed point that explains the others")
    if len(told.directions) < LEAST_TOLD:
        return _nothing_turned(part)
    rms = _rms(estimate)
    if rms > limits.max_sigma_t_m:
        return _misfit(rms)
    length = float(np.linalg.norm(told.offset))
    if length > limits.max_length_m:
        words = f"the tip would lie {length:.3g} m from the sensor: is the unit of the position columns right"
        return Note("misfit", f"{words} (millimetres read as metres)?")
    chi2 = chi2_per_dof(part, estimate)
    if None not in (part.sigma_t, part.sigma_r) and chi2 > limits.max_chi2_per_dof:
        return Note("misfit", f"residuals exceed the given noise: chi-square per degree of freedom {chi2:.1f}")
    if estimate.covariance is not None:
        return uncertain(estimate.covariance, limits)
    if told.sigma.max() > limits.max_offset_sigma_m:
        return Note("too_uncertain", f"what is told of the offset is {uncertainty(float(told.sigma.max()))}")
    return None


def chi2_per_dof(part: Problem, estimate: Estimate) -> float:
    """Squared residuals over the given noise, 1 where it is not given."""
    told = estimate.told
    if part.sigma_t is None or estimate.residual is None or told is None:
        return 1.0
    dof = max(estimate.residual.size - len(told.directions) - 3 * part.placements, 1)
    if part.sigma_r is None or estimate.offset is None:
        return float((estimate.residual**2).sum()) / part.sigma_t**2 / dof
    return pivot.whitened_square(part, estimate.offset, estimate.center, part.sigma_t**2, part.sigma_r**2) / dof


def asks_for_cause(part: Problem, estimate: Estimate, limits: Limits) -> bool:
    """Whether the poses fit so badly that a cause is looked for."""
    if estimate.residual is None or len(part) < limits.min_poses:
        return True
    rejected = 0.0 if estimate.used is None else 1 - estimate.used.mean()
    alike = correlation(_neighbours(part), estimate.residual.T) > limits.systematic_correlation
    return rejected > limits.silent_rejected_share or _rms(estimate) > QUIET_M or alike


def causes_of_misfit(problem: Problem, limits: Limits) -> tuple[Note, ...]:
    """The ways of misreading the poses without which they fit one point `Limits.min_gain` times better."""
    before = _typical_distance(problem)
    found = [(_typical_distance(other), note) for note, other in misreadings(problem)]
    least = min((distance for distance, _ in found), default=before)
    if least * limits.min_gain > before or least > limits.max_sigma_t_m:
        return ()
    return tuple(note for distance, note in found if distance <= 1.5 * least)


def residual_notes(part: Problem, estimate: Estimate) -> tuple[Note, ...]:
    """What the residuals of an accepted point still show."""
    found = None if estimate.correlation is None else correlated(estimate.correlation, len(part))
    return () if found is None else (found,)


def still_point_note(problem: Problem) -> Note | None:
    """A likely cause of a C-arm's misfit: one point of the sensor stands still, as that of a pointer does."""
    if problem.R_world_sensor is None or len(problem) < Limits.min_poses:
        return None
    used = pivot.agreeing(problem)
    if used.mean() < STILL_SHARE:
        return None
    part = problem.select(used)
    t, c = pivot.least_squares(part, np.ones(len(part), dtype=bool))
    rms = float(np.sqrt((pivot.distances(part, t, c) ** 2).mean() / 3))
    if rms > STILL_M or not turned(part, turn_noise(part).sigma).told.all():
        return None
    return Note(
        "fixed_point",
        f"one point of the sensor's frame stands still within {rms * 1e3:.2f} mm, as the tip of a pointer does: "
        "calibrate with --locus point (in Python locus='point')",
    )


def _nothing_turned(part: Problem) -> Note:
    least = np.degrees(least_arc(turn_noise(part).sigma))
    why = "a smaller turn is wobble" if least <= np.degrees(MIN_ARC_RAD) else "a smaller turn is noise"
    return Note(
        "nothing_turned",
        f"nothing turned: the sensor has to turn by {least:.0f} deg about two directions ({why}), by more the better",
    )


def _misfit(rms: float) -> Note:
    return Note(
        "misfit",
        f"no fixed point explains these poses: it would move by {rms * 1e3:.1f} mm (one sigma, an axis); did the tip "
        "slip, or is the unit or the direction of the poses wrong?",
    )


def _rms(estimate: Estimate) -> float:
    return 0.0 if estimate.residual is None else float(np.sqrt((estimate.residual**2).mean()))


def _typical_distance(problem: Problem) -> float:
    """Median distance, m, of all poses from the point on which most agree."""
    t, c = pivot.least_squares(problem, pivot.agreeing(problem))
    return float(np.median(pivot.distances(problem, t, c)))


def _neighbours(part: Problem) -> np.ndarray:
    return np.diff(part.placement) == 0
