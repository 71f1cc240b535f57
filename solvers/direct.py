"""The full pivot-on-locus energy, minimised directly.

CasADi states the residuals of one pose in a locus' ambient coordinates and differentiates them;
the products JTJ and JTe of a pose, mapped over a fixed number of poses and summed, are one compiled
function for each locus, built once, the poses being its parameters. Gauss-Newton with Levenberg's
damping runs in the tangent space.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from solvers import decomposed, loci
from solvers.estimate import Correlation, Covariance, Estimate
from solvers.likelihood.correlation import Stretches, scores_time
from solvers.loci import Locus, SolvedLocus, TwoAxisLocus
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.start import robust
from solvers.start.axes import axes_of

CHUNK = 1008
"""Poses that one call of the mapped function takes; the last chunk is padded with weight 0."""

LEAST_DAMPING = 1e-9
"""Relative to a unit diagonal: too small to slow a determined direction, large enough that rounding does
not drive the solver along an undetermined one."""

UNSEEN = 1e-150
"""Least second derivative of the energy that counts: its inverse and what is made of it stay finite."""


@dataclass(frozen=True)
class Options:
    """Options of the direct solver."""

    locus: str = "circle"
    """circle (a C-arm), point (a pointer pivoted about a fixed point), or the name of another locus."""
    gauge: str = "tangent"
    """tangent: the pivot is the foot of the common perpendicular. published: the energy of the paper
    as it stands, which leaves the offset free along the orbital axis; for comparison."""
    fix_non_orthogonality: bool = True
    """Take the axes as perpendicular instead of estimating epsilon."""
    start: str = "auto"
    """auto: decomposed where labelled sweeps allow it, else closed_form; or one of these names."""
    shift_start_m: float = 0.0
    """Move the start along the orbital axis by so much, to see what the gauge is worth."""
    lever_m: float | None = None
    """Length that turns the angle between the axes into a distance; None: that of the starting offset."""
    reject_outliers: bool = True
    """Leave out the poses that do not agree with one C-arm, or of a point with one fixed point."""
    seed: int = 0
    """Seed of the samples from which the agreeing poses are found."""
    max_iterations: int = field(default=100, metadata={"min": 1, "max": 10_000})
    """Steps after which the solver gives up and says so."""


def solve(problem: Problem, options: Options = Options()) -> Estimate:
    """Minimise the energy of the chosen locus. Needs orientations.

    Raises ValueError for an unknown locus, gauge or start.
    """
    chosen = _locus(options)
    if isinstance(chosen, SolvedLocus):
        return chosen.solve(problem, options.seed, options.reject_outliers)
    used = np.ones(len(problem), dtype=bool)
    if options.reject_outliers and isinstance(chosen, TwoAxisLocus):
        used = robust.inliers(problem, options.seed)
        problem = problem if used.all() else problem.select(used)
    theta = _start(problem, chosen, options)
    lever = options.lever_m or max(float(np.linalg.norm(theta[0, chosen.own :][-7:-4])), 0.1)
    return replace(minimise(problem, chosen, theta, lever, options.max_iterations), used=used)


def minimise(problem: Problem, chosen: Locus, theta: Array, lever: float, max_iterations: int) -> Estimate:
    """Gauss-Newton with Levenberg's damping from ``theta`` (P, size)."""
    energy = _Energy(problem, chosen, lever)
    damping, converged, iteration = LEAST_DAMPING, False, 0
    at = energy.normal_equations(theta)
    while not converged and iteration < max_iterations:
        iteration += 1
        scale = np.sqrt(np.maximum(at.H.diagonal(), 1e-12 * at.H.diagonal().max()))
        A = at.H / np.outer(scale, scale) + damping * np.eye(len(at.H))
        step = -np.linalg.solve(A, at.g / scale) / scale
        trial = _retract(chosen, theta, step)
        there = energy.normal_equations(trial)
        gain = at.energy - there.energy
        if gain < 0:
            damping *= 10
            converged = damping > 1e6 or -gain <= 1e-12 * at.energy
        else:
            theta, at = trial, there
            damping = max(damping * 0.1, LEAST_DAMPING)
            converged = bool(gain <= 1e-9 * at.energy or np.abs(step).max() < 1e-12)
    return _estimate(problem, chosen, energy, theta, iteration, converged)


def _estimate(
    problem: Problem, chosen: Locus, energy: "_Energy", theta: Array, iteration: int, converged: bool
) -> Estimate:
    """The answer with the residuals of the locus and a covariance that trusts the residuals alone.

    inv(H) (sum g_i g_iT) inv(H) with g_i the gradient of one pose holds whatever mixture of position and
    rotation noise made the residuals; it is scaled by N / (N - unknowns / residuals of a pose) and by the
    correlation time of the g_i.
    """
    H, scores, residual = energy.scores(theta)
    time = scores_time(scores, Stretches.of(problem))
    spread = np.sqrt(np.maximum(H.diagonal(), UNSEEN))
    values, vectors = np.linalg.eigh(H / np.outer(spread, spread))
    inverse = ((vectors / np.maximum(values, 1e-15)) @ vectors.T) / np.outer(spread, spread)
    free = max(len(problem) - len(H) / residual.shape[1], 1.0)
    names, J = chosen.reported(theta)
    covariance = Covariance(names, J @ inverse @ (scores.T @ scores) @ inverse @ J.T * (time * len(problem) / free))
    return chosen.estimate(
        theta,
        problem,
        null_direction_sensor=vectors[:, 0] / spread,
        residual=residual,
        covariance=covariance,
        correlation=Correlation(time, time),
        sigma_t=float(np.sqrt((residual**2).sum() / max(residual.size - len(H), 1))),
        iterations=iteration,
        converged=converged,
    )


def _locus(options: Options) -> Locus:
    if options.gauge not in ("tangent", "published"):
        raise ValueError(f"gauge {options.gauge!r} is unknown; it is one of tangent, published")
    if options.locus == "circle":
        if options.gauge == "published":
            return loci.locus("published_circle")
        return loci.locus("circle", fix_non_orthogonality=options.fix_non_orthogonality)
    try:
        return loci.locus(options.locus)
    except KeyError:
        known = ", ".join(loci.by_option(loci.locus_names()))
        raise ValueError(f"locus {options.locus!r} is unknown; it is one of {known}") from None


def _start(problem: Problem, chosen: Locus, options: Options) -> Array:
    if not isinstance(chosen, TwoAxisLocus):
        return chosen.start(problem)
    if options.start not in ("auto", "closed_form", "decomposed"):
        raise ValueError(f"start {options.start!r} is unknown; it is one of auto, closed_form, decomposed")
    use_sweeps = decomposed.has_sweeps(problem) if options.start == "auto" else options.start == "decomposed"
    if use_sweeps:
        axes = decomposed.axes_of(problem, decomposed.Options(options.fix_non_orthogonality, iterations=0))
    else:
        axes = axes_of(problem, options.fix_non_orthogonality)
    return chosen.theta(replace(axes, offset=axes.offset + options.shift_start_m * axes.orbital_axis))


@dataclass(frozen=True, eq=False)
class _NormalEquations:
    H: Array
    g: Array
    energy: float


class _Energy:
    """The energy of a problem's poses in the tangent space of all unknowns, summed chunk by chunk."""

    def __init__(self, problem: Problem, chosen: Locus, lever: float):
        self._problem, self._chosen = problem, chosen
        self._lever = np.array([lever])
        self._chunks = [_chunks(problem, k) for k in range(problem.placements)]
        self._function, rows = _rows_of_chunk(chosen)
        self._buffer, self._evaluate = self._function.buffer()
        self._rows = np.empty((CHUNK, chosen.size + 1, rows))

    def normal_equations(self, theta: Array) -> _NormalEquations:
        """H (k, k), gradient (k,) and the energy, m^2, at theta (P, size)."""
        bases, columns, size = _layout(self._chosen, theta)
        H, g, energy = np.zeros((size, size)), np.zeros(size), 0.0
        for k, chunks in enumerate(self._chunks):
            M = np.zeros((self._chosen.size + 1,) * 2)
            for chunk in chunks:
                Je = self._linearised(theta[k], chunk).swapaxes(1, 2).reshape(-1, self._chosen.size + 1)
                M += Je.T @ Je
            H[np.ix_(columns[k], columns[k])] += bases[k].T @ M[:-1, :-1] @ bases[k]
            g[columns[k]] += bases[k].T @ M[:-1, -1]
            energy += float(M[-1, -1])
        return _NormalEquations(H, g, energy)

    def scores(self, theta: Array) -> tuple[Array, Array, Array]:
        """H (k, k), the gradients g_i (N, k) of the poses, and the residuals (N, rows), m."""
        bases, columns, size = _layout(self._chosen, theta)
        H, scores = np.zeros((size, size)), np.zeros((len(self._problem), size))
        residual = np.zeros((len(self._problem), self._rows.shape[2]))
        for k, chunks in enumerate(self._chunks):
            here = np.flatnonzero(self._problem.placement == k)
            index = np.ix_(columns[k], columns[k])
            for start, chunk in zip(range(0, len(here), CHUNK), chunks, strict=True):
                poses = here[start : start + CHUNK]
                Je = self._linearised(theta[k], chunk)[: len(poses)]
                J = bases[k].T @ Je[:, :-1]
                scores[poses[:, None], columns[k]] = (J @ Je[:, -1, :, None])[..., 0]
                H[index] += (J @ J.swapaxes(1, 2)).sum(axis=0)
                residual[poses] = Je[:, -1]
        return H, scores, residual

    def _linearised(self, theta: Array, chunk: Array) -> Array:
        """[J | e] transposed, (CHUNK, size + 1, rows); valid until the next call."""
        for i, argument in enumerate((np.ascontiguousarray(theta), chunk, self._lever)):
            self._buffer.set_arg(i, memoryview(argument.reshape(-1)))  # pyright: ignore[reportCallIssue, reportArgumentType]
        self._buffer.set_res(0, memoryview(self._rows.reshape(-1)))  # pyright: ignore[reportCallIssue, reportArgumentType]
        self._evaluate()
        return self._rows


def _chunks(problem: Problem, placement: int) -> list[Array]:
    """Blocks (CHUNK, 13) of [R row-major, p, weight] of one placement, padded with weight 0."""
    here = np.flatnonzero(problem.placement == placement)
    data = np.zeros((len(here) + -len(here) % CHUNK, 13))
    data[:, [0, 4, 8]] = 1
    data[: len(here), :9] = problem.rotations[here].reshape(-1, 9)
    data[: len(here), 9:12] = problem.p_world_sensor[here]
    data[: len(here), 12] = 1
    return np.split(data, len(data) // CHUNK)


@lru_cache(maxsize=8)
def _rows_of_chunk(chosen: Locus) -> tuple[ca.Function, int]:
    """[J | e] of one pose, weighted, mapped over a chunk, and the number of residuals of a pose."""
    theta, pose, lever = ca.SX.sym("theta", chosen.size), ca.SX.sym("pose", 13), ca.SX.sym("lever")
    R, p, weight = ca.reshape(pose[:9], 3, 3).T, pose[9:12], pose[12]
    e = chosen.residual(theta, R, p, lever) * weight
    rows = ca.densify(ca.vec(ca.horzcat(ca.jacobian(e, theta), e)))
    one = ca.Function("rows", [theta, pose, lever], [rows], {"cse": True})
    return one.map("rows_of_chunk", "serial", CHUNK, [0, 2], []), e.numel()


def _layout(chosen: Locus, theta: Array) -> tuple[list[Array], list[np.ndarray], int]:
    """Tangent bases of the placements, the columns of each among all unknowns, and their number."""
    bases = [chosen.basis(x) for x in theta]
    own = int(np.any(bases[0][: chosen.own], axis=0).sum())
    shared = len(theta) * own + np.arange(bases[0].shape[1] - own)
    columns = [np.concatenate([k * own + np.arange(own), shared]) for k in range(len(theta))]
    return bases, columns, int(columns[0].max()) + 1


def _retract(chosen: Locus, theta: Array, step: Array) -> Array:
    bases, columns, _ = _layout(chosen, theta)
    moved = [x + B @ step[index] for x, B, index in zip(theta, bases, columns, strict=True)]
    return chosen.normalised(np.stack(moved))
