"""What a solver returns."""

from dataclasses import dataclass, field, replace

import numpy as np

from solvers.problem import NoiseShape, Problem
from solvers.se3 import Array
from solvers.torus import Torus

MEANINGLESS_M, MEANINGLESS_RAD = 0.020, float(np.radians(10.0))
"""A quantity of a greater standard deviation is not determined, and that is said instead of the number."""


@dataclass(frozen=True)
class Note:
    """A warning as a value: a stable code and a sentence."""

    code: str
    message: str


@dataclass(frozen=True, eq=False)
class Covariance:
    """Covariance of the reported quantities, in m and rad."""

    names: tuple[str, ...]
    """One name a row, such as ``offset_sensor_pivot_x`` or ``major_radius``."""
    matrix: Array
    """(K, K)."""

    def sigma(self, *names: str) -> Array:
        """One-sigma values of the named quantities."""
        index = [self.names.index(name) for name in names]
        return np.sqrt(np.maximum(np.diagonal(self.matrix)[index], 0.0))

    def select(self, index: list[int]) -> "Covariance":
        """The covariance of some of the quantities."""
        return Covariance(tuple(self.names[i] for i in index), self.matrix[np.ix_(index, index)])

    def block(self, prefix: str) -> Array:
        """The covariance of all quantities whose name starts with ``prefix``."""
        return self.select([i for i, name in enumerate(self.names) if name.startswith(prefix)]).matrix


@dataclass(frozen=True)
class Correlation:
    """For how many poses the noise lasts, 1 where it is white (`solvers.likelihood.correlation`)."""

    position: float = 1.0
    rotation: float = 1.0

    @property
    def longest(self) -> float:
        """Of both kinds; so many poses count as one."""
        return max(self.position, self.rotation)


@dataclass(frozen=True, eq=False)
class SigmaPart:
    """What one cause adds to the covariance of the reported quantities."""

    name: str
    """``noise``, ``correlation`` (that the noise lasts), or one of `solvers.effects.columns.EFFECTS`."""
    covariance: Covariance


@dataclass(frozen=True)
class EffectFound:
    """A systematic effect as it shows in the poses."""

    name: str
    position_m: float
    """Root mean square displacement of the sensor, m, and"""
    rotation_rad: float
    """turn, rad, over the poses."""


@dataclass(frozen=True, eq=False)
class Deformed:
    """The sensor's mount as a function of the angles, at M pairs of them that fill a grid, beta running faster."""

    angles: Array
    """(M, 2) alpha and beta, rad."""
    shift: Array
    """(M, 3) of the rotation centre in the sensor's frame from ``offset``, m."""
    turn: Array
    """(M, 3) of the carm frame, rotation vector in the sensor's frame, rad."""
    covariance: Array
    """(M, 3, 3) of the offset at these angles, m²."""
    low: Array
    """(2,) least calibrated angles, and"""
    high: Array
    """(2,) greatest ones."""


@dataclass(frozen=True, eq=False)
class Told:
    """What the motion tells of the offset t: its components along K orthonormal directions of the sensor's frame."""

    directions: Array
    """(K, 3) a row each."""
    offset: Array
    """(K,) d . t, m."""
    sigma: Array
    """(K,) of ``offset``, m."""
    untold: Array
    """(3 - K, 3) the directions along which nothing is told."""
    untold_sigma: Array
    """(3 - K,) by how much each of them may be off, rad."""

    @property
    def complete(self) -> bool:
        """Whether the whole offset is told."""
        return not len(self.untold)


@dataclass(frozen=True, eq=False)
class Estimate:
    """A solver's answer, m and rad. What the solver or the locus cannot determine is None."""

    solver: str
    center: Array
    """c (P, 3): the centre of the pivot's locus in the world."""
    torus: Torus | None = None
    """The complete chain, where the solver determines it."""
    offset: Array | None = None
    """t (3,): the pivot in sensor coordinates."""
    angular_axis: Array | None = None
    """n (P, 3)."""
    major_radius: float | None = None
    """R, signed by the directions of the two axes."""
    minor_radius: float | None = None
    angles: Array | None = None
    """alpha, beta (N, 2) of every pose, where the solver estimates them."""
    sigma_t: float | None = None
    """Position noise an axis, m, as estimated or given."""
    sigma_r: float | None = None
    """Orientation noise an axis, rad, as estimated or given."""
    shape: NoiseShape | None = None
    """How the noise differs by the tracker's axes; None: it does not."""
    used: np.ndarray | None = None
    """(N,) which poses had a say; None: all."""
    sigma_label: Array | None = None
    """(N, 2) `Problem.sigma_label` as the solver took it after weighing the labels; None: as it was given."""
    soft: np.ndarray | None = None
    """(N, 2) `Problem.soft` as the solver took it."""
    residual: Array | None = None
    """(N, K) what the solver's own model leaves of each pose, m, where there is no complete chain."""
    covariance: Covariance | None = None
    correlation: Correlation | None = None
    """How long the noise lasts; the covariance heeds it."""
    sigma_parts: tuple[SigmaPart, ...] = ()
    """What the covariance is made of; empty where systematic effects were not looked for."""
    effects: tuple[EffectFound, ...] = ()
    """Those that the residuals show."""
    deformed: Deformed | None = None
    """None where the C is rigid, or its deformation was not estimated."""
    null_direction_sensor: Array | None = None
    """(3,) direction of the offset that the energy leaves undetermined (published gauge only)."""
    unobservable: tuple[str, ...] = ()
    """What the data or the energy leave undetermined, in words, where the solver knows it."""
    told: Told | None = None
    """What of the offset is told, where the solver asks; where that is not all of it, ``offset`` is None."""
    iterations: int = 0
    converged: bool = True
    notes: tuple[Note, ...] = field(default=())

    def weighed(self, problem: Problem) -> Problem:
        """The problem with the noise of poses and labels, and the joints that slip, as the solver took it."""
        problem = problem.softened(self.soft)
        labelled = problem if self.sigma_label is None else replace(problem, sigma_label=self.sigma_label)
        return labelled if self.shape is None else replace(labelled, shape=self.shape)

    @staticmethod
    def of_torus(solver: str, torus: Torus, **more) -> "Estimate":
        """An estimate of the complete chain."""
        return Estimate(
            solver,
            center=torus.center,
            torus=torus,
            offset=torus.offset,
            angular_axis=torus.angular_axis,
            major_radius=torus.major_radius,
            minor_radius=torus.minor_radius,
            **more,
        )
