"""What is known of a machine beforehand: the numbers of its drawing, each to a standard deviation."""

from dataclasses import dataclass

import numpy as np

from solvers.chain.machine import Machine
from solvers.chain.problem import Layout
from solvers.se3 import Array, inverse, log_se3


@dataclass(frozen=True, eq=False)
class Nominal:
    """Independent normal priors of the joints' placements and zeros about those of a machine."""

    machine: Machine
    layout: Layout
    precision: Array
    """(D,) 1 / variance; 0 where nothing is known."""

    @staticmethod
    def of(machine: Machine, layout: Layout, sigma_t: float | None, sigma_r: float | None) -> "Nominal":
        """Positions known to ``sigma_t`` (m), directions and zeros of turning joints to ``sigma_r`` (rad), if any."""
        of_length, of_angle = (0.0 if sigma is None else sigma**-2 for sigma in (sigma_t, sigma_r))
        precision = np.zeros(layout.size)
        for j, slides in enumerate(machine.prismatic):
            own = layout.placement(j)
            precision[own[:3]], precision[own[3:]] = of_length, of_angle
            precision[layout.offset(j)] = of_length if slides else of_angle
        return Nominal(machine, layout, precision)

    def departure(self, machine: Machine) -> Array:
        """(D,) of the ``machine`` from this one; 0 for what has no nominal value."""
        found = np.zeros(self.layout.size)
        changed = log_se3(inverse(self.machine.placements) @ machine.placements)
        for j in range(self.layout.joints):
            found[self.layout.placement(j)] = changed[j]
            found[self.layout.offset(j)] = machine.offsets[j] - self.machine.offsets[j]
        return found

    def cost(self, machine: Machine) -> float:
        """Squared departure in standard deviations."""
        return float((self.precision * self.departure(machine) ** 2).sum())
