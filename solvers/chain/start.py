"""Where the chain solver starts: base, mount and all joint values from the nominal machine.

Values that nobody knows are taken from the two-axis solver, with both senses of each axis tried where no label tells
it. Then base and mount follow in closed form (`solvers.chain.robot_world`), and the values that are left by
Gauss-Newton.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from solvers import kinematic
from solvers.chain.chain import residuals
from solvers.chain.equations import Reduced, normal_equations
from solvers.chain.machine import Machine
from solvers.chain.noise import first_sigma
from solvers.chain.problem import ChainProblem, Layout
from solvers.chain.robot_world import robot_world
from solvers.estimate import Note
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import near_median

STATION = 10
"""Least poses on average at one position of the other joints by which these tell one place of the two axes."""
ROUNDS = 12
"""Gauss-Newton steps for the values of joints that neither a reading nor the two-axis solver tells."""


@dataclass(frozen=True, eq=False)
class Start:
    """The nominal machine placed in the world, its sensors mounted."""

    machine: Machine
    values: Array
    """(N, J)."""
    residual: Array
    """(N, 6)."""

    @property
    def agrees(self) -> np.ndarray:
        """(N,) mask of the poses that are no farther off than most."""
        t, w = np.linalg.norm(self.residual.reshape(-1, 2, 3), axis=2).T
        return near_median(t) & near_median(w)

    @property
    def badness(self) -> float:
        """How far off the poses are."""
        return float(np.median(np.linalg.norm(self.residual, axis=1)))


def start_of(problem: ChainProblem, machine: Machine, axes: Sequence[tuple[int, int]]) -> Start | Note:
    """The best start; ``axes`` are the two axes of each sensor's chain. A refusal where the poses do not turn about two
    axes, or nothing links the bases and mounts."""
    found = [_placed(problem, machine, values) for values in _guesses(problem, axes)]
    starts = [start for start in found if isinstance(start, Start)]
    return min(starts, key=lambda start: start.badness) if starts else found[0]


def _guesses(problem: ChainProblem, axes: Sequence[tuple[int, int]]) -> Iterator[Array]:
    """Joint values (N, J), NaN where they are left open."""
    choices = [_angles(problem, s, pair) for s, pair in enumerate(axes)]
    for chosen in product(*choices):
        values = problem.label.copy()
        for part in chosen:
            values = np.where(np.isnan(values), part, values)
        for k in range(problem.constants):
            own = problem.constant == k
            values[own] = _middle(values[own])
        yield values


def _middle(values: Array) -> float:
    """Median of angles that may jump by a turn."""
    return float(values[0] + np.median(np.angle(np.exp(1j * (values - values[0])))))


def _angles(problem: ChainProblem, sensor: int, pair: tuple[int, int]) -> list[Array]:
    """Guesses (N, J) of the two angles of a sensor's chain, where they are unknown; NaN where there is none.

    The two-axis machine is found from the poses whose other joints are known, and from all, as if the other joints
    stood at zero where they are not.
    """
    known = problem.label
    here = np.flatnonzero(problem.sensor == sensor)
    others = np.delete(np.arange(known.shape[1]), pair)
    covered = here[np.isfinite(known[here][:, others]).all(axis=1)]
    nothing = np.full(known.shape, np.nan)
    if np.isfinite(known[here][:, pair]).all():
        return [nothing]
    guesses = []
    for chosen in (covered, here) if 0 < len(covered) < len(here) else (here,):
        guesses += _turns(problem, np.nan_to_num(known), sensor, pair, chosen)
    return guesses or [nothing]


def _turns(
    problem: ChainProblem, known: Array, sensor: int, pair: tuple[int, int], chosen: np.ndarray
) -> Iterator[Array]:
    """The two angles (N, J) of all poses of a sensor, by the two-axis machine of the ``chosen`` ones. It stands
    elsewhere where the other joints do, if they stand still long enough."""
    here = np.flatnonzero(problem.sensor == sensor)
    station = np.delete(known, pair, axis=1)
    station = np.concatenate([problem.placement[:, None], np.round(station, 9)], axis=1)
    number = np.full(len(problem), -1)
    number[chosen] = np.unique(station[chosen], axis=0, return_inverse=True)[1].ravel()
    if len(chosen) < STATION * (number.max() + 1):
        number[chosen] = np.unique(problem.placement[chosen], return_inverse=True)[1]
    for p in np.unique(problem.placement[here]):
        inside = chosen[problem.placement[chosen] == p]
        number[here[(problem.placement[here] == p) & (number[here] < 0)]] = number[inside[0]] if inside.size else 0
    whole = Problem(
        problem.T_world_sensor[:, :3, 3],
        problem.T_world_sensor[:, :3, :3],
        number,
        problem.held[:, pair],
        problem.label[:, pair],
    )
    part = whole.select(chosen)
    try:
        torus = kinematic.solve(part).torus
    except (np.linalg.LinAlgError, ValueError):
        return
    if torus is None:
        return
    alpha, beta = part.zero_labelled
    for senses in product(*((1,) if known else (1, -1) for known in (bool(alpha.all()), beta))):
        values = np.full(known.shape, np.nan)
        values[here[:, None], pair] = torus.angles(whole.select(here)) * senses
        yield values


def _placed(problem: ChainProblem, machine: Machine, values: Array) -> Start | Note:
    """Base and mount for these values; those left open follow."""
    placements, sensors = int(problem.placement.max()) + 1, len(machine.paths)
    known = np.isfinite(values).all(axis=1)
    known = known if known.any() else np.ones(len(values), dtype=bool)
    unit = np.broadcast_to(np.eye(4), (sensors, 4, 4))
    bare = replace(machine, T_world_base=np.eye(4)[None], T_last_sensor=unit)
    F, filled = np.empty((len(problem), 4, 4)), np.nan_to_num(values)
    for s in range(sensors):
        here = problem.sensor == s
        F[here] = bare.poses(filled[here], 0, s)
    found = robot_world(
        problem.T_world_sensor[known], F[known], problem.placement[known], problem.sensor[known], placements, sensors
    )
    if isinstance(found, Note):
        return found
    placed = replace(machine, T_world_base=found.T_world_base, T_last_sensor=found.T_last_sensor)
    if np.isnan(values).any():
        for _ in range(ROUNDS):
            sigma = first_sigma(problem, residuals(placed, filled, problem))
            filled = fit_values(problem, placed, filled, sigma, 1)[0]
    return Start(placed, filled, residuals(placed, filled, problem))


def fit_values(
    problem: ChainProblem, machine: Machine, values: Array, sigma: Array, steps: int
) -> tuple[Array, Reduced]:
    """The values (N, J) after so many Gauss-Newton steps, those of single poses and the constants of sweeps, and the
    equations there with the constants among the unknowns."""
    layout = Layout.of(problem, machine)
    believed, constants = np.ones(len(problem), dtype=bool), layout.constant(0) + np.arange(layout.constants)
    wanted = np.zeros(layout.size, dtype=bool)
    wanted[constants] = True
    at = normal_equations(machine, values, problem, layout, sigma, believed, wanted)
    for _ in range(steps):
        step = np.zeros(layout.size)
        if layout.constants:
            step[constants] = -np.linalg.lstsq(at.H[np.ix_(constants, constants)], at.g[constants], rcond=1e-12)[0]
        values = values + at.value_step(step, values.shape) + layout.constant_step(problem, step)
        at = normal_equations(machine, values, problem, layout, sigma, believed, wanted)
    return values, at
