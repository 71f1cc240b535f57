"""What an estimate is worth: residuals, noise, observability, and whether to refuse it.

Every solver's chain is judged by the same likelihood, so that residuals can be compared.
"""

from dataclasses import dataclass

import numpy as np

from solvers import closed_form, kinematic
from solvers.covariance import (
    active_unknowns,
    covariance_of,
    marginal_covariance,
    reported_jacobian,
    scaled_spectrum,
)
from solvers.diagnose import base_moved_at
from solvers.elimination import normal_equations
from solvers.estimate import Covariance, Estimate, Note
from solvers.likelihood import AngleModel, linearise
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus

AMBIGUOUS = (
    "two machines explain the poses equally well, for instance with the angular and the orbital axis exchanged; "
    "say which joint moves in each sweep, or record one more sweep"
)


@dataclass(frozen=True)
class Limits:
    """Where a result is refused."""

    min_poses: int = 6
    """Fewest poses."""
    max_sigma_t_m: float = 0.010
    """Estimated position noise above which the residuals are a misfit, not noise."""
    max_sigma_r_rad: float = float(np.radians(2.0))
    """Estimated orientation noise above which the residuals are a misfit."""
    max_chi2_per_dof: float = 2.0
    """Misfit above this, where the noise is given."""
    max_offset_sigma_m: float = 0.020
    """Largest one-sigma of the offset in any direction."""
    min_relative_information: float = 1e-9
    """Least eigenvalue of the scaled information that counts as information."""
    max_rejected_share: float = 0.7
    """Largest share of poses that may be rejected."""
    silent_rejected_share: float = 0.02
    """Share of rejected poses from which on a warning says so."""
    max_moved_share: float = 0.3
    """Largest share of poses that may belong to another place of the base."""
    min_spread_sigmas: float = 4.0
    """A joint moves if its angle spreads by more than so many standard deviations of one pose."""


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
    singular_values: Array
    """Of the information scaled to a unit diagonal, largest first; empty where there is no chain."""
    unobservable: tuple[str, ...]
    """In words."""
    notes: tuple[Note, ...]
    """What the residuals and the rejected poses show."""
    refusal: Note | None


def assess(problem: Problem, estimate: Estimate, limits: Limits = Limits()) -> Assessment:
    """Judge an estimate of ``problem`` by the poses that it used; the rows of the others are NaN."""
    used = np.ones(len(problem), dtype=bool) if estimate.used is None else estimate.used
    part = problem if used.all() else problem.select(used)
    if estimate.torus is None or len(part) < limits.min_poses:
        return _assess_positions(part, estimate, used, limits)
    torus = estimate.torus
    if estimate.angles is None:
        angles, at = kinematic.fit_angles(part, torus)
        sigma = (at.sigma[0], at.sigma[1])
    else:
        angles, sigma = estimate.angles.T[:, used], (estimate.sigma_t or 0.0, estimate.sigma_r or 0.0)
        at = normal_equations(torus, angles, part, AngleModel.of(part), sigma)
    residual = linearise(torus, angles, part).residual
    active = active_unknowns(part, fix_non_orthogonality=torus.non_orthogonality == 0.0)
    values, vectors, scale = scaled_spectrum(at.H, active)
    covariance = covariance_of(torus, marginal_covariance(at.H, active))
    still = _joints_at_rest(torus, angles, sigma, limits)
    null = vectors[:, values < limits.min_relative_information * values[-1]] / scale[:, None]
    unobservable = (*still, *_in_words(torus, active, null))
    if not still and closed_form.ambiguous(part):
        unobservable += (AMBIGUOUS,)
    chi2_per_dof = at.cost / max(sum(at.redundancy) - active.sum(), 1.0)
    moved_at = base_moved_at(problem, estimate)
    return Assessment(
        angles=_spread(angles.T, used),
        position_residual=_spread(residual[:3].T, used),
        rotation_residual=_spread(residual[3:].T, used),
        sigma_t=sigma[0],
        sigma_r=sigma[1],
        chi2_per_dof=float(chi2_per_dof),
        singular_values=values[::-1],
        unobservable=unobservable,
        notes=_rejections(used, moved_at, limits),
        refusal=_misfits(part, sigma, chi2_per_dof, still, limits)
        or _too_many_rejected(used, moved_at, limits)
        or _undetermined(covariance, unobservable, limits),
    )


def _assess_positions(part: Problem, estimate: Estimate, used: np.ndarray, limits: Limits) -> Assessment:
    """The verdict on an estimate without a chain, from its own residuals."""
    residual = estimate.residual if estimate.residual is not None else np.zeros((len(part), 1))
    sigma = estimate.sigma_t or float(np.sqrt((residual**2).mean()))
    refusal = None
    if len(part) < limits.min_poses:
        refusal = Note("too_few_poses", f"{len(part)} usable poses; at least {limits.min_poses} are needed")
    elif estimate.major_radius is None and estimate.unobservable:
        refusal = Note("unobservable", "; ".join(estimate.unobservable))
    elif sigma > limits.max_sigma_t_m:
        refusal = _misfit(sigma, 0.0)
    elif estimate.covariance and estimate.covariance.block("offset").size:
        refusal = _uncertain(estimate.covariance, limits)
    given = part.sigma_t
    return Assessment(
        angles=None,
        position_residual=_spread(residual, used),
        rotation_residual=None,
        sigma_t=sigma,
        sigma_r=None,
        chi2_per_dof=float((residual**2).mean() / given**2) if given else 1.0,
        singular_values=np.zeros(0),
        unobservable=estimate.unobservable,
        notes=(),
        refusal=refusal,
    )


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


def _joints_at_rest(torus: Torus, angles: Array, sigma: tuple[float, float], limits: Limits) -> tuple[str, ...]:
    """Sentences for the joints whose angle does not spread beyond the noise of one pose."""
    lever = max(float(np.linalg.norm(torus.offset)), 0.05)
    noise = min(sigma[1], sigma[0] / lever) if min(sigma) > 0 else max(sigma)
    moving = [np.sqrt(max(0.0, 1 - abs(np.exp(1j * a).mean()) ** 2)) > limits.min_spread_sigmas * noise for a in angles]
    if moving == [True, True]:
        return ()
    if moving == [False, False]:
        return ("no motion about either axis: both axes and the offset are unknown",)
    name = "orbital" if moving[0] else "angular"
    return (f"no {name} motion: the {name} axis and the offset along the other axis are unknown",)


def _in_words(torus: Torus, active: np.ndarray, null: Array) -> tuple[str, ...]:
    """Which reported quantities each null direction (columns of ``null``) moves."""
    J, names = reported_jacobian(torus)
    sentences = []
    for x in null.T:
        change = dict(zip(names, J[:, active] @ x, strict=True))
        offset = np.array([change[f"offset_sensor_pivot_{k}"] for k in "xyz"])
        along = abs(offset @ torus.orbital_axis)
        moved = {
            "the offset along the orbital axis": along,
            "the offset across the orbital axis": np.linalg.norm(offset - torus.orbital_axis * along),
            "the major radius": abs(change["major_radius"]),
            "the torus centre": max(abs(v) for k, v in change.items() if k.startswith("torus_center")),
            "the angular axis": max(abs(v) for k, v in change.items() if k.startswith("angular_axis")),
            "the orbital axis": max(abs(v) for k, v in change.items() if k.startswith("orbital_axis")),
            "the non-orthogonality": abs(change["axis_non_orthogonality"]),
        }
        largest = max(moved.values())
        sentences.append("undetermined together: " + ", ".join(k for k, v in moved.items() if v > 0.1 * largest))
    return tuple(sentences)


def _misfits(
    part: Problem, sigma: tuple[float, float], chi2_per_dof: float, still: tuple[str, ...], limits: Limits
) -> Note | None:
    if still:
        return Note("one_axis_only", "; ".join(still))
    if sigma[0] > limits.max_sigma_t_m or sigma[1] > limits.max_sigma_r_rad:
        return _misfit(*sigma)
    given = part.sigma_t is not None and part.sigma_r is not None
    if given and chi2_per_dof > limits.max_chi2_per_dof:
        return Note("misfit", f"residuals exceed the given noise: chi-square per degree of freedom {chi2_per_dof:.1f}")
    return None


def _undetermined(covariance: Covariance, unobservable: tuple[str, ...], limits: Limits) -> Note | None:
    if unobservable:
        return Note("unobservable", "; ".join(unobservable))
    return _uncertain(covariance, limits)


def _uncertain(covariance: Covariance, limits: Limits) -> Note | None:
    worst = float(np.sqrt(np.linalg.eigvalsh(covariance.block("offset"))[-1]))
    if worst > limits.max_offset_sigma_m:
        return Note(
            "too_uncertain",
            f"the arcs are too short for the noise: the offset is uncertain by {worst * 1e3:.0f} mm (one sigma)",
        )
    return None


def _misfit(sigma_t: float, sigma_r: float) -> Note:
    return Note(
        "misfit",
        f"no C-arm of two axes explains these poses: the residuals amount to a noise of {sigma_t * 1e3:.1f} mm and "
        f"{np.degrees(sigma_r):.2f} deg; was the base moved, or is the unit or the direction of the poses wrong?",
    )
