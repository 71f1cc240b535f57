"""Maximum likelihood of a whole machine from its URDF's numbers: docs/estimation.md, section 14.

Unknown are the base in the world for every placement, the mount of every sensor, and those joint placements,
zero offsets and gains that are set free and that the data determine. Joint values are readings with a sigma,
constants of a sweep, or unknown at every pose. Gauss-Newton on the manifold, damped where a step does not descend;
both noises of the poses are estimated by Helmert's equations, as in `solvers.kinematic`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import chdtri

from solvers.chain_equations import Reduced, normal_equations
from solvers.chain_problem import KINDS, ChainProblem, Layout
from solvers.identifiable import Dependence, identifiable
from solvers.kinematic import LEAST_CHANGE, OUTLIER_PROBABILITY, SIGMA_FLOOR
from solvers.machine import Machine
from solvers.se3 import Array, exp_se3, inverse, log_se3, log_so3

SETTLING = 3
"""Steps before outliers are told from the noise."""
FIRST_READING = (2e-3, 1e-4)
"""Noise of the readings to begin with, rad and m."""
MEDIAN_CHI2_3 = float(chdtri(3, 0.5))


@dataclass(frozen=True, eq=False)
class Free:
    """Which numbers of the machine are unknown."""

    placements: np.ndarray
    """(J,) mask of the joints whose origin is unknown."""
    offsets: np.ndarray
    """(J,) mask of the joints whose zero is."""
    gains: np.ndarray
    """(J,) mask of the joints whose scale is."""


@dataclass(frozen=True)
class Options:
    """Options of the chain solver."""

    prior_t: float | None = None
    """One sigma of the nominal positions of the joints, m; None: nothing is known of them beforehand."""
    prior_r: float | None = None
    """One sigma of the nominal directions of the joints and of their zeros, rad."""
    reject_outliers: bool = True
    """Give no weight to poses that the noise does not explain."""
    max_iterations: int = field(default=60, metadata={"min": 1, "max": 10_000})
    """Steps after which the solver gives up and says so."""
    tolerance: float = 1e-2
    """A step shorter than this many standard deviations is the last."""
    sigma_tolerance: float = 3e-3
    """So does, together with it, a relative change of the estimated noise below this."""


@dataclass(frozen=True, eq=False)
class ChainEstimate:
    """A calibrated machine."""

    machine: Machine
    values: Array
    """(N, J) most likely joint values."""
    layout: Layout
    active: np.ndarray
    """(D,) mask of the unknowns that were estimated."""
    covariance: Array
    """(D, D) of the right perturbations, offsets, gains and constants; 0 where they were not estimated."""
    dependent: tuple[Dependence, ...]
    """What was set free and stays at its nominal value, since the poses do not tell it from others."""
    residual: Array
    """(N, 6) observed less predicted, all values at their best: position (m) and rotation vector (rad)."""
    sigma: Array
    """(KINDS,) noise of positions (m), orientations (rad), readings of angles (rad) and of lengths (m)."""
    chi2_per_dof: float
    used: np.ndarray
    """(N,)."""
    iterations: int
    converged: bool


def solve_chain(
    problem: ChainProblem, start: Machine, values: Array, free: Free, options: Options = Options()
) -> ChainEstimate:
    """The most likely machine from ``start``, whose placements are the nominal ones, and from the joint ``values``
    (N, J) there. Raises LinAlgError where the equations are singular."""
    layout = Layout.of(problem, len(start.axes), len(start.T_world_base), len(start.T_last_sensor))
    nominal = _Nominal.of(start, layout, options)
    used, sigma = np.ones(len(problem), dtype=bool), first_sigma(problem, start, values)
    at = normal_equations(start, values, problem, layout, sigma, used)
    choice = identifiable(at.factors, at.length, _stages(layout, free))
    bound = chdtri(np.maximum(6 + problem.read.sum(axis=1) - problem.free.sum(axis=1), 1), OUTLIER_PROBABILITY)
    machine, damping, converged, iteration = start, 0.0, False, 0
    while not converged and iteration < options.max_iterations:
        iteration += 1
        H, g = at.H + np.diag(nominal.precision), at.g + nominal.precision * nominal.departure(machine)
        step = _step(H, g, choice.active, damping)
        new_sigma = _next_sigma(problem, at, step, _covariance(H, choice.active))
        settled = np.allclose(new_sigma, sigma, rtol=options.sigma_tolerance)
        believed = at.distance2 <= bound if options.reject_outliers and (settled or iteration > SETTLING) else used
        changed = bool((believed != used).any())
        trial = moved(machine, layout, step)
        trial_values = values + at.value_step(step, values.shape) + _constant_step(problem, layout, step)
        there = normal_equations(trial, trial_values, problem, layout, new_sigma, believed)
        before = at.cost_at(sigma / new_sigma) + nominal.cost(machine)
        if not changed and not there.cost + nominal.cost(trial) <= before * (1 + 1e-6) + 1e-6:
            damping = max(10 * damping, 1e-6)
            continue
        converged = settled and not changed and damping == 0 and bool(step @ H @ step < options.tolerance**2)
        machine, values, at, used, sigma = trial, trial_values, there, believed, new_sigma
        damping = damping * 0.1 if damping > 1e-8 else 0.0
    C = _covariance(at.H + np.diag(nominal.precision), choice.active)
    values = values + at.value_step(np.zeros(layout.size), values.shape)
    redundancy = max(float(_redundancy(at, C).sum()), 1.0)
    return ChainEstimate(
        machine=machine,
        values=values,
        layout=layout,
        active=choice.active,
        covariance=C,
        dependent=choice.dependent,
        residual=residuals(machine, values, problem),
        sigma=sigma,
        chi2_per_dof=at.cost / redundancy,
        used=used,
        iterations=iteration,
        converged=converged,
    )


def residuals(machine: Machine, values: Array, problem: ChainProblem) -> Array:
    """(N, 6) observed less predicted: position in the predicted sensor frame (m), rotation vector (rad)."""
    found = np.empty((len(problem), 6))
    for poses in problem.groups:
        p, s = int(problem.placement[poses[0]]), int(problem.sensor[poses[0]])
        predicted = machine.poses(values[poses], p, s)
        R, observed = predicted[:, :3, :3], problem.T_world_sensor[poses]
        found[poses, :3] = np.einsum("nji,nj->ni", R, observed[:, :3, 3] - predicted[:, :3, 3])
        found[poses, 3:] = log_so3(np.swapaxes(R, 1, 2) @ observed[:, :3, :3])
    return found


@dataclass(frozen=True, eq=False)
class _Nominal:
    """What is known beforehand: the nominal numbers, each to a sigma."""

    machine: Machine
    layout: Layout
    precision: Array
    """(D,)."""

    @staticmethod
    def of(machine: Machine, layout: Layout, options: Options) -> "_Nominal":
        precision = np.zeros(layout.size)
        for j, slides in enumerate(machine.prismatic):
            own = layout.placement(j)
            if options.prior_t is not None:
                precision[own[:3]] = options.prior_t**-2
            if options.prior_r is not None:
                precision[own[3:]] = options.prior_r**-2
            sigma = options.prior_t if slides else options.prior_r
            precision[layout.offset(j)] = 0.0 if sigma is None else sigma**-2
        return _Nominal(machine, layout, precision)

    def departure(self, machine: Machine) -> Array:
        """(D,) of the machine from the nominal one; 0 for what has no nominal value."""
        found = np.zeros(self.layout.size)
        changed = log_se3(inverse(self.machine.placements) @ machine.placements)
        for j in range(self.layout.joints):
            found[self.layout.placement(j)] = changed[j]
            found[self.layout.offset(j)] = machine.offsets[j] - self.machine.offsets[j]
        return found

    def cost(self, machine: Machine) -> float:
        return float((self.precision * self.departure(machine) ** 2).sum())


def _stages(layout: Layout, free: Free) -> list[np.ndarray]:
    """The unknowns in order of preference: bases and mounts, constants, then what is set free of the joints."""
    joints = [layout.placement(j) for j in np.flatnonzero(free.placements)]
    joints += [np.array([layout.offset(j)]) for j in np.flatnonzero(free.offsets)]
    joints += [np.array([layout.gain(j)]) for j in np.flatnonzero(free.gains)]
    constants = layout.constant(0) + np.arange(layout.constants)
    stages = [layout.always(), constants, np.concatenate(joints) if joints else np.zeros(0, dtype=int)]
    return [stage for stage in stages if stage.size]


def moved(machine: Machine, layout: Layout, step: Array) -> Machine:
    """The machine after a step (D,) of the unknowns."""
    P, J, S = layout.bases, layout.joints, layout.sensors
    base = step[: 6 * P].reshape(P, 6)
    placements = step[layout.placement(0)[0] : layout.offset(0)].reshape(J, 6)
    mounts = step[layout.mount(0)[0] : layout.constant(0)].reshape(S, 6)
    return replace(
        machine,
        T_world_base=machine.T_world_base @ exp_se3(base),
        placements=machine.placements @ exp_se3(placements),
        offsets=machine.offsets + step[layout.offset(0) : layout.gain(0)],
        gains=machine.gains + step[layout.gain(0) : layout.mount(0)[0]],
        T_last_sensor=machine.T_last_sensor @ exp_se3(mounts),
    )


def _constant_step(problem: ChainProblem, layout: Layout, step: Array) -> Array:
    """(N, J) steps of the values that are constants of their sweeps."""
    own = step[layout.constant(0) :]
    return np.where(problem.constant >= 0, own[np.maximum(problem.constant, 0)] if own.size else 0.0, 0.0)


def first_sigma(problem: ChainProblem, machine: Machine, values: Array) -> Array:
    """Of the poses from the median squares, which outliers leave alone, of the residuals at the start."""
    squares = residuals(machine, values, problem) ** 2
    found = np.sqrt(np.median(squares.reshape(-1, 2, 3).sum(axis=2), axis=0) / MEDIAN_CHI2_3)
    return _given_or(problem, np.concatenate([found, FIRST_READING]))


def _next_sigma(problem: ChainProblem, at: Reduced, step: Array, C: Array) -> Array:
    """All noises by Helmert's equations, those of kinds without data left as they are."""
    squares, redundancy = at.squares_after(step), _redundancy(at, C)
    known = np.array([s is not None for s in problem.sigma]) | (np.diagonal(at.counts) <= 0)
    A = at.counts - np.diag(_drawn(at, C))
    A[known] = np.eye(KINDS)[known]
    ratio = np.linalg.solve(A, np.where(known, 1.0, squares))
    alone = np.where(known, 1.0, squares / np.maximum(redundancy, 1.0))
    ratio = ratio if (ratio > LEAST_CHANGE).all() else alone
    return _given_or(problem, np.sqrt(ratio) * at.sigma)


def _given_or(problem: ChainProblem, estimated: Array) -> Array:
    """(KINDS,); exact readings have no rows, so their sigma is never used."""
    given = np.array([np.nan if s is None else s for s in problem.sigma])
    return np.maximum(np.where(np.isfinite(given), given, estimated), SIGMA_FLOOR)


def _drawn(at: Reduced, C: Array) -> Array:
    """(KINDS,) degrees of freedom that the global unknowns take of each kind."""
    return np.einsum("ij,kij->k", C, at.H_by_kind)


def _redundancy(at: Reduced, C: Array) -> Array:
    """(KINDS,) rows of each kind less what the fitted unknowns take of them."""
    return at.counts.sum(axis=1) - _drawn(at, C)


def _covariance(H: Array, active: np.ndarray) -> Array:
    """inv(H) over the active unknowns, scaled to unit information, 0 elsewhere."""
    C = np.zeros_like(H)
    inner = H[np.ix_(active, active)]
    scale = np.sqrt(np.maximum(np.diagonal(inner), 1e-150))
    C[np.ix_(active, active)] = np.linalg.inv(inner / np.outer(scale, scale)) / np.outer(scale, scale)
    return C


def _step(H: Array, g: Array, active: np.ndarray, damping: float) -> Array:
    inner = H[np.ix_(active, active)]
    scale = np.sqrt(np.maximum(np.diagonal(inner), 1e-150))
    A = inner / np.outer(scale, scale) + (damping + 1e-15) * np.eye(len(inner))
    step = np.zeros(len(active))
    step[active] = -np.linalg.solve(A, g[active] / scale) / scale
    return step
