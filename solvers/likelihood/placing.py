"""Where a known machine stands: the torus fitted to poses while the machine and the sensor mount are held fixed."""

from dataclasses import dataclass, replace

import numpy as np

from solvers.likelihood.elimination import normal_equations
from solvers.likelihood.linearise import TORUS_ROLL, AngleModel, linearise, retract
from solvers.problem import Problem
from solvers.se3 import Array, rot_z
from solvers.torus import Torus

STEPS = 8
"""Most Gauss-Newton steps of one fit."""
SETTLED = 1e-4
"""A step shorter than this many standard deviations ends it."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Poses of a machine that was placed."""

    torus: Torus
    residual: Array
    """(6, N) observed less predicted: position, m, and rotation vector, rad."""
    sigma: tuple[float, float]
    """The noise that the fit assumed, m and rad."""

    @property
    def cost(self) -> float:
        """Weighted sum of squares."""
        return float((self.residual**2 / np.repeat(self.sigma, 3)[:, None] ** 2).sum())

    def mean_square(self, kind: int) -> float:
        """Of the position errors (0), m^2, or the orientation errors (1), rad^2, by pose."""
        return float((self.residual[3 * kind : 3 * kind + 3] ** 2).sum(axis=0).mean())


def place(problem: Problem, machine: Torus, start: Torus, sigma: tuple[float, float]) -> Fit:
    """The torus of every placement, fitted to the poses; ``machine`` gives all the rest, ``start`` where to begin.

    Both angles of every pose are unknown, so no label is needed or used. The sense of the angular axis in ``start``
    may be a convention of another calibration: both are tried, and the better fit is kept.
    """
    blank = problem.without_labels()
    half_turn = np.eye(4)
    half_turn[:3, :3] = rot_z(np.pi)
    starts = start.T_world_torus, start.T_world_torus @ half_turn
    fits = [_placed(blank, replace(machine, T_world_torus=T), sigma) for T in starts]
    return min(fits, key=lambda fit: fit.cost)


def _placed(problem: Problem, torus: Torus, sigma: tuple[float, float]) -> Fit:
    model = AngleModel.of(problem)
    angles = torus.angles(problem).T
    columns = np.arange(6 * problem.placements)
    columns = columns[columns % 6 != TORUS_ROLL]
    for _ in range(STEPS):
        at = normal_equations(torus, angles, problem, model, sigma)
        inner = at.H[np.ix_(columns, columns)]
        step = np.zeros(len(at.g))
        step[columns] = -np.linalg.lstsq(inner, at.g[columns], rcond=1e-12)[0]
        torus, angles = retract(torus, step), angles + at.angle_step(step)
        if step @ at.H @ step < SETTLED**2:
            break
    return Fit(torus, linearise(torus, angles, problem).residual, sigma)
