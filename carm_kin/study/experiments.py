"""The experiments of Lee, Seibold et al. (SPIE 2020) with the paper's conditions, for every solver, over many seeds.

Noise: all 28 sweeps of 360 poses, position noise of 0 to 5 mm or orientation noise of 0 to 0.5 deg. Trajectories: 3
to 13 orbital and 1 to 13 angular sweeps at 1 mm and 0.1 deg. Density: a pose every 0.25 to 15 deg. Table 1: the
paper's RANSAC about the decomposition, an inlier being within 0.5 mm of the torus surface. The paper does not state its
geometries: ours are random (`carm_kin.simulation.scenes`).
"""

import time
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from zlib import crc32

import numpy as np

import solvers
from carm_kin.errors import InputError
from carm_kin.simulation import scenes
from carm_kin.simulation.scenes import Motion
from solvers.likelihood.bound import cramer_rao
from solvers.nearest import nearest
from solvers.problem import Problem
from solvers.se3 import Array, log_so3
from solvers.torus import Torus

SOLVERS = ("kinematic", "closed_form", "direct", "decomposed")
STREAM = 0xE4B
"""Keeps the draws apart from those of a solver with the same seed."""
MM, DEG = 1e-3, float(np.radians(1.0))
NOISELESS = 1e-7
"""Stands for a noise of zero in the bound, m or rad."""
BAND_M = 0.5e-3
"""Table 1: half-width of the inlier band about the torus surface."""
REQUIRED_SHARE = 0.8
"""Table 1: required inliers over those that position noise leaves within the band."""
ALL_ALPHAS, ALL_BETAS = tuple(range(-90, 91, 10)), tuple(range(0, 161, 20))
STEPS_DEG = (0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4, 5, 6, 8, 10, 12, 15)


@dataclass(frozen=True)
class Condition:
    """One abscissa of one figure."""

    experiment: str
    """As in `carm_kin.study.published`."""
    value: float
    """Of the abscissa, in the unit of its figure."""
    sigma_t_mm: float
    sigma_r_deg: float
    alphas_deg: tuple[float, ...] = ALL_ALPHAS
    betas_deg: tuple[float, ...] = ALL_BETAS
    step_deg: float = 1.0

    def motion(self) -> Motion:
        """The sweeps, full circles."""
        return _motion(self.alphas_deg, self.betas_deg, self.step_deg)


@cache
def _motion(alphas: tuple[float, ...], betas: tuple[float, ...], step: float) -> Motion:
    path = np.arange(0.0, 360.0, step)
    return scenes.sweeps_deg(alphas, path, betas, path)


def conditions(experiment: str) -> tuple[Condition, ...]:
    """The conditions of ``noise``, ``trajectories``, ``density`` or ``table1``. Raises InputError for another name."""
    if experiment not in EXPERIMENTS:
        raise InputError(f"experiment '{experiment}' is unknown; it is one of {', '.join(EXPERIMENTS)}, or all")
    return EXPERIMENTS[experiment]


def _spread(low: float, high: float, count: int) -> tuple[float, ...]:
    """So many angles, evenly; the middle where there is one."""
    return tuple(np.linspace(low, high, count)) if count > 1 else ((low + high) / 2,)


_NOISE = tuple(Condition("noise_translation", x / 2, x / 2, 0) for x in range(11))
_NOISE += tuple(Condition("noise_rotation", round(x / 20, 2), 0, round(x / 20, 2)) for x in range(11))
_TRAJECTORIES = tuple(
    Condition("trajectories_orbital", k, 1, 0.1, _spread(-90, 90, k), ALL_BETAS) for k in range(3, 14)
)
_TRAJECTORIES += tuple(
    Condition("trajectories_angular", k, 1, 0.1, ALL_ALPHAS, _spread(0, 160, k)) for k in range(1, 14)
)
_DENSITY = tuple(Condition("density", 28 * len(np.arange(0, 360, step)), 1, 0.1, step_deg=step) for step in STEPS_DEG)
_TABLE1 = tuple(Condition("table1_translation", x, x, 0) for x in range(6))
_TABLE1 += tuple(Condition("table1_rotation", x / 10, 0, x / 10) for x in range(6))
EXPERIMENTS = {"noise": _NOISE, "trajectories": _TRAJECTORIES, "density": _DENSITY, "table1": _TABLE1}


@dataclass(frozen=True)
class Outcome:
    """One solver on one recording."""

    condition: Condition
    seed: int
    solver: str
    t_error_m: float
    """Length of the error of the offset; NaN where the solver failed."""
    R_error_m: float
    """|R| less the true one."""
    orientation_error_rad: float
    """Rotation between the estimated and the true torus frame."""
    bound_m: float
    """Root of the trace of the offset's Cramér-Rao bound, labels known."""
    time_s: float


@dataclass(frozen=True)
class Ransac:
    """A row of Table 1 on one recording."""

    condition: Condition
    seed: int
    poses: int
    required: int
    detected: int
    mean_inliers_m: float
    mean_all_m: float


def recording(condition: Condition, seed: int) -> tuple[Torus, Problem]:
    """A random machine and its noisy poses with the labels of the held joints."""
    rng = np.random.default_rng([seed, STREAM, crc32(condition.experiment.encode()), round(1000 * condition.value)])
    torus = scenes.random_torus(rng)
    problem, _ = scenes.observed(torus, condition.motion(), condition.sigma_t_mm * MM, condition.sigma_r_deg * DEG, rng)
    return torus, problem


def outcomes(condition: Condition, seed: int, names: Iterable[str] = SOLVERS) -> tuple[Outcome, ...]:
    """Every solver, with its default options, on one random machine."""
    truth, problem = recording(condition, seed)
    bound = _bound(condition, truth, problem)
    found = []
    for name in names:
        start = time.perf_counter()
        try:
            torus = solvers.solver(name).solve(problem).torus
        except (np.linalg.LinAlgError, ValueError):
            torus = None
        seconds = time.perf_counter() - start
        t, R, turn = (np.nan, np.nan, np.nan) if torus is None else _errors(torus, truth)
        found.append(Outcome(condition, seed, name, t, R, turn, bound, seconds))
    return tuple(found)


def ransac(condition: Condition, seed: int) -> Ransac:
    """The paper's RANSAC about the decomposition: 500 hypotheses, a band of 1 mm full width."""
    _, problem = recording(condition, seed)
    module = solvers.solver("decomposed")
    distance = surface_distance(
        module.solve(problem, module.Options(iterations=500, inlier_width_m=2 * BAND_M, seed=seed)).torus, problem
    )
    inliers = distance <= BAND_M
    sigma = condition.sigma_t_mm * MM
    required = REQUIRED_SHARE * len(problem) * _within(BAND_M, sigma)
    mean = float(distance[inliers].mean()) if inliers.any() else np.nan
    return Ransac(condition, seed, len(problem), round(required), int(inliers.sum()), mean, float(distance.mean()))


def surface_distance(torus: Torus, problem: Problem) -> Array:
    """(N,) distance of the positions from the torus on which the sensor moves, m."""
    positions = Problem.of_poses(problem.p_world_sensor, None)
    angles = nearest(torus, positions, (1.0, 1.0)).T
    return np.linalg.norm(torus.poses(angles, positions.placement)[:, :3, 3] - positions.p_world_sensor, axis=1)


def _within(half_width: float, sigma: float) -> float:
    """Share of normal values within the half-width."""
    from scipy.special import erf

    return float(erf(half_width / (sigma * np.sqrt(2)))) if sigma > 0 else 1.0


def _bound(condition: Condition, truth: Torus, problem: Problem) -> float:
    sigma = max(condition.sigma_t_mm * MM, NOISELESS), max(condition.sigma_r_deg * DEG, NOISELESS)
    covariance = cramer_rao(truth, condition.motion().angles, problem, *sigma)
    return float(np.sqrt(np.trace(covariance.block("offset"))))


def _errors(torus: Torus, truth: Torus) -> tuple[float, float, float]:
    turn = torus.T_world_torus[0, :3, :3].T @ truth.T_world_torus[0, :3, :3]
    return (
        float(np.linalg.norm(torus.offset - truth.offset)),
        abs(torus.major_radius) - abs(truth.major_radius),
        float(np.linalg.norm(log_so3(turn))),
    )


def work(names: Iterable[str], seeds: int) -> list[tuple[Condition, int]]:
    """Of the named experiments, ``all`` for every one, each condition with so many seeds. Raises InputError."""
    wanted = [experiment for name in names for experiment in (EXPERIMENTS if name == "all" else (name,))]
    return [(condition, seed) for name in wanted for condition in conditions(name) for seed in range(seeds)]


def run_one(condition: Condition, seed: int) -> tuple[Outcome, ...] | Ransac:
    """What a condition gives with one seed."""
    if condition.experiment.startswith("table1"):
        return ransac(condition, seed)
    return outcomes(condition, seed)
