"""What an estimate is worth: residuals, noise, observability, and whether to refuse it.

Every solver's chain is judged by the same likelihood, so that residuals can be compared.
"""

from dataclasses import dataclass

import numpy as np

from solvers import kinematic
from solvers.covariance import (
    active_unknowns,
    covariance_of,
    marginal_covariance,
    reported_jacobian,
    scaled_spectrum,
)
from solvers.elimination import normal_equations
from solvers.estimate import Covariance, Estimate, Note
from solvers.likelihood import AngleModel, linearise
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus


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
    refusal: Note | None


def assess(problem: Problem, estimate: Estimate, limits: Limits = Limits()) -> Assessment:
    """Judge an estimate of ``problem``."""
    if estimate.torus is None:
        return _assess_positions(problem, estimate, limits)
    torus = estimate.torus
    if estimate.angles is None:
        angles, at = kinematic.fit_angles(problem, torus)
        sigma = (at.sigma[0], at.sigma[1])
    else:
        angles, sigma = estimate.angles.T, (estimate.sigma_t or 0.0, estimate.sigma_r or 0.0)
        at = normal_equations(torus, angles, problem, AngleModel.of(problem), sigma)
    residual = linearise(torus, angles, problem).residual
    active = active_unknowns(torus, fix_non_orthogonality=torus.non_orthogonality == 0.0)
    values, vectors, scale = scaled_spectrum(at.H, active)
    covariance = covariance_of(torus, marginal_covariance(at.H, active))
    still = _joints_at_rest(torus, angles, sigma, limits)
    null = vectors[:, values < limits.min_relative_information * values[-1]] / scale[:, None]
    unobservable = (*still, *_in_words(torus, active, null))
    chi2 = sum(((residual[k : k + 3] / s) ** 2).sum() for k, s in zip((0, 3), sigma, strict=True))
    dof = max(sum(at.redundancy) - active.sum(), 1.0)
    return Assessment(
        angles=angles.T,
        position_residual=residual[:3].T,
        rotation_residual=residual[3:].T,
        sigma_t=sigma[0],
        sigma_r=sigma[1],
        chi2_per_dof=float(chi2 / dof),
        singular_values=values[::-1],
        unobservable=unobservable,
        refusal=_refusal(problem, sigma, chi2 / dof, covariance, unobservable, len(still), limits),
    )


def _assess_positions(problem: Problem, estimate: Estimate, limits: Limits) -> Assessment:
    """The verdict on an estimate without a chain, from its own residuals."""
    residual = estimate.residual if estimate.residual is not None else np.zeros((len(problem), 1))
    sigma = estimate.sigma_t or float(np.sqrt((residual**2).mean()))
    refusal = None
    if len(problem) < limits.min_poses:
        refusal = _too_few(problem, limits)
    elif sigma > limits.max_sigma_t_m:
        refusal = _misfit(sigma, 0.0)
    elif estimate.covariance and estimate.covariance.block("offset").size:
        refusal = _uncertain(estimate.covariance, limits)
    given = problem.sigma_t
    return Assessment(
        angles=None,
        position_residual=residual,
        rotation_residual=None,
        sigma_t=sigma,
        sigma_r=None,
        chi2_per_dof=float((residual**2).mean() / given**2) if given else 1.0,
        singular_values=np.zeros(0),
        unobservable=estimate.unobservable,
        refusal=refusal,
    )


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


def _refusal(
    problem: Problem,
    sigma: tuple[float, float],
    chi2_per_dof: float,
    covariance: Covariance,
    unobservable: tuple[str, ...],
    still: int,
    limits: Limits,
) -> Note | None:
    if len(problem) < limits.min_poses:
        return _too_few(problem, limits)
    given = problem.sigma_t is not None and problem.sigma_r is not None
    if sigma[0] > limits.max_sigma_t_m or sigma[1] > limits.max_sigma_r_rad:
        return _misfit(*sigma)
    if given and chi2_per_dof > limits.max_chi2_per_dof:
        return Note("misfit", f"residuals exceed the given noise: chi-square per degree of freedom {chi2_per_dof:.1f}")
    if unobservable:
        code = "one_axis_only" if still else "unobservable"
        return Note(code, "; ".join(unobservable))
    return _uncertain(covariance, limits)


def _uncertain(covariance: Covariance, limits: Limits) -> Note | None:
    worst = float(np.sqrt(np.linalg.eigvalsh(covariance.block("offset"))[-1]))
    if worst > limits.max_offset_sigma_m:
        return Note(
            "too_uncertain",
            f"the arcs are too short for the noise: the offset is uncertain by {worst * 1e3:.0f} mm (one sigma)",
        )
    return None


def _too_few(problem: Problem, limits: Limits) -> Note:
    return Note("too_few_poses", f"{len(problem)} poses; at least {limits.min_poses} are needed")


def _misfit(sigma_t: float, sigma_r: float) -> Note:
    return Note(
        "misfit",
        f"no C-arm of two axes explains these poses: the residuals amount to a noise of {sigma_t * 1e3:.1f} mm and "
        f"{np.degrees(sigma_r):.2f} deg; was the base moved, or is the unit or the direction of the poses wrong?",
    )
