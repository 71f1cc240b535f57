"""The sensor's positions alone, fitted to the generalised torus surface (Eq. 5 of the paper).

Orthogonal distance regression: alpha and beta of the nearest surface point are eliminated at each
pose, as in the kinematic solver but with the three position residuals only. The start is algebraic.
With q = p - c, the surface (epsilon = 0) satisfies

    |q|^4 - qT S q + d = 0,  S = (2 k + 4 R^2) I - 4 R^2 n nT,  k = t_y^2 + b^2 - R^2,
    d = k^2 + 4 R^2 t_y^2,

which is linear in its coefficients before c is known, too. Positions cannot give the offset: any
rotation of the sensor in its mount leaves them unchanged.
"""

from dataclasses import dataclass, field

import numpy as np

from solvers.estimate import Correlation, Estimate, Note
from solvers.likelihood.correlation import Stretches, correlation_time
from solvers.likelihood.covariance import active_unknowns, covariance_of, marginal_covariance
from solvers.likelihood.elimination import Reduced, normal_equations
from solvers.likelihood.linearise import AngleModel, linearise, retract
from solvers.problem import Problem
from solvers.se3 import Array, orthonormal_complement, transform
from solvers.torus import Torus

SIGMA_FLOOR_M = 1e-7
SPHERE_SIGMAS = 5.0
"""A major radius of fewer noise sigmas cannot be told from a sphere."""
MIN_POSES = 12
"""Fewest positions for the eight unknowns."""
FLAT = 0.01
"""Thickness of the positions, relative to their extent, below which they lie in a plane."""
COARSE = (2000, 50_000)
"""Positions among which the best start is found, and more on which it settles, before all take part."""
SETTLED = 1e-2
"""The fit ends where a step lowers the sum of squares by less than this, in noise variances."""
NEARLY_SPHERE = 0.03
"""Relative deviation from a sphere below which the algebraic start is not trusted alone."""


@dataclass(frozen=True)
class Options:
    """Options of the surface solver."""

    max_iterations: int = field(default=100, metadata={"min": 1, "max": 10_000})
    """Steps after which a start is given up."""


def solve(problem: Problem, options: Options = Options()) -> Estimate:
    """c, n, R, b and t_y from positions. Raises ValueError for several base placements."""
    if problem.placements > 1:
        raise ValueError("surface fits one base placement at a time; select one")
    unobservable = _flat(problem.p_world_sensor)
    if unobservable:
        center = problem.p_world_sensor.mean(axis=0)[None]
        return Estimate("surface", center=center, unobservable=unobservable, converged=False)
    positions = Problem.of_poses(problem.p_world_sensor, None)
    some = _thinned(positions, COARSE[0])
    best = min((_refine(some, start, options) for start in _starts(some.p_world_sensor)), key=lambda fit: fit.at.cost)
    for poses in (*COARSE[1:], len(positions)):
        if len(some) < len(positions):
            some = _thinned(positions, poses)
            best = _refine(some, best.torus, options)
    return _estimate(positions, best)


def _thinned(problem: Problem, poses: int) -> Problem:
    return problem.select(slice(None, None, max(1, len(problem) // poses)))


def _flat(p: Array) -> tuple[str, ...]:
    """A sentence where the positions fill no surface: they stand still, or lie on a curve in a plane."""
    spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False) / np.sqrt(len(p))
    if len(p) < MIN_POSES:
        return (
            f"{len(p)} positions cannot determine the eight unknowns of the surface: at least {MIN_POSES} are needed",
        )
    if spread[-1] > FLAT * spread[0]:
        return ()
    return (
        "the positions lie in a plane or stand still, so they show motion about one axis at most: the torus is unknown",
    )


def _starts(p: Array) -> list[Torus]:
    """Tori from the algebraic quartic, and small ones inside the best sphere for where it degenerates."""
    mean = p.mean(axis=0)
    scale = np.sqrt(((p - mean) ** 2).sum(axis=1).mean())
    x = (p - mean) / scale
    center, radius = _sphere(x)
    inside = []
    if np.std(np.linalg.norm(x - center, axis=1)) < NEARLY_SPHERE * radius:
        inside = [_torus(center, n, 0.05 * radius, 0.98 * radius, 0.2 * radius, mean, scale) for n in np.eye(3)]
    square = (x**2).sum(axis=1)
    pairs = np.stack([x[:, i] * x[:, j] for i in range(3) for j in range(i, 3)], axis=1)
    linear = np.concatenate([square[:, None] * x, pairs, x, np.ones((len(x), 1))], axis=1)
    c = -np.linalg.lstsq(linear, -(square**2), rcond=None)[0][:3] / 4
    q = x - c
    square = (q**2).sum(axis=1)
    pairs = np.stack([q[:, i] * q[:, j] * (1 if i == j else 2) for i in range(3) for j in range(i, 3)], axis=1)
    s = np.linalg.lstsq(np.concatenate([-pairs, np.ones((len(q), 1))], axis=1), -(square**2), rcond=None)[0]
    values, vectors = np.linalg.eigh(np.array([[s[0], s[1], s[2]], [s[1], s[3], s[4]], [s[2], s[4], s[5]]]))
    R2, k = max((values[2] + values[1]) / 2 - values[0], 1e-6) / 4, values[0] / 2
    t_y2 = np.clip((s[6] - k**2) / (4 * R2), 0.0, 0.9 * max(k + R2, 1e-6))
    b = np.sqrt(max(k + R2 - t_y2, 1e-6))
    return [_torus(c, vectors[:, 0], np.sqrt(R2), b, np.sqrt(t_y2), mean, scale), *inside]


def _sphere(x: Array) -> tuple[Array, float]:
    solution = np.linalg.lstsq(np.column_stack([2 * x, np.ones(len(x))]), (x**2).sum(axis=1), rcond=None)[0]
    return solution[:3], float(np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 1e-12)))


def _torus(c: Array, n: Array, R: float, b: float, t_y: float, mean: Array, scale: float) -> Torus:
    """A chain whose sensor stands at (0, t_y, b) in the carm frame, its axes parallel to it."""
    z = orthonormal_complement(n)[:, 0]
    T_world_torus = transform(np.stack([n, np.cross(z, n), z], axis=1), mean + scale * c)[None]
    T_sensor_carm = transform(np.eye(3), -scale * np.array([0.0, t_y, b]))
    return Torus(T_world_torus, scale * R, 0.0, T_sensor_carm, np.array([False]), False)


@dataclass(frozen=True, eq=False)
class _Fit:
    torus: Torus
    angles: Array
    at: Reduced
    active: np.ndarray
    iterations: int
    converged: bool


def _refine(problem: Problem, torus: Torus, options: Options) -> _Fit:
    model = AngleModel.of(problem)
    active = active_unknowns(problem, fix_non_orthogonality=True)
    active[[8, 11, 12, 13]] = False  # the mount has two unknowns left, t_y and b
    angles = nearest_angles(torus, problem)
    at = normal_equations(torus, angles, problem, model, (1.0,))
    damping, iteration, converged = 1e-3, 0, False
    while iteration < options.max_iterations and not converged:
        iteration += 1
        step = np.zeros(len(active))
        inner = at.H[np.ix_(active, active)]
        scale = np.sqrt(np.maximum(inner.diagonal(), 1e-12 * inner.diagonal().max()))
        A = inner / np.outer(scale, scale) + damping * np.eye(len(inner))
        step[active] = -np.linalg.solve(A, at.g[active] / scale) / scale
        trial = retract(torus, step)
        trial_angles = nearest_angles(trial, problem)
        there = normal_equations(trial, trial_angles, problem, model, (1.0,))
        gain = at.cost - there.cost
        if gain >= 0:
            torus, angles, at = trial, trial_angles, there
            damping = max(damping * 0.1, 1e-15)
            converged = gain <= SETTLED * at.cost / len(problem) or at.cost < len(problem) * 1e-24
        else:
            damping *= 10
            converged = damping > 1e8
    return _Fit(torus, angles, at, active, iteration, converged)


def nearest_angles(torus: Torus, problem: Problem) -> Array:
    """alpha, beta (2, N) of the surface point nearest to each position, in the meridian half-plane.

    The surface is met twice, at u = b cos(beta + gamma) + R = +sqrt(.) and -sqrt(.): the nearer counts.
    """
    q = (problem.p_world_sensor - torus.center[0]) @ torus.T_world_torus[0, :3, :3]
    t_y, b = -torus.offset[1], -torus.offset[2]
    root = np.sqrt(np.maximum(q[:, 1] ** 2 + q[:, 2] ** 2 - t_y**2, 0.0))
    R = torus.major_radius
    distance = [np.abs(np.hypot(u - R, q[:, 0]) - b) for u in (root, -root)]
    u = np.where(distance[0] <= distance[1], root, -root)
    alpha = np.arctan2(q[:, 2], q[:, 1]) - np.arctan2(u, t_y)
    return np.stack([alpha, np.arctan2(q[:, 0], u - R)])


def _estimate(problem: Problem, fit: _Fit) -> Estimate:
    torus, at = fit.torus, fit.at
    redundancy = max(len(problem) - int(fit.active.sum()), 1)
    sigma = max(float(np.sqrt(at.cost / redundancy)), SIGMA_FLOOR_M)
    time = correlation_time(at.left.T / sigma, Stretches.of(problem), float(fit.active.sum()))
    covariance = covariance_of(torus, marginal_covariance(at.H / sigma**2, fit.active) * time)
    notes = [
        Note(
            "offset_not_determined",
            "positions alone determine the torus, not the offset: every rotation of the sensor in its mount "
            "gives the same ones",
        )
    ]
    told = ("major", "minor", "torus", "angular")
    if abs(torus.major_radius) < SPHERE_SIGMAS * sigma:
        told = ("torus",)
        notes.append(
            Note(
                "nearly_sphere",
                f"the major radius lies within {SPHERE_SIGMAS:.0f} times the noise: positions then lie on a sphere, "
                "which tells nothing of the axes and the minor radius, and biases the major radius upwards; their "
                "standard deviations are left out",
            )
        )
    kept = [i for i, name in enumerate(covariance.names) if name.startswith(told)]
    return Estimate(
        "surface",
        center=torus.center,
        angular_axis=torus.angular_axis,
        major_radius=torus.major_radius,
        minor_radius=torus.minor_radius,
        sigma_t=sigma,
        covariance=covariance.select(kept),
        correlation=Correlation(position=time),
        angles=fit.angles.T,
        residual=linearise(torus, fit.angles, problem).residual.T,
        iterations=fit.iterations,
        converged=fit.converged,
        notes=tuple(notes),
    )
