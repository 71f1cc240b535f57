"""Maximum likelihood of the full two-axis chain with every joint angle unknown. The default solver.

Gauss-Newton on the manifold, damped where a step does not descend, from the closed form. Both
noises are estimated as variance components: the squared residuals of each kind over what the fitted
unknowns leave of them.
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers import closed_form
from solvers.covariance import active_unknowns, covariance_of, marginal_covariance
from solvers.elimination import Reduced, normal_equations
from solvers.estimate import Estimate, Note
from solvers.likelihood import AngleModel, linearise, retract
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus

SIGMA_FLOOR = 1e-7
"""Least noise assumed, m and rad: well below any tracker's resolution, far above rounding."""


@dataclass(frozen=True)
class Options:
    """Options of the maximum-likelihood solver."""

    fix_non_orthogonality: bool | None = None
    """True: take the axes as perpendicular. False: estimate epsilon. None: estimate it where the data
    determine it to `max_non_orthogonality_sigma_rad`, else take 0 and say so."""
    max_non_orthogonality_sigma_rad: float = float(np.radians(0.5))
    """One-sigma of epsilon up to which it is estimated; real machines have 0.2 to 1 degree of it."""
    max_iterations: int = 40
    """Steps after which the solver gives up and says so."""
    tolerance: float = 1e-3
    """A step shorter than this many standard deviations ends the iteration."""
    sigma_tolerance: float = 3e-3
    """So does, together with it, a relative change of the estimated noise below this."""


def solve(problem: Problem, options: Options = Options()) -> Estimate:
    """The most likely chain with its angles, noise and covariance. Needs orientations."""
    fixed = bool(options.fix_non_orthogonality)
    estimate = refine(problem, _start(problem, fixed), options, fixed)
    if options.fix_non_orthogonality is None:
        sigma = _sigma_of_epsilon(estimate)
        if sigma > options.max_non_orthogonality_sigma_rad:
            note = Note(
                "non_orthogonality_fixed",
                f"the motion determines the non-orthogonality of the axes only to {np.degrees(sigma):.1f} deg "
                "(one sigma); it was taken as 0",
            )
            return replace(refine(problem, _start(problem, True), options, True), notes=(note,))
    return estimate


def _start(problem: Problem, fixed: bool) -> Torus:
    return closed_form.axes_of(problem, closed_form.Options(fixed)).torus(problem)


def _sigma_of_epsilon(estimate: Estimate) -> float:
    return float(estimate.covariance.sigma("axis_non_orthogonality")[0]) if estimate.covariance else 0.0


def refine(problem: Problem, torus: Torus, options: Options, fix_non_orthogonality: bool) -> Estimate:
    """Maximum likelihood from a given start, whose zeros and senses of the angles are kept."""
    model = AngleModel.of(problem)
    active = active_unknowns(torus, fix_non_orthogonality)
    angles = model.start(torus, problem)
    sigma = first_sigma(problem, torus, angles)
    at = normal_equations(torus, angles, problem, model, sigma)
    damping, converged, iteration = 0.0, False, 0
    while not converged and iteration < options.max_iterations:
        iteration += 1
        C = marginal_covariance(at.H, active)
        step = _step(at, active, damping)
        new_sigma = next_sigma(problem, at, C, step)
        trial, trial_angles = retract(torus, step), angles + at.angle_step(step)
        there = normal_equations(trial, trial_angles, problem, model, new_sigma)
        if there.cost > at.cost_at(new_sigma) * (1 + 1e-6) + 1e-6:
            damping = max(10 * damping, 1e-6)
            continue
        settled = np.allclose(new_sigma, sigma, rtol=options.sigma_tolerance)
        converged = settled and damping == 0 and step @ at.H @ step < options.tolerance**2
        torus, angles, sigma, at = trial, trial_angles, new_sigma, there
        damping = damping * 0.1 if damping > 1e-8 else 0.0
    return Estimate.of_torus(
        "kinematic",
        torus,
        angles=angles.T,
        sigma_t=sigma[0],
        sigma_r=sigma[1],
        covariance=covariance_of(torus, marginal_covariance(at.H, active)),
        iterations=iteration,
        converged=converged,
    )


def fit_angles(problem: Problem, torus: Torus, iterations: int = 4) -> tuple[Array, Reduced]:
    """The most likely angles (2, N) for a chain that another solver found, and the normal equations there
    with the noise that the residuals show; labels of held joints are taken as exact."""
    model = AngleModel.of(problem)
    angles = model.start(torus, problem)
    at = normal_equations(torus, angles, problem, model, first_sigma(problem, torus, angles))
    nothing = np.zeros(len(at.g))
    for _ in range(iterations):
        sigma = next_sigma(problem, at, np.zeros_like(at.H), nothing)
        angles = angles + at.angle_step(nothing)
        at = normal_equations(torus, angles, problem, model, sigma)
    return angles, at


def first_sigma(problem: Problem, torus: Torus, angles: Array) -> tuple[float, float]:
    """A first guess of both noises from the residuals of at most about a thousand poses."""
    some = slice(None, None, max(1, len(problem) // 1000))
    residual = linearise(torus, angles[:, some], problem.select(some)).residual
    return _given_or(problem, np.sqrt((residual.reshape(2, -1) ** 2).mean(axis=1)))


def next_sigma(problem: Problem, at: Reduced, C: Array, step: Array) -> tuple[float, float]:
    """Both noises: squared residuals after the step over their redundancy, of which the machine's unknowns
    take shares in proportion to the information that they draw from each kind."""
    drawn = np.array([(C * at.position_information).sum(), (C * (at.H - at.position_information)).sum()])
    left = np.maximum(np.array(at.redundancy) - drawn, 1.0)
    return _given_or(problem, np.sqrt(np.array(at.squares_after(step)) / left))


def _given_or(problem: Problem, estimated: Array) -> tuple[float, float]:
    t, r = (max(float(e), SIGMA_FLOOR) for e in estimated)
    return t if problem.sigma_t is None else problem.sigma_t, r if problem.sigma_r is None else problem.sigma_r


def _step(at: Reduced, active: np.ndarray, damping: float) -> Array:
    inner = at.H[np.ix_(active, active)]
    scale = np.sqrt(np.maximum(np.diagonal(inner), np.finfo(float).tiny))
    A = inner / np.outer(scale, scale) + (damping + 1e-15) * np.eye(len(inner))
    step = np.zeros(len(active))
    step[active] = -np.linalg.lstsq(A, at.g[active] / scale, rcond=1e-14)[0] / scale
    return step
