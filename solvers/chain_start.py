"""Where the chain solver starts: base, mount and all joint values from the nominal machine.

Values that nobody knows are taken from the two-axis solver, for the poses in which only the two axes are unknown, with
both senses of each axis tried where no label tells it. Then base and mount follow in closed form
(`solvers.robot_world`), and the values that are left by Gauss-Newton.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from solvers import kinematic
from solvers.chain import first_sigma, residuals
from solvers.chain_equations import normal_equations
from solvers.chain_problem import ChainProblem, Layout
from solvers.machine import Machine
from solvers.problem import Problem
from solvers.robot_world import RobotWorld, robot_world
from solvers.se3 import Array

VALUE_STEPS = 12
"""Gauss-Newton steps for the values of joints that neither a reading nor the two-axis solver tells."""


@dataclass(frozen=True, eq=False)
class Start:
    """The nominal machine placed in the world, its sensors mounted."""

    machine: Machine
    values: Array
    """(N, J)."""


def start_of(problem: ChainProblem, machine: Machine, axes: Sequence[tuple[int, int]]) -> Start | None:
    """The best start; ``axes`` are the two axes of each sensor's chain. None where the poses do not turn about two
    axes, or nothing links the bases and mounts."""
    found = [start for values in _guesses(problem, axes) if (start := _placed(problem, machine, values))]
    if not found:
        return None
    return min(found, key=lambda start: _badness(problem, start))


def _badness(problem: ChainProblem, start: Start) -> float:
    return float(np.median(np.linalg.norm(residuals(start.machine, start.values, problem), axis=1)))


def _guesses(problem: ChainProblem, axes: Sequence[tuple[int, int]]) -> Iterator[Array]:
    """Joint values (N, J), NaN where they are left open."""
    choices = [_angles(problem, s, pair) for s, pair in enumerate(axes)]
    for chosen in product(*choices):
        values = problem.label.copy()
        for part in chosen:
            unknown = np.isnan(values[part.poses]) & part.mask
            values[part.poses] = np.where(unknown, part.values, values[part.poses])
        for k in range(problem.constants):
            own = problem.constant == k
            values[own] = _middle(values[own])
        yield values


def _middle(values: Array) -> float:
    """Median of angles that may jump by a turn."""
    return float(values[0] + np.median(np.angle(np.exp(1j * (values - values[0])))))


@dataclass(frozen=True, eq=False)
class _Angles:
    """Guessed values (M, J) of some poses, valid where the mask (M, J) is."""

    poses: np.ndarray
    values: Array
    mask: np.ndarray


def _angles(problem: ChainProblem, sensor: int, pair: tuple[int, int]) -> list[_Angles]:
    """Guesses of the two angles of a sensor's chain, where they are not known."""
    here = np.flatnonzero(problem.sensor == sensor)
    others = np.delete(np.arange(problem.label.shape[1]), pair)
    covered = here[np.isfinite(problem.label[here][:, others]).all(axis=1)]
    mask = np.zeros((len(covered), problem.label.shape[1]), dtype=bool)
    mask[:, pair] = True
    nothing = _Angles(covered[:0], np.zeros((0, mask.shape[1])), mask[:0])
    if not covered.size or np.isfinite(problem.label[covered][:, pair]).all():
        return [nothing]
    station = np.concatenate([problem.placement[covered, None], problem.label[covered][:, others]], axis=1)
    two_axis = Problem(
        problem.T_world_sensor[covered, :3, 3],
        problem.T_world_sensor[covered, :3, :3],
        np.unique(np.round(station, 9), axis=0, return_inverse=True)[1].ravel(),
        problem.held[covered][:, pair],
        problem.label[covered][:, pair],
    )
    try:
        angles = kinematic.solve(two_axis).torus
    except (np.linalg.LinAlgError, ValueError):
        return [nothing]
    if angles is None:
        return [nothing]
    found = []
    for senses in product(*(((1,) if known else (1, -1)) for known in two_axis.zero_labelled)):
        values = np.zeros(mask.shape)
        values[:, pair] = angles.angles(two_axis) * senses
        found.append(_Angles(covered, values, mask))
    return found


def _placed(problem: ChainProblem, machine: Machine, values: Array) -> Start | None:
    """Base and mount for these values; those left open follow."""
    placements, sensors = int(problem.placement.max()) + 1, int(problem.sensor.max()) + 1
    known = np.isfinite(values).all(axis=1)
    if not known.any():
        return None
    bare = replace(
        machine, T_world_base=np.eye(4)[None], T_last_sensor=np.broadcast_to(np.eye(4), (sensors, 4, 4)).copy()
    )
    F = np.empty((len(problem), 4, 4))
    for s in range(sensors):
        here = problem.sensor == s
        F[here] = bare.poses(np.nan_to_num(values[here]), 0, s)
    found: RobotWorld | None = robot_world(
        problem.T_world_sensor[known], F[known], problem.placement[known], problem.sensor[known], placements, sensors
    )
    if found is None:
        return None
    placed = replace(machine, T_world_base=found.T_world_base, T_last_sensor=found.T_last_sensor)
    return Start(placed, values if known.all() else _completed(problem, placed, values))


def _completed(problem: ChainProblem, machine: Machine, values: Array) -> Array:
    """The values that are NaN, from zero by Gauss-Newton at a fixed machine."""
    layout = Layout.of(problem, len(machine.axes), len(machine.T_world_base), len(machine.T_last_sensor))
    values, all_of_them, nothing = np.nan_to_num(values), np.ones(len(problem), dtype=bool), np.zeros(layout.size)
    for _ in range(VALUE_STEPS):
        sigma = first_sigma(problem, machine, values)
        at = normal_equations(machine, values, problem, layout, sigma, all_of_them)
        values = values + at.value_step(nothing, values.shape)
    return values
