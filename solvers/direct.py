"""The full pivot-on-locus energy, minimised directly.

CasADi states the residuals of one pose in a locus' ambient coordinates and differentiates them;
the products JTJ and JTe of a pose, mapped over a fixed number of poses and summed, are one compiled
function for each locus, built once, the poses being its parameters. Gauss-Newton with Levenberg's
damping runs in the tangent space.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from solvers import closed_form, decomposed, loci
from solvers.estimate import Covariance, Estimate
from solvers.loci import Locus, TwoAxisLocus
from solvers.problem import Problem
from solvers.se3 import Array

CHUNK = 1008
"""Poses that one call of the mapped function takes; the last chunk is padded with weight 0."""

LEAST_DAMPING = 1e-9
"""Relative to a unit diagonal: too small to slow a determined direction, large enough that rounding does
not drive the solver along an undetermined one."""


@dataclass(frozen=True)
class Options:
    """Options of the direct solver."""

    locus: str = "circle"
    """circle (a C-arm) or point (a pointer pivoted about a fixed point)."""
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
    max_iterations: int = 100
    """Steps after which the solver gives up and says so."""


def solve(problem: Problem, options: Options = Options()) -> Estimate:
    """Minimise the energy of the chosen locus. Needs orientations.

    Raises ValueError for an unknown locus, gauge or start.
    """
    chosen = _locus(options)
    theta = _start(problem, chosen, options)
    lever = options.lever_m or max(float(np.linalg.norm(theta[0, chosen.own :][-7:-4])), 0.1)
    return minimise(problem, chosen, theta, lever, options.max_iterations)


def minimise(problem: Problem, chosen: Locus, theta: Array, lever: float, max_iterations: int) -> Estimate:
    """Gauss-Newton with Levenberg's damping from ``theta`` (P, size)."""
    poses = _chunks(problem)
    damping, converged, iteration = LEAST_DAMPING, False, 0
    H, g, energy = _normal_equations(chosen, poses, theta, lever)
    while not converged and iteration < max_iterations:
        iteration += 1
        scale = np.sqrt(np.maximum(np.diagonal(H), 1e-12 * H.diagonal().max()))
        A = H / np.outer(scale, scale) + damping * np.eye(len(H))
        step = -np.linalg.solve(A, g / scale) / scale
        trial = _retract(chosen, theta, step)
        trial_equations = _normal_equations(chosen, poses, trial, lever)
        gain = energy - trial_equations[2]
        if gain < 0:
            damping *= 10
            converged = damping > 1e6 or -gain <= 1e-12 * energy
        else:
            theta, (H, g, energy) = trial, trial_equations
            damping = max(damping * 0.1, LEAST_DAMPING)
            converged = bool(gain <= 1e-9 * energy or np.abs(step).max() < 1e-12)
    return _estimate(problem, chosen, poses, theta, lever, iteration, converged)


def _estimate(
    problem: Problem, chosen: Locus, poses: list, theta: Array, lever: float, iteration: int, converged: bool
) -> Estimate:
    """The answer with the residuals of the locus and a covariance that trusts the residuals alone.

    inv(H) (sum g_i g_iT) inv(H) with g_i the gradient of one pose holds whatever mixture of position and
    rotation noise made the residuals; it is scaled by N / (N - unknowns / residuals of a pose).
    """
    H, scatter, residual = _scatter(problem, chosen, poses, theta, lever)
    spread = np.sqrt(np.maximum(H.diagonal(), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(H / np.outer(spread, spread))
    inverse = ((vectors / np.maximum(values, 1e-15)) @ vectors.T) / np.outer(spread, spread)
    free = max(len(problem) - len(H) / residual.shape[1], 1.0)
    names, J = chosen.reported(theta)
    covariance = Covariance(names, J @ inverse @ scatter @ inverse @ J.T * (len(problem) / free))
    least = vectors[:, 0] / spread
    return chosen.estimate(
        theta,
        problem,
        null_direction_sensor=least,
        residual=residual,
        covariance=covariance,
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
        raise ValueError(f"locus {options.locus!r} is unknown; it is one of {', '.join(loci.locus_names())}") from None


def _start(problem: Problem, chosen: Locus, options: Options) -> Array:
    if not isinstance(chosen, TwoAxisLocus):
        return chosen.start(problem)
    if options.start not in ("auto", "closed_form", "decomposed"):
        raise ValueError(f"start {options.start!r} is unknown; it is one of auto, closed_form, decomposed")
    use_sweeps = decomposed.has_sweeps(problem) if options.start == "auto" else options.start == "decomposed"
    if use_sweeps:
        axes = decomposed.axes_of(problem, decomposed.Options(options.fix_non_orthogonality, iterations=0))
    else:
        axes = closed_form.axes_of(problem, closed_form.Options(options.fix_non_orthogonality))
    return chosen.theta(replace(axes, offset=axes.offset + options.shift_start_m * axes.orbital_axis))


def _chunks(problem: Problem) -> list[list[ca.DM]]:
    """For each placement, blocks (13, CHUNK) of [R row-major, p, weight], padded with weight 0."""
    data = np.concatenate(
        [problem.rotations.reshape(-1, 9), problem.p_world_sensor, np.ones((len(problem), 1))], axis=1
    )
    blocks = []
    for k in range(problem.placements):
        rows = data[problem.placement == k]
        padding = np.zeros((-len(rows) % CHUNK, 13))
        padding[:, [0, 4, 8]] = 1
        full = np.concatenate([rows, padding]).T
        blocks.append([ca.DM(full[:, i : i + CHUNK]) for i in range(0, full.shape[1], CHUNK)])
    return blocks


@lru_cache(maxsize=8)
def _mapped(chosen: Locus) -> tuple[ca.Function, int]:
    """[J | e] of one pose, weighted, mapped over a chunk; and the number of its rows."""
    theta, pose, lever = ca.SX.sym("theta", chosen.size), ca.SX.sym("pose", 13), ca.SX.sym("lever")
    R, p, weight = ca.reshape(pose[:9], 3, 3).T, pose[9:12], pose[12]
    e = chosen.residual(theta, R, p, lever) * weight
    rows = ca.horzcat(ca.jacobian(e, theta), e)
    one = ca.Function("rows", [theta, pose, lever], [ca.vec(ca.densify(rows))], {"cse": True})
    return one.map("rows_of_chunk", "serial", CHUNK, [0, 2], []), e.numel()


def _layout(chosen: Locus, theta: Array) -> tuple[list[Array], list[np.ndarray], int]:
    """Tangent bases of the placements, the columns of each among all unknowns, and their number."""
    bases = [chosen.basis(x) for x in theta]
    own = int(np.any(bases[0][: chosen.own], axis=0).sum())
    shared = len(theta) * own + np.arange(bases[0].shape[1] - own)
    columns = [np.concatenate([k * own + np.arange(own), shared]) for k in range(len(theta))]
    return bases, columns, int(columns[0].max()) + 1


def _normal_equations(chosen: Locus, poses: list, theta: Array, lever: float) -> tuple[Array, Array, float]:
    """H (k, k), gradient (k,) in the tangent space of all unknowns, and the energy, m^2."""
    function, rows = _mapped(chosen)
    bases, columns, size = _layout(chosen, theta)
    H, g, energy = np.zeros((size, size)), np.zeros(size), 0.0
    for k, blocks in enumerate(poses):
        M = np.zeros((chosen.size + 1, chosen.size + 1))
        for block in blocks:
            Je = function(theta[k], block, lever).full().reshape(chosen.size + 1, rows * CHUNK)
            M += Je @ Je.T
        H[np.ix_(columns[k], columns[k])] += bases[k].T @ M[:-1, :-1] @ bases[k]
        g[columns[k]] += bases[k].T @ M[:-1, -1]
        energy += float(M[-1, -1])
    return H, g, energy


def _scatter(problem: Problem, chosen: Locus, poses: list, theta: Array, lever: float) -> tuple[Array, Array, Array]:
    """H (k, k), the sum of g_i g_iT (k, k) over the poses, and the residuals (N, rows), m."""
    function, rows = _mapped(chosen)
    bases, columns, size = _layout(chosen, theta)
    H, scatter, residual = np.zeros((size, size)), np.zeros((size, size)), np.zeros((len(problem), rows))
    for k, blocks in enumerate(poses):
        Je = [function(theta[k], block, lever).full().reshape(chosen.size + 1, rows, CHUNK) for block in blocks]
        here = np.flatnonzero(problem.placement == k)
        all_poses = np.concatenate(Je, axis=2)[:, :, : len(here)]
        J, e = np.einsum("irn,ij->jrn", all_poses[:-1], bases[k]), all_poses[-1]
        gradient = (J * e).sum(axis=1)
        index = np.ix_(columns[k], columns[k])
        scatter[index] += gradient @ gradient.T
        H[index] += np.einsum("irn,jrn->ij", J, J)
        residual[here] = e.T
    return H, scatter, residual


def _retract(chosen: Locus, theta: Array, step: Array) -> Array:
    bases, columns, _ = _layout(chosen, theta)
    moved = [x + B @ step[index] for x, B, index in zip(theta, bases, columns, strict=True)]
    return chosen.normalised(np.stack(moved))
