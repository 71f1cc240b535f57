"""What the chain solver is given, and how its unknowns are numbered."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from solvers.chain.machine import Machine
from solvers.se3 import Array

POSITIONS, ORIENTATIONS, ANGLES, LENGTHS = range(4)
KINDS = 4
"""Kinds of data, each with a noise of its own: positions, orientations, readings of angles, of lengths."""


@dataclass(frozen=True, eq=False)
class ChainProblem:
    """N poses of the sensors of a machine with J joints, m and rad. Nothing is ever modified."""

    T_world_sensor: Array
    """(N, 4, 4)."""
    placement: np.ndarray
    """(N,) number 0..P-1 of the base placement."""
    sensor: np.ndarray
    """(N,) number 0..S-1 of the sensor."""
    held: np.ndarray
    """(N, J) the number of the sweep during which the joint is held still, or -1 where it may move."""
    label: Array
    """(N, J) known joint values, NaN where unknown: of a held joint exact, of a moving one a reading."""
    prismatic: np.ndarray
    """(J,) whether the joint's values are lengths."""
    sigma: tuple[float | None, ...] = (None,) * KINDS
    """Standard deviations of positions (m) and orientations (rad) an axis, and of readings of angles (rad) and of
    lengths (m), 0 for exact readings; None where they are to be estimated."""

    time_s: Array | None = None
    """(N,) when each pose was taken, s; None: the poses stand in the order of time."""

    def __len__(self) -> int:
        return len(self.T_world_sensor)

    @cached_property
    def read(self) -> np.ndarray:
        """(N, J) values known to the sigma of readings."""
        inexact = np.array(self.sigma)[np.where(self.prismatic, LENGTHS, ANGLES)] != 0
        return np.isfinite(self.label) & (self.held < 0) & inexact

    @cached_property
    def free(self) -> np.ndarray:
        """(N, J) values that are unknowns of their own pose: read, or not known at all."""
        return self.read | (~np.isfinite(self.label) & (self.held < 0))

    @cached_property
    def constant(self) -> np.ndarray:
        """(N, J) number of the unknown constant that the value is, -1 where it is none."""
        joints = np.broadcast_to(np.arange(self.label.shape[1]), self.label.shape)
        unknown = ~np.isfinite(self.label) & (self.held >= 0)
        number = np.full(self.label.shape, -1)
        if unknown.any():
            key = np.stack([self.held[unknown], joints[unknown]], axis=1)
            number[unknown] = np.unique(key, axis=0, return_inverse=True)[1].ravel()
        return number

    @cached_property
    def still(self) -> np.ndarray:
        """(J,) joints that stand at one and the same known value in all poses."""
        return (~self.free & (self.constant < 0) & (self.label == self.label[:1])).all(axis=0)

    @property
    def constants(self) -> int:
        """How many unknown constants there are."""
        return int(self.constant.max(initial=-1)) + 1

    def select(self, poses: np.ndarray) -> "ChainProblem":
        """The problem of some of the poses."""
        names = ("T_world_sensor", "placement", "sensor", "held", "label")
        time_s = None if self.time_s is None else self.time_s[poses]
        return replace(self, time_s=time_s, **{name: getattr(self, name)[poses] for name in names})

    @cached_property
    def groups(self) -> tuple[np.ndarray, ...]:
        """Poses (indices) with the same sensor, base placement and unknown constants."""
        key = np.concatenate([self.placement[:, None], self.sensor[:, None], self.constant], axis=1)
        number = np.unique(key, axis=0, return_inverse=True)[1].ravel()
        order = np.argsort(number, kind="stable")
        return tuple(np.split(order, np.flatnonzero(np.diff(number[order])) + 1))


@dataclass(frozen=True)
class Layout:
    """Where each unknown stands in the vector of all: bases, joint placements, offsets, gains, mounts, constants."""

    bases: int
    joints: int
    sensors: int
    constants: int

    @staticmethod
    def of(problem: ChainProblem, machine: Machine) -> "Layout":
        """Of a problem and its machine."""
        return Layout(len(machine.T_world_base), len(machine.axes), len(machine.T_last_sensor), problem.constants)

    @property
    def size(self) -> int:
        """D."""
        return self.constant(self.constants)

    def base(self, p: int | np.integer) -> np.ndarray:
        """(6,) of T_world_base[p]."""
        return 6 * p + np.arange(6)

    def placement(self, j: int | np.integer) -> np.ndarray:
        """(6,) of the placement of joint j."""
        return 6 * (self.bases + j) + np.arange(6)

    def offset(self, j: int | np.integer) -> int:
        """Of the joint's zero offset."""
        return 6 * (self.bases + self.joints) + j

    def gain(self, j: int | np.integer) -> int:
        """Of the joint's gain."""
        return self.offset(self.joints) + j

    def mount(self, s: int | np.integer) -> np.ndarray:
        """(6,) of T_last_sensor[s]."""
        return self.gain(self.joints) + 6 * s + np.arange(6)

    def constant(self, k: int) -> int:
        """Of the k-th unknown constant."""
        return self.gain(self.joints) + 6 * self.sensors + k

    def always(self) -> np.ndarray:
        """Bases and mounts, which nothing else fixes."""
        found = [self.base(p) for p in range(self.bases)] + [self.mount(s) for s in range(self.sensors)]
        return np.concatenate(found)

    def constant_step(self, problem: ChainProblem, step: Array) -> Array:
        """(N, J) steps of the values that are constants of their sweeps, of a step (D,) of all unknowns."""
        return np.append(step[self.constant(0) :], 0.0)[problem.constant]
