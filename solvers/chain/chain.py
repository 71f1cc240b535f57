"""Maximum likelihood of a whole machine from its URDF's numbers: docs/estimation.md, section 16.

Unknown are the base in the world for every placement, the mount of every sensor, and those joint placements,
zero offsets and gains that are set free and that the data determine. Joint values are readings with a sigma,
constants of a sweep, or unknown at every pose. Gauss-Newton on the manifold, damped where a step does not descend;
the noises are estimated by Helmert's equations, as in `solvers.kinematic`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import chdtri

from solvers.chain.equations import Reduced, factors, normal_equations
from solvers.chain.identifiable import Dependence, Identifiable, identifiable
from solvers.chain.machine import Machine, pose_residual
from solvers.chain.noise import first_sigma, next_sigma, redundancy
from solvers.chain.nominal import Nominal
from solvers.chain.problem import ORIENTATIONS, POSITIONS, ChainProblem, Layout
from solvers.estimate import Correlation, EffectFound
from solvers.kinematic import OUTLIER_PROBABILITY, SIGMA_FLOOR
from solvers.likelihood.correlation import Stretches, correlation_of, with_correlation
from solvers.se3 import Array, exp_se3

SETTLING = 3
"""Steps before outliers are told from the noise."""
LEAST_BELIEVED = 0.2
"""A noise that explains a smaller share of the poses tells nothing of them."""


@dataclass(frozen=True, eq=False)
class Free:
    """Which numbers of the machine are unknown."""

    placements: np.ndarray
    """(J,) mask of the joints whose origin is unknown."""
    offsets: np.ndarray
    """(J,) mask of the joints whose zero is."""
    gains: np.ndarray
    """(J,) mask of the joints whose scale is."""
    resting: np.ndarray | None = None
    """(J,) mask of the joints whose little motion tells nothing of the others' numbers either; None: none."""

    def only(self, joints: np.ndarray) -> "Free":
        """The same of some of the ``joints`` (J,) alone, while the others are at rest."""
        resting = ~joints if self.resting is None else self.resting | ~joints
        return Free(self.placements & joints, self.offsets & joints, self.gains & joints, resting)


@dataclass(frozen=True)
class Options:
    """Options of the chain solver."""

    prior_t: float | None = field(default=None, metadata={"min": SIGMA_FLOOR})
    """One sigma of the nominal positions of the joints, m; None: nothing is known of them beforehand."""
    prior_r: float | None = field(default=None, metadata={"min": SIGMA_FLOOR})
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
    white: Array
    """(D, D) what the covariance would be if the noise were white: the inverse of the information."""
    correlation: Correlation
    """For how many poses the noise of positions and of orientations lasts; the covariance heeds it."""
    precision: Array
    """(D,) 1 / variance of what was known of each unknown beforehand, 0 without a prior."""
    dependent: tuple[Dependence, ...]
    """What was set free and stays at its nominal value, since the poses do not tell it from others."""
    residual: Array
    """(N, 6) observed less predicted, all values at their best: position (m) and rotation vector (rad)."""
    distance2: Array
    """(N,) squares of the pose's residual and of its readings' errors over the noise, its own values at their best."""
    sigma: Array
    """(KINDS,) noise of positions (m), orientations (rad), readings of angles (rad) and of lengths (m)."""
    chi2_per_dof: float
    """Of all rows over these noises: 1 where all of them were estimated."""
    used: np.ndarray
    """(N,)."""
    iterations: int
    converged: bool
    parts: dict[str, Array] = field(default_factory=dict)
    """(D, D) what every systematic effect adds to the covariance."""
    effects: tuple[EffectFound, ...] = ()
    """Those that the residuals show."""


@dataclass(frozen=True, eq=False)
class _State:
    """Where the iteration stands."""

    machine: Machine
    values: Array
    used: np.ndarray
    at: Reduced


def solve_chain(
    problem: ChainProblem,
    start: Machine,
    values: Array,
    free: Free,
    options: Options = Options(),
    used: np.ndarray | None = None,
) -> ChainEstimate:
    """The most likely machine from ``start``, whose placements are the nominal ones, and from the joint ``values``
    (N, J) there, the poses ``used`` (N,) being believed at first. Raises LinAlgError where the equations are
    singular."""
    layout = Layout.of(problem, start)
    nominal = Nominal.of(start, layout, options.prior_t, options.prior_r)
    used = np.ones(len(problem), dtype=bool) if used is None else used
    sigma = first_sigma(problem, residuals(start, values, problem)[used])
    choice = _choice(problem, start, values, layout, sigma, used, free)
    at = normal_equations(start, values, problem, layout, sigma, used, choice.active)
    state, damping, converged, iteration = _State(start, values, used, at), 0.0, False, 0
    while not converged and iteration < options.max_iterations:
        iteration += 1
        H, g = _with_prior(state, nominal)
        step = _step(H, g, choice.active, damping)
        sigma = next_sigma(problem, state.at, step, covariance_of(H, choice.active))
        settled = np.allclose(sigma, state.at.sigma, rtol=options.sigma_tolerance)
        believed = _believed(problem, state) if settled or iteration > SETTLING else state.used
        believed = believed if options.reject_outliers else state.used
        changed = bool((believed != state.used).any())
        there = _stepped(problem, layout, state, step, sigma, believed, choice.active)
        before = state.at.cost_at(sigma) + nominal.cost(state.machine)
        if not changed and not there.at.cost + nominal.cost(there.machine) <= before * (1 + 1e-6) + 1e-6:
            damping = max(10 * damping, 1e-6)
            continue
        converged = settled and not changed and damping == 0 and bool(step @ H @ step < options.tolerance**2)
        state, damping = there, damping * 0.1 if damping > 1e-8 else 0.0
    return _estimate(problem, layout, nominal, choice, state, iteration, converged)


def _choice(
    problem: ChainProblem, machine: Machine, values: Array, layout: Layout, sigma: Array, used: np.ndarray, free: Free
) -> Identifiable:
    """What of the unknowns is estimated: bases and mounts first, then constants, then what is free of the joints.

    Joints at rest stand at their median there, so that their wobble tells nothing.
    """
    if free.resting is not None:
        values = np.where(free.resting, np.median(values, axis=0), values)
    joints = [layout.placement(j) for j in np.flatnonzero(free.placements)]
    joints += [np.array([layout.offset(j)]) for j in np.flatnonzero(free.offsets)]
    joints += [np.array([layout.gain(j)]) for j in np.flatnonzero(free.gains)]
    constants = layout.constant(0) + np.arange(layout.constants)
    stages = [layout.always(), constants, np.concatenate([np.zeros(0, dtype=int), *joints])]
    wanted = np.zeros(layout.size, dtype=bool)
    wanted[np.concatenate(stages)] = True
    rows, length = factors(machine, values, problem, layout, sigma, used, wanted)
    return identifiable(rows, length, [stage for stage in stages if stage.size])


def _with_prior(state: _State, nominal: Nominal) -> tuple[Array, Array]:
    """Information (D, D) and gradient (D,) of the poses and the prior."""
    H = state.at.H + np.diag(nominal.precision)
    return H, state.at.g + nominal.precision * nominal.departure(state.machine)


def _believed(problem: ChainProblem, state: _State) -> np.ndarray:
    """(N,) mask of the poses that the noise explains; as before where it explains hardly any."""
    dof = np.maximum(6 + problem.read.sum(axis=1) - problem.free.sum(axis=1), 1)
    found = state.at.distance2 <= chdtri(dof, OUTLIER_PROBABILITY)
    return found if found.mean() > LEAST_BELIEVED else state.used


def _stepped(
    problem: ChainProblem,
    layout: Layout,
    state: _State,
    step: Array,
    sigma: Array,
    believed: np.ndarray,
    active: np.ndarray,
) -> _State:
    """After a step of the global unknowns, and of the values that follow them."""
    machine = moved(state.machine, layout, step)
    values = state.values + state.at.value_step(step, state.values.shape) + layout.constant_step(problem, step)
    at = normal_equations(machine, values, problem, layout, sigma, believed, active)
    return _State(machine, values, believed, at)


def _estimate(
    problem: ChainProblem,
    layout: Layout,
    nominal: Nominal,
    choice: Identifiable,
    state: _State,
    iterations: int,
    converged: bool,
) -> ChainEstimate:
    H = _with_prior(state, nominal)[0]
    C = covariance_of(H, choice.active)
    values = state.values + state.at.value_step(np.zeros(layout.size), state.values.shape)
    residual = residuals(state.machine, values, problem)
    correlation = _correlation(problem, residual / np.repeat(state.at.sigma[:2], 3), state.used, choice.active.sum())
    poses = state.at.H_by_kind[POSITIONS], state.at.H_by_kind[ORIENTATIONS]
    return ChainEstimate(
        machine=state.machine,
        values=values,
        layout=layout,
        active=choice.active,
        covariance=with_correlation(C, poses, (correlation.position, correlation.rotation)),
        white=C,
        correlation=correlation,
        precision=nominal.precision,
        dependent=choice.dependent,
        residual=residual,
        distance2=state.at.distance2,
        sigma=state.at.sigma,
        chi2_per_dof=state.at.cost / max(float(redundancy(state.at, C).sum()), 1.0),
        used=state.used,
        iterations=iterations,
        converged=converged,
    )


def _correlation(problem: ChainProblem, residual: Array, used: np.ndarray, unknowns: int) -> Correlation:
    """Of the weighted ``residual`` (N, 6), within the stretches of one placement, sensor and sweep."""
    labels = [problem.placement, problem.sensor, *problem.held.T]
    return correlation_of(residual.T, Stretches.within(labels, problem.time_s, used), float(unknowns))


def residuals(machine: Machine, values: Array, problem: ChainProblem) -> Array:
    """(N, 6) observed less predicted: position in the predicted sensor frame (m), rotation vector (rad)."""
    found = np.empty((len(problem), 6))
    for poses in problem.groups:
        p, s = int(problem.placement[poses[0]]), int(problem.sensor[poses[0]])
        found[poses] = pose_residual(machine.poses(values[poses], p, s), problem.T_world_sensor[poses])
    return found


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


def covariance_of(H: Array, active: np.ndarray) -> Array:
    """inv(H) over the active unknowns, scaled to unit information, 0 elsewhere."""
    C = np.zeros_like(H)
    inner, scale = _scaled(H, active)
    C[np.ix_(active, active)] = np.linalg.inv(inner) / np.outer(scale, scale)
    return C


def _step(H: Array, g: Array, active: np.ndarray, damping: float) -> Array:
    inner, scale = _scaled(H, active)
    step = np.zeros(len(active))
    step[active] = -np.linalg.solve(inner + (damping + 1e-15) * np.eye(len(inner)), g[active] / scale) / scale
    return step


def _scaled(H: Array, active: np.ndarray) -> tuple[Array, Array]:
    """The information of the active unknowns with a unit diagonal, and their scale."""
    inner = H[np.ix_(active, active)]
    scale = np.sqrt(np.maximum(np.diagonal(inner), 1e-150))
    return inner / np.outer(scale, scale), scale
