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
from solvers.estimate import Estimate
from solvers.loci import Locus
from solvers.problem import Problem
from solvers.se3 import Array

CHUNK = 1008
"""Poses that one call of the mapped function takes; the last chunk is padded with weight 0."""


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
    damping, converged, iteration = 1e-9, False, 0
    H, g, energy = _normal_equations(chosen, poses, theta, lever)
    for iteration in range(1, max_iterations + 1):
        scale = np.sqrt(np.maximum(np.diagonal(H), 1e-12 * H.diagonal().max()))
        A = H / np.outer(scale, scale) + damping * np.eye(len(H))
        step = -np.linalg.solve(A, g / scale) / scale
        trial = _retract(chosen, theta, step)
        trial_equations = _normal_equations(chosen, poses, trial, lever)
        if trial_equations[2] > energy:
            damping = max(10 * damping, 1e-12)
            converged = damping > 1e6
        else:
            gain = energy - trial_equations[2]
            theta, (H, g, energy) = trial, trial_equations
            damping = max(damping * 0.1, 1e-12)
            converged = gain <= 1e-12 * energy or np.abs(step).max() < 1e-12
        if converged:
            break
    more = {"null_direction_sensor": _null_direction(chosen, H, len(theta))} if chosen.size == 10 else {}
    return chosen.estimate(theta, problem, iterations=iteration, converged=converged, **more)


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
    if not chosen.needs_rotation_about_two_axes:
        return chosen.start(problem)
    if options.start not in ("auto", "closed_form", "decomposed"):
        raise ValueError(f"start {options.start!r} is unknown; it is one of auto, closed_form, decomposed")
    use_sweeps = decomposed.has_sweeps(problem) if options.start == "auto" else options.start == "decomposed"
    if use_sweeps:
        axes = decomposed.axes_of(problem, decomposed.Options(options.fix_non_orthogonality, iterations=0))
    else:
        axes = closed_form.axes_of(problem, closed_form.Options(options.fix_non_orthogonality))
    shifted = axes.offset + options.shift_start_m * axes.orbital_axis
    return chosen.theta(replace(axes, offset=shifted))


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


def _normal_equations(chosen: Locus, poses: list, theta: Array, lever: float) -> tuple[Array, Array, float]:
    """H (k, k), gradient (k,) in the tangent space of all unknowns, and the energy, m^2."""
    function, rows = _mapped(chosen)
    P, bases = len(theta), [chosen.basis(x) for x in theta]
    own = int(np.any(bases[0][: chosen.own], axis=0).sum())
    shared = bases[0].shape[1] - own
    size = P * own + shared
    H, g, energy = np.zeros((size, size)), np.zeros(size), 0.0
    for k, blocks in enumerate(poses):
        columns = np.concatenate([k * own + np.arange(own), P * own + np.arange(shared)])
        for block in blocks:
            Je = np.asarray(function(theta[k], block, lever)).reshape(chosen.size + 1, rows * CHUNK).T
            J = Je[:, :-1] @ bases[k]
            H[np.ix_(columns, columns)] += J.T @ J
            g[columns] += J.T @ Je[:, -1]
            energy += float(Je[:, -1] @ Je[:, -1])
    return H, g, energy


def _retract(chosen: Locus, theta: Array, step: Array) -> Array:
    P, bases = len(theta), [chosen.basis(x) for x in theta]
    own = int(np.any(bases[0][: chosen.own], axis=0).sum())
    moved = [
        x + B @ np.concatenate([step[k * own : (k + 1) * own], step[P * own :]])
        for k, (x, B) in enumerate(zip(theta, bases, strict=True))
    ]
    return chosen.normalised(np.stack(moved))


def _null_direction(chosen: Locus, H: Array, P: int) -> Array:
    """Unit direction of the offset (sensor frame) in the eigenvector of least curvature."""
    scale = np.sqrt(H.diagonal())
    vector = np.linalg.eigh(H / np.outer(scale, scale))[1][:, 0] / scale
    return vector[-3:] / np.linalg.norm(vector[-3:])
