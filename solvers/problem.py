"""What a solver is given: poses, and what is known of the two joint angles."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from solvers.se3 import Array

ANGULAR, ORBITAL = 0, 1
"""Columns of `Problem.held` and `Problem.label`."""


@dataclass(frozen=True, eq=False)
class NoiseShape:
    """Covariances of the noise in the tracker's frame, over `Problem.sigma_t` and `Problem.sigma_r` squared.

    Their traces are 3, so that these are root mean squares over the axes.
    """

    position: Array
    """(3, 3)."""
    rotation: Array
    """(3, 3) of turns about the tracker's axes."""


@dataclass(frozen=True, eq=False)
class Problem:
    """N poses of the sensor in the world, in metres and radians. Nothing is ever modified."""

    p_world_sensor: Array
    """(N, 3) sensor positions, m."""
    R_world_sensor: Array | None
    """(N, 3, 3) sensor orientations, or None where only positions were recorded."""
    placement: np.ndarray
    """(N,) number 0..P-1 of the base placement of each pose."""
    held: np.ndarray
    """(N, 2) for the angular and the orbital joint: the number of the sweep during which the joint
    is held still, or -1 where it moves freely."""
    label: Array
    """(N, 2) known joint angles, rad, NaN where unknown: of a held joint its label, good to `sigma_label`, of a
    moving joint its reading, good to `sigma_reading`."""
    sigma_reading: float = float(np.radians(0.5))
    """Standard deviation of a moving joint's reading, rad."""
    sigma_label: Array | None = None
    """(N, 2) standard deviation of the label of a held joint, rad, an error that all poses of its sweep have in
    common; 0, or None for all: exact; infinite: the label has no say.
    Where a pose holds both joints, the orbital one's label is exact."""
    sigma_t: float | None = None
    """Position noise an axis, m; None: estimated from the data."""
    sigma_r: float | None = None
    """Orientation noise an axis, rad; None: estimated from the data."""
    scale: Array | None = None
    """(2, N) noise of each position and orientation over `sigma_t` and `sigma_r`, which are then root mean squares;
    None: 1. `kinematic` heeds it."""
    shape: NoiseShape | None = None
    """None: the noise is isotropic. `kinematic` estimates it."""
    soft: np.ndarray | None = None
    """(N, 2) mask of the poses at which a held joint does not stay where it is, its angle unknown; None: at none."""
    time_s: Array | None = None
    """(N,) when each pose was taken, s; None: the poses stand in the order of time."""

    @staticmethod
    def of_poses(p_world_sensor: Array, R_world_sensor: Array | None) -> "Problem":
        """Poses of one placement of which nothing else is known."""
        n = len(p_world_sensor)
        return Problem(
            p_world_sensor,
            R_world_sensor,
            placement=np.zeros(n, dtype=int),
            held=np.full((n, 2), -1),
            label=np.full((n, 2), np.nan),
        )

    def __len__(self) -> int:
        return len(self.p_world_sensor)

    @cached_property
    def placements(self) -> int:
        """P, the number of base placements."""
        return int(self.placement.max()) + 1 if len(self) else 0

    @cached_property
    def zero_labelled(self) -> tuple[np.ndarray, bool]:
        """(P,) whether a label or reading holds alpha = 0 of each placement, and whether one holds beta = 0."""
        known = np.isfinite(self.label)
        alpha = np.array([known[self.placement == p, ANGULAR].any() for p in range(self.placements)], dtype=bool)
        return alpha, bool(known[:, ORBITAL].any())

    @cached_property
    def still(self) -> np.ndarray:
        """(N, 2) mask of the joints that stand at one angle through their sweep."""
        held = self.held >= 0
        return held if self.soft is None else held & ~self.soft

    @cached_property
    def label_read(self) -> np.ndarray:
        """(N, 2) mask of the labels of held joints that are not exact."""
        if self.sigma_label is None:
            return np.zeros(self.held.shape, dtype=bool)
        read = self.still & np.isfinite(self.label) & (self.sigma_label > 0)
        read[:, ORBITAL] &= ~self.still[:, ANGULAR]
        return read

    @property
    def rotations(self) -> Array:
        """`R_world_sensor`, for solvers that need it; raises ValueError where it was not recorded."""
        if self.R_world_sensor is None:
            raise ValueError("the recording has no orientations")
        return self.R_world_sensor

    def sweeps(self, held: int) -> list[np.ndarray]:
        """The pose indices of every sweep during which joint ``held`` (ANGULAR or ORBITAL) is held
        and the other one moves."""
        mask = (self.held[:, held] >= 0) & (self.held[:, 1 - held] < 0)
        index = np.flatnonzero(mask)
        if not index.size:
            return []
        order = index[np.argsort(self.held[index, held], kind="stable")]
        return np.split(order, np.flatnonzero(np.diff(self.held[order, held])) + 1)

    def select(self, poses: np.ndarray | slice) -> "Problem":
        """The problem of some of the poses, by index, mask or slice; placements keep their numbers."""
        R = self.R_world_sensor
        return replace(
            self,
            p_world_sensor=self.p_world_sensor[poses],
            R_world_sensor=None if R is None else R[poses],
            placement=self.placement[poses],
            held=self.held[poses],
            label=self.label[poses],
            scale=None if self.scale is None else self.scale[:, poses],
            soft=None if self.soft is None else self.soft[poses],
            time_s=None if self.time_s is None else self.time_s[poses],
            sigma_label=None if self.sigma_label is None else self.sigma_label[poses],
        )

    def apart(self, poses: np.ndarray) -> "Problem":
        """The same with the ``poses``, by index, in one more placement and in sweeps of their own."""
        placement, held = self.placement.copy(), self.held.copy()
        placement[poses] = self.placements
        held[poses] = np.where(held[poses] >= 0, held[poses] + held.max(initial=0) + 1, -1)
        return replace(self, placement=placement, held=held)

    def without_labels(self) -> "Problem":
        """The same poses with nothing known of the joints."""
        blank = Problem.of_poses(self.p_world_sensor, self.R_world_sensor)
        return replace(self, held=blank.held, label=blank.label, sigma_label=None, soft=None)

    def softened(self, soft: np.ndarray | None) -> "Problem":
        """The same where a held joint is `soft`; what its label says there is passed over."""
        return self if soft is None else replace(self, soft=soft, label=np.where(soft, np.nan, self.label))
