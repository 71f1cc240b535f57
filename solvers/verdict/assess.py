"""What an estimate is worth: residuals, noise, observability, and whether to refuse it.

Every solver's chain is judged by the same likelihood, so that residuals can be compared.
docs/refusals.md lists the codes.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from solvers import kinematic
from solvers.effects.columns import EFFECTS
from solvers.effects.of_point import PointSystematic, point_systematic
from solvers.effects.systematic import Systematic, systematic
from solvers.estimate import Correlation, Covariance, Estimate, Note
from solvers.likelihood.correlation import Stretches, correlation_of
from solvers.likelihood.covariance import active_unknowns, covariance_of, scaled_spectrum
from solvers.likelihood.elimination import normal_equations
from solvers.likelihood.linearise import AngleModel, linearise
from solvers.likelihood.reduced import Reduced
from solvers.likelihood.slipping import let_go
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.start.axes import ambiguous
from solvers.torus import Torus
from solvers.verdict import pivot as of_point
from solvers.verdict.bump import bump_of
from solvers.verdict.diagnose import LABELS, base_moved_at, causes_of
from solvers.verdict.held_out import LeftOut, left_out
from solvers.verdict.limits import Limits, misfit, uncertain
from solvers.verdict.observability import (
    AMBIGUOUS,
    balanced,
    idle_placements,
    in_words,
    joints_at_rest,
    thickness,
    turns_about_one_axis,
)
from solvers.verdict.one_axis import one_circle
from solvers.verdict.rejected import doubtful
from solvers.verdict.residuals import neighbour_correlation, residual_notes
from solvers.verdict.several_moves import several_moves_of
from solvers.verdict.two_sensors import two_sensors_of

__all__ = ["Assessment", "Limits", "assess"]

KEPT = ("misfit", "one_axis_only")
"""Refusals to which a likely cause is added."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """Residuals and verdict, m and rad."""

    angles: Array | None
    """alpha, beta (N, 2)."""
    position_residual: Array
    """(N, 3) or (N, K) observed less predicted, m."""
    rotation_residual: Array | None
    """(N, 3) rotation vectors, rad."""
    sigma_t: float
    sigma_r: float | None
    chi2_per_dof: float
    correlation: Correlation | None
    """For how many poses the noise lasts; None where there is no estimate."""
    singular_values: Array
    """Of the information scaled to a unit diagonal, largest first; empty where there is no chain."""
    unobservable: tuple[str, ...]
    """In words."""
    notes: tuple[Note, ...]
    """What the residuals and the rejected poses show."""
    refusal: Note | None
    systematic: Systematic | PointSystematic | None = None
    """The effects beside the noise; None where it is refused or has no covariance."""
    idle: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    """Numbers of the placements without which it need not be refused: they have no angular motion."""
    left_out: LeftOut | None = None
    """How the parts of the recording agree beside them; None where there are too few parts."""


def assess(
    problem: Problem, estimate: Estimate, limits: Limits = Limits(), effects: tuple[str, ...] = tuple(EFFECTS)
) -> Assessment:
    """Judge an estimate of ``problem`` by the poses that it used, and look for systematic ``effects``; the rows of the
    others are NaN."""
    used = np.ones(len(problem), dtype=bool) if estimate.used is None else estimate.used
    problem = replace(problem, shape=estimate.shape)
    weighed = estimate.weighed(problem)
    part = weighed if used.all() else weighed.select(used)
    if estimate.told is not None:
        return _assess_point(problem, part, estimate, used, limits, effects)
    if estimate.torus is None or len(part) < limits.min_poses:
        found = _assess_positions(part, estimate, used, limits)
        return replace(found, refusal=_hardly_any(problem, part, limits) or found.refusal)
    torus = estimate.torus
    slips: tuple[Note, ...] = ()
    if estimate.angles is None:
        part, slips = let_go(part, torus, np.ones(len(part), dtype=bool))
        angles, at = kinematic.fit_angles(part, torus)
        sigma = (at.sigma[0], at.sigma[1])
    else:
        angles, sigma = estimate.angles.T[:, used], (estimate.sigma_t or 0.0, estimate.sigma_r or 0.0)
        at = normal_equations(torus, angles, part, AngleModel.of(part), sigma)
    line = linearise(torus, angles, part)
    residual = line.residual
    active = active_unknowns(part, fix_non_orthogonality=torus.non_orthogonality == 0.0)
    values, vectors, scale = scaled_spectrum(_information(torus, angles, part, at, sigma), active)
    correlation = estimate.correlation or correlation_of(at.left, Stretches.of(part), float(active.sum()))
    covariance = covariance_of(torus, kinematic.correlated_covariance(at, active, correlation))
    null = vectors[:, values < limits.min_relative_information * values[-1]] / scale[:, None]
    still = joints_at_rest(part, angles, sigma[1], limits)
    if _loud(sigma, limits) or (null.size and not still):
        still = turns_about_one_axis(part)
    idle = idle_placements(part, angles, sigma[1], limits) if still else np.zeros(0, dtype=int)
    unobservable = (*still, *in_words(torus, active, null))
    if not still and ambiguous(part):
        unobservable += (AMBIGUOUS,)
    chi2_per_dof = at.cost / max(sum(at.redundancy) - active.sum(), 1.0)
    asked = (
        _loud(sigma, limits)
        or 1 - used.mean() > limits.silent_rejected_share
        or neighbour_correlation(part, residual) > limits.systematic_correlation
        or chi2_per_dof > limits.max_chi2_per_dof
    )
    causes = causes_of(problem, estimate, limits) if asked and not still else ()
    moved_at = None if causes else base_moved_at(problem, estimate)
    refusal = (
        _misfits(part, sigma, chi2_per_dof, still, limits)
        or _too_long(torus, limits)
        or _too_many_rejected(used, moved_at, limits)
        or (doubtful(problem, used) if moved_at is None else None)
        or _undetermined(covariance, unobservable, limits)
    )
    open_question = refusal is None or (refusal.code == "misfit" and moved_at is None)
    if refusal and not causes and moved_at is None and (fixed := of_point.still_point_note(problem)):
        causes = (fixed,)
    bump = bump_of(weighed, estimate, angles, sigma, line) if open_question and not causes else None
    if open_question and not causes and not bump:
        another = two_sensors_of(part, torus, angles, sigma, line, np.flatnonzero(used))
        another = another or several_moves_of(weighed, estimate)
        causes = (another,) if another else ()
    moved, moved_at = ((bump.note,), None) if bump else ((), moved_at)
    causes = moved if bump and bump.harmful else causes
    fitted = estimate.covariance is not None and not refusal and not causes
    found = systematic(part, torus, angles, sigma, active, effects) if fitted else None
    correlation = found.correlation if found and found.names else correlation
    disagree = (found.note,) if found and found.note else ()
    clean = residual_notes(angles, residual, at.redundancy[0], correlation, bool(effects)) if fitted else ()
    return Assessment(
        angles=_spread(angles.T, used),
        position_residual=_spread(residual[:3].T, used),
        rotation_residual=_spread(residual[3:].T, used),
        sigma_t=sigma[0],
        sigma_r=sigma[1],
        chi2_per_dof=float(chi2_per_dof),
        correlation=correlation,
        singular_values=values[::-1],
        unobservable=unobservable,
        notes=(*_rejections(used, moved_at, limits), *(causes or moved), *slips, *clean, *disagree),
        refusal=_with_causes(refusal, causes, used, limits),
        systematic=found,
        idle=idle,
        left_out=left_out(found) if found else None,
    )


def _information(torus: Torus, angles: Array, part: Problem, at: Reduced, sigma: tuple[float, float]) -> Array:
    """The information (D, D) by which observability is judged: that of `balanced` noises."""
    equal = balanced(sigma, torus)
    return at.H if equal == sigma else normal_equations(torus, angles, part, AngleModel.of(part), equal).H


def _loud(sigma: tuple[float, float], limits: Limits) -> bool:
    return sigma[0] > limits.max_sigma_t_m or sigma[1] > limits.max_sigma_r_rad


def _with_causes(refusal: Note | None, causes: tuple[Note, ...], used: np.ndarray, limits: Limits) -> Note | None:
    """The refusal with its likely causes. Wrong sweeps that were rejected are no reason to refuse the others."""
    left_out = all(note.code in LABELS for note in causes) and 1 - used.mean() > limits.silent_rejected_share
    if not causes or (refusal is None and left_out):
        return refusal
    likely = "; or ".join(note.message for note in causes)
    if refusal and refusal.code in KEPT:
        return Note(refusal.code, f"{refusal.message}. Likely cause: {likely}")
    return Note("misfit", f"the poses do not fit one C-arm as they stand. Likely cause: {likely}")


def _too_long(torus: Torus, limits: Limits) -> Note | None:
    length = float(np.linalg.norm(torus.offset))
    if length <= limits.max_length_m:
        return None
    return Note(
        "misfit",
        f"the sensor would stand {length:.3g} m from the pivot: is the unit of the position columns right "
        "(millimetres read as metres)?",
    )


def _assess_positions(part: Problem, estimate: Estimate, used: np.ndarray, limits: Limits) -> Assessment:
    """The verdict on an estimate without a chain, from its own residuals."""
    residual = estimate.residual if estimate.residual is not None else np.zeros((len(part), 1))
    mean_square = float((residual**2).sum()) / max(residual.size, 1)
    sigma = estimate.sigma_t or float(np.sqrt(mean_square))
    refusal = None
    if len(part) < limits.min_poses:
        refusal = Note("too_few_poses", f"{len(part)} usable poses; at least {limits.min_poses} are needed")
    elif estimate.major_radius is None and estimate.unobservable:
        refusal = Note("unobservable", "; ".join(one_circle(part.p_world_sensor) or estimate.unobservable))
    elif estimate.offset is None and (untold := one_circle(part.p_world_sensor)):
        refusal = Note("unobservable", "; ".join(untold))
    elif sigma > limits.max_sigma_t_m:
        refusal = misfit(sigma, 0.0)
    elif still := _arcs_of_positions(part, estimate, used, sigma, limits):
        refusal = Note("unobservable", "; ".join(still))
    elif estimate.offset is None and thickness(part) < limits.min_spread_sigmas * sigma:
        refusal = Note(
            "unobservable", "the positions fill no surface beyond their noise: the arcs are too short for it"
        )
    elif estimate.covariance and estimate.covariance.block("offset").size:
        refusal = uncertain(estimate.covariance, limits)
    given = part.sigma_t
    return Assessment(
        angles=None,
        position_residual=_spread(residual, used),
        rotation_residual=None,
        sigma_t=sigma,
        sigma_r=None,
        chi2_per_dof=mean_square / given**2 if given else 1.0,
        correlation=estimate.correlation,
        singular_values=np.zeros(0),
        unobservable=estimate.unobservable,
        notes=(),
        refusal=refusal,
    )


def _assess_point(
    problem: Problem, part: Problem, estimate: Estimate, used: np.ndarray, limits: Limits, effects: tuple[str, ...]
) -> Assessment:
    """The verdict on a fixed point."""
    residual = estimate.residual if estimate.residual is not None else np.full((len(part), 3), np.nan)
    refusal = of_point.refusal_of(part, estimate, limits)
    untold = refusal is not None and refusal.code == "nothing_turned"
    asked = not untold and of_point.asks_for_cause(part, estimate, limits)
    causes = of_point.causes_of_misfit(problem, limits) if asked else ()
    if causes:
        likely = "; or ".join(note.message for note in causes)
        refusal = Note("misfit", f"no fixed point explains these poses as they stand. Likely cause: {likely}")
    found = None
    if refusal is None and estimate.told is not None:
        told = estimate.told
        found = point_systematic(part, told.directions, told.directions.T @ told.offset, residual, effects)
    return Assessment(
        angles=None,
        position_residual=_spread(residual, used),
        rotation_residual=None,
        sigma_t=estimate.sigma_t or 0.0,
        sigma_r=estimate.sigma_r,
        chi2_per_dof=of_point.chi2_per_dof(part, estimate),
        correlation=estimate.correlation,
        singular_values=np.zeros(0),
        unobservable=estimate.unobservable,
        notes=(
            *_rejections(used, None, limits),
            *causes,
            *(() if refusal else of_point.residual_notes(part, estimate)),
        ),
        refusal=refusal,
        systematic=found,
    )


def _arcs_of_positions(
    part: Problem, estimate: Estimate, used: np.ndarray, sigma: float, limits: Limits
) -> tuple[str, ...]:
    """`joints_at_rest` where the joints' angles are known from positions alone."""
    if estimate.angles is None or not estimate.minor_radius:
        return ()
    return joints_at_rest(part, estimate.angles[used].T, sigma / estimate.minor_radius, limits)


def _hardly_any(problem: Problem, part: Problem, limits: Limits) -> Note | None:
    """Why of enough poses too few were used, where the orientations tell."""
    if not len(part) < limits.min_poses <= len(problem) or problem.R_world_sensor is None:
        return None
    one_axis = turns_about_one_axis(problem)
    return Note("one_axis_only", "; ".join(one_axis)) if one_axis else None


def _spread(values: Array, used: np.ndarray) -> Array:
    """Rows of the used poses among all, NaN elsewhere."""
    full = np.full((len(used), values.shape[1]), np.nan)
    full[used] = values
    return full


def _rejections(used: np.ndarray, moved_at: int | None, limits: Limits) -> tuple[Note, ...]:
    """What there is to say of the poses that were not used."""
    if moved_at is not None:
        return (_base_moved(moved_at, used),)
    share = 1 - used.mean()
    if share <= limits.silent_rejected_share:
        return ()
    return (Note("many_rejected", f"{share:.0%} of the poses do not agree with the others and were not used"),)


def _base_moved(pose: int, used: np.ndarray) -> Note:
    return Note(
        "base_moved",
        f"the base seems to have been moved at pose {pose}: the {(~used).sum()} poses that do not fit agree with the "
        "same machine standing elsewhere; give them a 'placement' of their own",
    )


def _too_many_rejected(used: np.ndarray, moved_at: int | None, limits: Limits) -> Note | None:
    share = 1 - used.mean()
    if moved_at is not None and share > limits.max_moved_share:
        return Note("misfit", _base_moved(moved_at, used).message)
    if share > limits.max_rejected_share:
        return Note("too_many_outliers", f"{share:.0%} of the poses agree with no C-arm that explains the others")
    return None


def _misfits(
    part: Problem, sigma: tuple[float, float], chi2_per_dof: float, still: tuple[str, ...], limits: Limits
) -> Note | None:
    if still:
        return Note("one_axis_only", "; ".join(still))
    if _loud(sigma, limits):
        return misfit(*sigma)
    given = part.sigma_t is not None and part.sigma_r is not None
    if given and chi2_per_dof > limits.max_chi2_per_dof:
        return Note("misfit", f"residuals exceed the given noise: chi-square per degree of freedom {chi2_per_dof:.1f}")
    return None


def _undetermined(covariance: Covariance, unobservable: tuple[str, ...], limits: Limits) -> Note | None:
    """Two machines explain arcs that are too short for the noise as well: then the noise is the reason."""
    refusal = uncertain(covariance, limits) if unobservable in ((), (AMBIGUOUS,)) else None
    if unobservable and not refusal:
        return Note("unobservable", "; ".join(unobservable))
    return refusal
