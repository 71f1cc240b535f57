"""The paper's decomposition into plane and circle fits (Lee et al. 2020, Section 3), step by step.

1. A plane and a circle through every angular sweep: their normals average to n, their centres lie
   on the angular axis.
2. A plane and a circle through every orbital sweep: centre c^c on the orbital axis, normal a_s. The
   height of the c^c along n gives the torus centre c on the angular axis.
3. The perpendicular distance of the line (c^c, a_s) from the angular axis is R.
4. The a_s, turned back by the known angles of their sweeps, give the remaining torus axes under the
   orthogonality constraint.
5. t is the average of ``R_iT (c + R z_i - p_i)`` over all poses.

RANSAC runs inside the circle fits (three poses a hypothesis) and around the whole (some poses of
every sweep a hypothesis, scored by the distance of the poses to the torus surface). Its scale is
estimated from the data unless a width is given. Orientations serve for signs and for t only.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from solvers.estimate import Estimate
from solvers.problem import ANGULAR, ORBITAL, Problem
from solvers.se3 import Array
from solvers.start.rank_one import unit
from solvers.start.ransac import best_circles, consensus, fit_circles
from solvers.torus import Axes

PARALLEL = 1e-12
"""Least squared sine of the angle between the axes that is divided by: none is the foot of parallel ones."""
STREAM = 0xDEC0
"""Keeps the draws apart from those of a simulation with the same seed."""


@dataclass(frozen=True)
class Options:
    """Options of the decomposed solver."""

    fix_non_orthogonality: bool = True
    """Take the axes as perpendicular instead of averaging -<n, a>."""
    iterations: int = field(default=500, metadata={"max": 10_000})
    """RANSAC hypotheses around the whole; 0: plain least squares over all poses."""
    poses_per_sweep: int = field(default=12, metadata={"min": 3, "max": 1000})
    """Poses of every sweep in one hypothesis."""
    inlier_width_m: float | None = None
    """Full width of the inlier band about the torus surface; None: six robust standard deviations."""
    seed: int = 0
    """Seed of the sampling."""


@dataclass(frozen=True, eq=False)
class _Sweeps:
    """Sweeps of one placement: pose indices, and for every sweep which joint it holds."""

    members: list
    held: np.ndarray


def has_sweeps(problem: Problem) -> bool:
    """Whether every placement has a sweep of three poses about each axis."""
    return all(
        any((problem.placement[i] == p).all() and len(i) >= 3 for i in problem.sweeps(joint))
        for p in range(problem.placements)
        for joint in (ANGULAR, ORBITAL)
    )


def solve(problem: Problem, options: Options = Options()) -> Estimate:
    """The chain from labelled sweeps. Needs orientations and sweeps about both axes.

    Raises ValueError where a placement has no sweep of at least three poses about one of the axes.
    """
    axes, used = _fit(problem, options)
    return Estimate.of_torus("decomposed", axes.torus(problem), used=used)


def axes_of(problem: Problem, options: Options = Options()) -> Axes:
    """The two axes, the offset and the radius, before any zero is given to the angles."""
    return _fit(problem, options)[0]


def _fit(problem: Problem, options: Options) -> tuple[Axes, np.ndarray]:
    """The axes and the mask (N,) of the poses that they rest on."""
    if not has_sweeps(problem):
        raise ValueError("decomposed needs, in every placement, an angular and an orbital sweep of three poses or more")
    rng = np.random.default_rng([options.seed, STREAM])
    parts, sizes, used = [], [], np.zeros(len(problem), dtype=bool)
    for p in range(problem.placements):
        sweeps = _sweeps_of(problem, p)
        sizes.append(sum(len(i) for i in sweeps.members))
        part, members = _one_placement(problem, sweeps, options, rng)
        parts.append(part)
        used[members] = True
    return _merged(parts, np.array(sizes)), used


def _sweeps_of(problem: Problem, placement: int) -> _Sweeps:
    members, held = [], []
    for joint in (ANGULAR, ORBITAL):
        for i in problem.sweeps(joint):
            if problem.placement[i[0]] == placement and len(i) >= 3:
                members.append(i)
                held.append(joint)
    return _Sweeps(members, np.array(held))


def _one_placement(
    problem: Problem, sweeps: _Sweeps, options: Options, rng: np.random.Generator
) -> tuple[Axes, np.ndarray]:
    p = problem.p_world_sensor
    if options.iterations:
        kept = [i[best_circles(p[i], rng)] for i in sweeps.members]
        sweeps = _consensus(problem, replace(sweeps, members=kept), options, rng)
    circles = [fit_circles(p[i]) for i in sweeps.members]
    center, normal, _ = (np.stack(x) for x in zip(*circles, strict=True))
    orientation = _mean_orientations(problem, sweeps)
    weight = np.array([float(len(i)) for i in sweeps.members])
    c, n, a, R, epsilon = _compose(center, normal, orientation, weight, sweeps.held, options.fix_non_orthogonality)
    poses = np.concatenate(sweeps.members)
    t = _average_offset(problem.rotations[poses], p[poses], c, n, a, R)
    return Axes(c[None], n[None], float(R), float(epsilon), t, a), poses


def _mean_orientations(problem: Problem, sweeps: _Sweeps) -> Array:
    """(S, 3, 3) the entrywise mean of the orientations of each sweep; it maps the moving axis to itself."""
    return np.stack([problem.rotations[i].mean(axis=0) for i in sweeps.members])


def _compose(
    center: Array, normal: Array, orientation: Array, weight: Array, held: np.ndarray, fixed: bool
) -> tuple[Array, Array, Array, Array, Array]:
    """Steps 1 to 3 from the circles of S sweeps, for any number of hypotheses (..., S, 3) at once.

    ``orientation`` (S, 3, 3), the mean of each sweep, tells the direction of each normal. Returns c, n,
    a (sensor frame), R and epsilon.
    """
    angular, orbital = held == ORBITAL, held == ANGULAR
    n = _common_direction(normal[..., angular, :], weight[angular])
    on_axis = np.average(center[..., angular, :], axis=-2, weights=weight[angular])
    a_sensor = np.einsum("sji,...sj->...si", orientation[orbital], normal[..., orbital, :])
    a = _common_direction(a_sensor, weight[orbital])
    y = normal[..., orbital, :] * np.sign(np.einsum("...si,...i->...s", a_sensor, a))[..., None]
    c_c = center[..., orbital, :]
    height = np.einsum("...si,...i->...s", c_c - on_axis[..., None, :], n)
    epsilon = -np.einsum("...si,...i->...s", y, n)
    if fixed:
        epsilon = np.zeros_like(epsilon)
    z = unit(np.asarray(np.cross(n[..., None, :], y), dtype=float))
    along = np.einsum("...si,...si->...s", on_axis[..., None, :] - c_c, y)
    w = weight[orbital]
    foot = (height - epsilon * along) / np.maximum(1 - epsilon**2, PARALLEL)
    c = on_axis + np.average(foot, axis=-1, weights=w)[..., None] * n
    R = np.average(np.einsum("...si,...si->...s", c_c - on_axis[..., None, :], z), axis=-1, weights=w)
    return c, n, a, R, np.arcsin(np.clip(np.average(epsilon, axis=-1, weights=w), -1, 1))


def _common_direction(v: Array, weight: Array) -> Array:
    """The unit vector nearest to all lines v (..., S, 3), signs ignored."""
    return np.linalg.eigh(np.einsum("...si,s,...sj->...ij", v, weight, v))[1][..., -1]


def _average_offset(R_ws: Array, p: Array, c: Array, n: Array, a: Array, R: Array) -> Array:
    """Step 5 for poses (M, ...) and any number of hypotheses (..., 3)."""
    z = unit(np.asarray(np.cross(n[..., None, :], np.einsum("mij,...j->...mi", R_ws, a)), dtype=float))
    pivot = c[..., None, :] + R[..., None, None] * z
    return np.einsum("mji,...mj->...i", R_ws, pivot - p) / len(p)


def _consensus(problem: Problem, sweeps: _Sweeps, options: Options, rng: np.random.Generator) -> _Sweeps:
    """The inliers of the best of many hypotheses, each from a few poses of every sweep.

    A sweep of which fewer than three poses agree is left out, unless that would leave none of its kind.
    """
    k = min(options.poses_per_sweep, *(len(i) for i in sweeps.members))
    shape = (options.iterations, k)
    sample = np.stack([i[rng.integers(len(i), size=shape)] for i in sweeps.members], axis=1)
    p = problem.p_world_sensor
    center, normal, radius = fit_circles(p[sample])
    orientation = _mean_orientations(problem, sweeps)
    c, n, a, R, _ = _compose(center, normal, orientation, np.ones(len(sweeps.held)), sweeps.held, fixed=True)
    orbital = sweeps.held == ANGULAR
    y = np.einsum("sij,hj->hsi", orientation[orbital], a)
    y = unit(y)
    t_y = np.einsum("hsi,hsi->hs", center[:, orbital] - c[:, None], y).mean(axis=1)
    b = radius[:, orbital].mean(axis=1)
    poses = np.concatenate(sweeps.members)
    agreeing = consensus(
        lambda h, i: _surface_distance(p[i], c[h], n[h], R[h], b[h], t_y[h]),
        options.iterations,
        poses,
        options.inlier_width_m,
        rng,
    )
    kept = [np.intersect1d(i, agreeing, assume_unique=True) for i in sweeps.members]
    enough = np.array([len(i) >= 3 for i in kept])
    if not all(enough[sweeps.held == joint].any() for joint in (ANGULAR, ORBITAL)):
        return sweeps
    return _Sweeps([i for i, ok in zip(kept, enough, strict=True) if ok], sweeps.held[enough])


def _surface_distance(p: Array, c: Array, n: Array, R: Array, b: Array, t_y: Array) -> Array:
    """Distance of points (M, 3) from the tori of H hypotheses -> (H, M), in the meridian half-plane."""
    mean = p.mean(axis=0)
    p, c = p - mean, c - mean
    x = n @ p.T - np.einsum("hi,hi->h", n, c)[:, None]
    square = (p**2).sum(axis=1) - 2 * c @ p.T + (c**2).sum(axis=1)[:, None] - x**2
    u = np.sqrt(np.maximum(square - t_y[:, None] ** 2, 0.0))
    R, b = np.abs(R)[:, None], b[:, None]
    return np.minimum(np.abs(np.hypot(u - R, x) - b), np.abs(np.hypot(u + R, x) - b))


def _merged(parts: list[Axes], sizes: Array) -> Axes:
    """One chain from those of the placements, which share R, epsilon, t and a."""
    first = parts[0]
    aligned = [x.turned(1, -1) if x.orbital_axis @ first.orbital_axis < 0 else x for x in parts]
    aligned = [x.turned(-1, 1) if x.major_radius * first.major_radius < 0 else x for x in aligned]
    a = np.average([x.orbital_axis for x in aligned], axis=0, weights=sizes)
    return Axes(
        center=np.concatenate([x.center for x in aligned]),
        angular_axis=np.concatenate([x.angular_axis for x in aligned]),
        major_radius=float(np.average([x.major_radius for x in aligned], weights=sizes)),
        non_orthogonality=float(np.average([x.non_orthogonality for x in aligned], weights=sizes)),
        offset=np.average([x.offset for x in aligned], axis=0, weights=sizes),
        orbital_axis=unit(a),
    )
