"""Joint values that nobody knows, fitted to the poses of a machine that stays as it is."""

import numpy as np

from solvers.chain_equations import Reduced, normal_equations
from solvers.chain_problem import ChainProblem, Layout
from solvers.machine import Machine
from solvers.se3 import Array


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
