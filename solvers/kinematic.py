"""Maximum likelihood of the full two-axis chain with every joint angle unknown. The default solver.

Gauss-Newton on the manifold, damped where a step does not descend, from the closed form. Both
noises are estimated as variance components: the squared residuals of each kind over what the fitted
unknowns leave of them.
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers import closed_form
from solvers.covariance import active_unknowns, covariance_of, marginal_covariance
from solvers.elimination import Reduced, reduce
from solvers.estimate import Estimate, Note
from solvers.likelihood import AngleModel, Linearisation, linearise, retract
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
    line = linearise(torus, angles, problem)
    sigma, damping, converged, iteration = _first_sigma(problem, line), 0.0, False, 0
    while True:
        reduced = reduce(line, model, problem, angles, sigma)
        C = marginal_covariance(reduced.H, active)
        step = _step(reduced, active, damping)
        if converged or iteration == options.max_iterations:
            break
        iteration += 1
        trial, trial_angles = retract(torus, step), angles + reduced.angle_step(step)
        trial_line = linearise(trial, trial_angles, problem)
        costs = [_cost(at, a, model, sigma) for at, a in ((line, angles), (trial_line, trial_angles))]
        if costs[1] > costs[0] * (1 + 1e-6) + 1e-6:
            damping = max(10 * damping, 1e-6)
            continue
        torus, angles, line = trial, trial_angles, trial_line
        new_sigma = _sigma(problem, line, reduced, C)
        settled = np.allclose(new_sigma, sigma, rtol=1e-3)
        converged = settled and damping == 0 and step @ reduced.H @ step < options.tolerance**2
        sigma = new_sigma
        damping = damping * 0.1 if damping > 1e-8 else 0.0
    return Estimate.of_torus(
        "kinematic",
        torus,
        angles=angles.T,
        sigma_t=sigma[0],
        sigma_r=sigma[1],
        covariance=covariance_of(torus, C),
        iterations=iteration,
        converged=converged,
    )


def fit_angles(problem: Problem, torus: Torus, iterations: int = 5) -> tuple[Array, tuple[float, float], Reduced]:
    """The most likely angles (2, N) and noise for a chain that another solver found, and the normal
    equations there; labels of held joints are taken as exact."""
    model = AngleModel.of(problem)
    angles = model.start(torus, problem)
    line = linearise(torus, angles, problem)
    sigma = _first_sigma(problem, line)
    nothing = np.zeros(6 * problem.placements + 8)
    for _ in range(iterations):
        reduced = reduce(line, model, problem, angles, sigma)
        angles = angles + reduced.angle_step(nothing)
        line = linearise(torus, angles, problem)
        sigma = _sigma(problem, line, reduced, np.zeros_like(reduced.H))
    return angles, sigma, reduce(line, model, problem, angles, sigma)


def reduce_at(problem: Problem, torus: Torus, angles: Array, sigma: tuple[float, float]) -> Reduced:
    """The normal equations at given parameters and angles (2, N)."""
    return reduce(linearise(torus, angles, problem), AngleModel.of(problem), problem, angles, sigma)


def _first_sigma(problem: Problem, line: Linearisation) -> tuple[float, float]:
    return _given_or(problem, np.sqrt((line.residual.reshape(2, -1) ** 2).mean(axis=1)))


def _sigma(problem: Problem, line: Linearisation, reduced: Reduced, C: Array) -> tuple[float, float]:
    """Both noises: squared residuals over their redundancy, which the machine's unknowns share in
    proportion to the information that they draw from each kind."""
    drawn = np.array([(C * reduced.position_information).sum(), (C * (reduced.H - reduced.position_information)).sum()])
    left = np.maximum(np.array(reduced.redundancy) - drawn, 1.0)
    estimated = np.sqrt((line.residual.reshape(2, -1) ** 2).sum(axis=1) / left)
    return _given_or(problem, estimated)


def _given_or(problem: Problem, estimated: Array) -> tuple[float, float]:
    t, r = (max(float(e), SIGMA_FLOOR) for e in estimated)
    return t if problem.sigma_t is None else problem.sigma_t, r if problem.sigma_r is None else problem.sigma_r


def _step(reduced: Reduced, active: np.ndarray, damping: float) -> Array:
    inner = reduced.H[np.ix_(active, active)]
    scale = np.sqrt(np.maximum(np.diagonal(inner), np.finfo(float).tiny))
    A = inner / np.outer(scale, scale) + (damping + 1e-15) * np.eye(len(inner))
    step = np.zeros(len(active))
    step[active] = -np.linalg.lstsq(A, reduced.g[active] / scale, rcond=1e-14)[0] / scale
    return step


def _cost(line: Linearisation, angles: Array, model: AngleModel, sigma: tuple[float, float]) -> float:
    position, rotation = (line.residual.reshape(2, -1) ** 2).sum(axis=1) / np.square(sigma)
    return float(position + rotation + (model.precision * model.reading_error(angles) ** 2).sum())
