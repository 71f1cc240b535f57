"""Maximum likelihood of the full two-axis chain with every joint angle unknown. The default solver.

Gauss-Newton on the manifold, damped where a step does not descend. It starts from the closed form on
the poses that agree with one C-arm, settles on some of the poses first, and ends on all. Both noises
are estimated as variance components: the squared residuals of each kind over what the fitted unknowns
leave of them. A pose farther off than `OUTLIER_PROBABILITY` allows is given no weight, and may come back.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from solvers.estimate import MEANINGLESS_RAD, Correlation, Estimate, Note
from solvers.likelihood.anisotropy import noise_shape
from solvers.likelihood.correlation import Stretches, correlation_of, with_correlation
from solvers.likelihood.covariance import active_unknowns, covariance_of, marginal_covariance
from solvers.likelihood.elimination import Reduced, normal_equations
from solvers.likelihood.labels import unlabelled, weighed
from solvers.likelihood.linearise import AngleModel, linearise, retract
from solvers.likelihood.slipping import let_go
from solvers.problem import ANGULAR, ORBITAL, Problem
from solvers.se3 import Array
from solvers.start import robust
from solvers.start.axes import axes_of
from solvers.torus import Torus, near_median

SIGMA_FLOOR = 1e-7
"""Least noise assumed, m and rad: well below any tracker's resolution, far above rounding."""
LEAST_RATIO = 1e-4
"""Least ratio assumed of one noise to the other at a lever of a metre: its square, the weight of the worse kind of
data, stays far above rounding, and data so much better than the other kind are exact."""
OUTLIER_PROBABILITY = 1e-5
"""Share of sound poses that the noise alone sends beyond the bound: 5.3 to 5.9 sigma, by degrees of freedom."""
OUTLIER_BOUND = np.array([33.107056816829, 30.856189940435904, 28.473255424006034])
"""The chi-square that is exceeded with that probability, at 6, 5 and 4 degrees of freedom."""
LEAST_CHANGE = 0.1
"""Ratio of a variance to the one before below which both are taken from their own residuals alone."""
COARSE = 1000
"""Poses on which the fit settles before all take part."""


@dataclass(frozen=True)
class Options:
    """Options of the maximum-likelihood solver."""

    fix_non_orthogonality: bool | None = None
    """True: take the axes as perpendicular. False: estimate epsilon. None: estimate it where the data
    determine it to `max_non_orthogonality_sigma_rad`, else take 0 and say so."""
    max_non_orthogonality_sigma_rad: float = float(np.radians(0.5))
    """One-sigma of epsilon up to which it is estimated; real machines have 0.2 to 1 degree of it."""
    reject_outliers: bool = True
    """Give no weight to poses that the noise does not explain."""
    seed: int = 0
    """Seed of the samples from which the agreeing poses are found."""
    max_iterations: int = field(default=40, metadata={"min": 1, "max": 10_000})
    """Steps after which the solver gives up and says so."""
    tolerance: float = 1e-2
    """A step shorter than this many standard deviations is the last; what it leaves is far smaller still."""
    sigma_tolerance: float = 3e-3
    """So does, together with it, a relative change of the estimated noise below this."""


def solve(problem: Problem, options: Options = Options()) -> Estimate:
    """The most likely chain with its angles, noise and covariance. Needs orientations."""
    used = np.ones(len(problem), dtype=bool)
    if options.reject_outliers:
        used = robust.inliers(problem, options.seed)
    problem, slips = let_go(problem, _start(problem, used, bool(options.fix_non_orthogonality)), used)
    estimate = _shaped(problem, _from_coarse(problem, used, options, bool(options.fix_non_orthogonality)), options)
    sigma = _sigma_of_epsilon(estimate)
    if options.fix_non_orthogonality is None and sigma > options.max_non_orthogonality_sigma_rad:
        fixed = _from_coarse(replace(problem, shape=estimate.shape), used, options, True)
        estimate = replace(fixed, notes=(*fixed.notes, _fixed(sigma)))
    return replace(estimate, soft=problem.soft, notes=(*estimate.notes, *slips))


def _shaped(problem: Problem, estimate: Estimate, options: Options) -> Estimate:
    """The estimate with noise that differs by the tracker's axes where the residuals show that it does."""
    found, used = _parts_of(estimate), estimate.used
    if problem.sigma_t is not None or problem.sigma_r is not None or found is None or used is None:
        return estimate
    torus, angles, sigma = found
    shape = noise_shape(torus, angles, problem, sigma, used, (estimate.correlation or Correlation()).longest)
    if shape is None:
        return estimate
    fixed = torus.non_orthogonality == 0.0
    again = _weighing_labels(replace(problem, shape=shape), torus, options, fixed, used, sigma)
    return again if again.converged else estimate


def _parts_of(estimate: Estimate) -> tuple[Torus, Array, tuple[float, float]] | None:
    """Chain, angles (2, N) and noise (m, rad) of an estimate that has them."""
    if not (estimate.torus and estimate.sigma_t and estimate.sigma_r) or estimate.angles is None:
        return None
    return estimate.torus, estimate.angles.T, (estimate.sigma_t, estimate.sigma_r)


def _fixed(sigma: float) -> Note:
    """What there is to say of a non-orthogonality that is taken as 0, as it is known to ``sigma`` (rad) only."""
    words = "the motion does not determine the non-orthogonality of the axes"
    if sigma <= MEANINGLESS_RAD:
        degrees = np.degrees(sigma)
        words = f"the motion determines the non-orthogonality of the axes only to {degrees:.1f} deg (one sigma)"
    return Note("non_orthogonality_fixed", f"{words}; it was taken as 0")


def _from_coarse(problem: Problem, used: np.ndarray, options: Options, fix_non_orthogonality: bool) -> Estimate:
    """The fit to all poses, started from the fit to some where there are many."""
    torus, sigma = _start(problem, used, fix_non_orthogonality), None
    if options.reject_outliers:
        used = used & _agrees_with_labels(problem, torus)
    some = _some(problem, used)
    if len(problem) > 2 * COARSE and some.placements == problem.placements:
        coarse = refine(unlabelled(some), torus, replace(options, reject_outliers=False), fix_non_orthogonality)
        if coarse.torus and coarse.sigma_t and coarse.sigma_r:
            torus, sigma = coarse.torus, (coarse.sigma_t, coarse.sigma_r)
    return _weighing_labels(problem, torus, options, fix_non_orthogonality, used, sigma)


def _weighing_labels(
    problem: Problem,
    torus: Torus,
    options: Options,
    fix_non_orthogonality: bool,
    used: np.ndarray,
    sigma: tuple[float, float] | None,
) -> Estimate:
    """`refine`; where labels are readings, first without them, and then with the weight that this fit gives them."""
    if not problem.label_read.any():
        return refine(problem, torus, options, fix_non_orthogonality, used, sigma)
    blank = unlabelled(problem)
    first = refine(blank, torus, options, fix_non_orthogonality, used, sigma)
    if (parts := _parts_of(first)) is None:
        raise ValueError("the fit of a chain lacks its noise or angles")
    torus, angles, sigma = parts
    at = normal_equations(torus, angles, blank, AngleModel.of(blank), sigma, first.used)
    labels = weighed(problem, at, angles, marginal_covariance(at.H, active_unknowns(blank, fix_non_orthogonality)))
    fit = refine(labels.problem, torus, options, fix_non_orthogonality, first.used, sigma)
    return replace(fit, sigma_label=labels.problem.sigma_label, notes=labels.notes)


def _start(problem: Problem, used: np.ndarray, fix_non_orthogonality: bool) -> Torus:
    """The closed form of some of the used poses."""
    return axes_of(_some(problem, used), fix_non_orthogonality).torus(problem.select(used))


def _some(problem: Problem, used: np.ndarray) -> Problem:
    """About `COARSE` of the used poses."""
    agreeing = np.flatnonzero(used)
    return problem.select(agreeing[:: max(1, len(agreeing) // COARSE)])


def _agrees_with_labels(problem: Problem, torus: Torus) -> np.ndarray:
    """(N,) mask: no held joint's label is far from the angle that the orientation shows, as labels go."""
    agrees = np.ones(len(problem), dtype=bool)
    off = torus.angles(problem) - problem.label
    for joint in (ANGULAR, ORBITAL):
        known = np.flatnonzero(np.isfinite(off[:, joint]) & (problem.held[:, joint] >= 0))
        if known.size:
            agrees[known] &= near_median(np.angle(np.exp(1j * off[known, joint])))
    return agrees


def _sigma_of_epsilon(estimate: Estimate) -> float:
    return float(estimate.covariance.sigma("axis_non_orthogonality")[0]) if estimate.covariance else 0.0


def refine(
    problem: Problem,
    torus: Torus,
    options: Options,
    fix_non_orthogonality: bool,
    used: np.ndarray | None = None,
    sigma_given: tuple[float, float] | None = None,
) -> Estimate:
    """Maximum likelihood from a given start, whose zeros and senses of the angles are kept.

    ``used`` (N,) are the poses believed at the start, ``sigma_given`` the noise (m, rad) to start with.
    """
    model = AngleModel.of(problem)
    active = active_unknowns(problem, fix_non_orthogonality)
    used = np.ones(len(problem), dtype=bool) if used is None else used
    bound = OUTLIER_BOUND[model.free.sum(axis=0)] if options.reject_outliers else np.inf
    angles = model.start(torus, problem, used)
    sigma = sigma_given or first_sigma(problem, torus, angles, used)
    at = normal_equations(torus, angles, problem, model, sigma, used)
    damping, converged, iteration = 0.0, False, 0
    trusted_from = 3 if sigma_given is None else 1
    while not converged and iteration < options.max_iterations:
        iteration += 1
        step = _step(at, active, damping)
        new_sigma = next_sigma(problem, at, marginal_covariance(at.H, active), step)
        settled = np.allclose(new_sigma, sigma, rtol=options.sigma_tolerance)
        believed = at.distance2 <= bound if settled or iteration >= trusted_from else used
        changed = bool((believed != used).any())
        trial, trial_angles = retract(torus, step), angles + at.angle_step(step)
        converged = settled and not changed and damping == 0 and step @ at.H @ step < options.tolerance**2
        if not converged:
            there = normal_equations(trial, trial_angles, problem, model, new_sigma, believed)
            if not changed and not there.cost <= at.cost_at(new_sigma) * (1 + 1e-6) + 1e-6:
                damping = max(10 * damping, 1e-6)
                continue
            at, used = there, believed
            damping = damping * 0.1 if damping > 1e-8 else 0.0
        torus, angles, sigma = trial, trial_angles, new_sigma
    correlation = correlation_of(at.left, Stretches.of(problem, used), float(active.sum()))
    return Estimate.of_torus(
        "kinematic",
        torus,
        shape=problem.shape,
        angles=angles.T,
        sigma_t=sigma[0],
        sigma_r=sigma[1],
        used=used,
        covariance=covariance_of(torus, correlated_covariance(at, active, correlation)),
        correlation=correlation,
        iterations=iteration,
        converged=converged,
    )


def correlated_covariance(at: Reduced, active: np.ndarray, correlation: Correlation) -> Array:
    """(D, D) of the unknowns, with noise that lasts; readings are taken as independent."""
    rotation_information = at.H - at.position_information - at.reading_information
    return with_correlation(
        marginal_covariance(at.H, active),
        (at.position_information, rotation_information),
        (correlation.position, correlation.rotation),
    )


def fit_angles(problem: Problem, torus: Torus) -> tuple[Array, Reduced]:
    """The most likely angles (2, N) for a chain that another solver found, and the normal equations there
    with the noise that the residuals show; labels that are readings are weighed by what they show."""
    if problem.label_read.any():
        angles, at = _fitted_angles(unlabelled(problem), torus)
        problem = weighed(problem, at, angles, np.zeros_like(at.H)).problem
    return _fitted_angles(problem, torus)


def _fitted_angles(problem: Problem, torus: Torus, iterations: int = 4) -> tuple[Array, Reduced]:
    model = AngleModel.of(problem)
    angles = model.start(torus, problem)
    at = normal_equations(torus, angles, problem, model, first_sigma(problem, torus, angles))
    nothing = np.zeros(len(at.g))
    for _ in range(iterations):
        sigma = next_sigma(problem, at, np.zeros_like(at.H), nothing)
        angles = angles + at.angle_step(nothing)
        at = normal_equations(torus, angles, problem, model, sigma)
    return angles, at


def first_sigma(problem: Problem, torus: Torus, angles: Array, used: np.ndarray | None = None) -> tuple[float, float]:
    """A first guess of both noises from the residuals of at most about a thousand of the ``used`` poses."""
    some = np.arange(len(problem)) if used is None else np.flatnonzero(used)
    some = some[:: max(1, len(some) // COARSE)]
    part = problem.select(some)
    residual = linearise(torus, angles[:, some], part).residual
    if part.scale is not None:
        residual = residual / np.repeat(part.scale, 3, axis=0)
    return _given_or(problem, np.sqrt((residual.reshape(2, -1) ** 2).mean(axis=1)))


def next_sigma(problem: Problem, at: Reduced, C: Array, step: Array) -> tuple[float, float]:
    """Both noises from the squared residuals after the step and their redundancies, of which the machine's unknowns
    take shares in proportion to the information that they draw from each kind.

    Helmert's equations: of the residuals of one kind a part stems from the other's noise, since the angles weigh both.
    """
    rotation_information = at.H - at.position_information - at.reading_information
    drawn = np.array([(C * at.position_information).sum(), (C * rotation_information).sum()])
    left = np.maximum(np.array(at.redundancy) - drawn, 1.0)
    squares = np.array(at.squares_after(step))
    alone = squares / left
    if len(at.sigma) == 1:
        return _given_or(problem, np.sqrt(alone))
    before = np.square(at.sigma)
    known = [s is not None for s in (problem.sigma_t, problem.sigma_r)]
    A = np.diag(left - at.exchanged) + at.exchanged * (1 - np.eye(2))
    A[known] = np.eye(2)[known]
    ratio = np.linalg.solve(A, np.where(known, 1.0, squares / before))
    variance = np.where((ratio > LEAST_CHANGE).all(), ratio * before, alone)
    return _given_or(problem, np.sqrt(variance))


def _given_or(problem: Problem, estimated: Array) -> tuple[float, float]:
    t, r = (float(max(e, SIGMA_FLOOR, LEAST_RATIO * other)) for e, other in (estimated, estimated[::-1]))
    return t if problem.sigma_t is None else problem.sigma_t, r if problem.sigma_r is None else problem.sigma_r


def _step(at: Reduced, active: np.ndarray, damping: float) -> Array:
    inner = at.H[np.ix_(active, active)]
    scale = np.sqrt(np.maximum(np.diagonal(inner), 1e-150))
    A = inner / np.outer(scale, scale) + (damping + 1e-15) * np.eye(len(inner))
    step = np.zeros(len(active))
    step[active] = -np.linalg.lstsq(A, at.g[active] / scale, rcond=1e-14)[0] / scale
    return step
