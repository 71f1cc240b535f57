"""The systematic effects: for each what it does to the pose of the sensor, up to unknown coefficients.

An effect is a function of a `Scene`. It returns `Columns`: displacements (m, rad, in the carm frame at the sensor) that
unit coefficients of independent normal distribution cause, in groups of one variance. The square root of a variance
is therefore an amplitude: m or rad, and of `smoothing` s².
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solvers.effects.blocks import Blocks
from solvers.effects.process import DRIFT_ORDERS, Process, grid, legendre, over_places, play
from solvers.likelihood.linearise import Linearisation, linearise
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus

DEFORMATION_LENGTH = 1.5
"""Of the deformation over either angle, rad."""
STEPS = 9
"""Of a grid over an angle's range."""
PLAY_RAD = float(np.radians(0.5))
"""Angle within which a reversal takes up the play."""
FASTEST_STEP_S = 0.1
"""Poses farther apart in time are stops, of which a filter shows nothing."""
SLOPE_S = 0.5
"""Time over which an angle's speed is taken."""
LEAST_SLOPE_POSES = 3


@dataclass(frozen=True, eq=False)
class Columns:
    """What unit coefficients displace, in one frame for all blocks."""

    displacement: Array
    """(6, m, B)."""
    kinds: tuple[str, ...]
    """(m,) which variance each coefficient has: ``position``, ``rotation`` or another one's name."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Where the effects take place: the estimate, block by block."""

    problem: Problem
    torus: Torus
    angles: Array
    """(2, N)."""
    sigma: tuple[float, float]
    """Noise of the fit, m and rad."""
    blocks: Blocks
    field_length: float
    """Of functions of the place, m."""

    @cached_property
    def at(self) -> Array:
        """(2, B) angles of the blocks."""
        return self.angles[:, self.blocks.middle]

    @cached_property
    def range(self) -> tuple[Array, Array]:
        """(2,) least and greatest angles."""
        return self.angles.min(axis=1), self.angles.max(axis=1)

    @cached_property
    def placement(self) -> np.ndarray:
        """(B,)."""
        return self.problem.placement[self.blocks.middle]

    @cached_property
    def poses(self) -> Array:
        """(B, 4, 4) predicted poses of the sensor in the world."""
        return self.torus.poses(self.at.T, self.placement)

    @cached_property
    def R_world_carm(self) -> Array:
        """(B, 3, 3)."""
        return self.poses[:, :3, :3] @ self.torus.T_sensor_carm[:3, :3]

    @cached_property
    def line(self) -> Linearisation:
        """Of the blocks' middle poses."""
        return linearise(self.torus, self.at, self.problem.select(self.blocks.middle))

    @cached_property
    def over_places(self) -> Array:
        """(K, B) basis of a function of the predicted place of the sensor."""
        return over_places(self.poses[:, :3, 3], self.field_length)

    def clock(self, here: np.ndarray) -> Array:
        """Time of some of the blocks, or their number."""
        clock = self.problem.time_s
        return np.arange(len(here), dtype=float) if clock is None else clock[self.blocks.middle[here]]


Effect = Callable[[Scene], Columns | None]
TWIST = ("position",) * 3 + ("rotation",) * 3
"""Kinds of the six components of a twist."""


def deformation(scene: Scene) -> Columns | None:
    """The C bends as a smooth function of both angles, of mean zero over their ranges."""
    return of_twist(_smooth(scene, scene.at))


def gravity(scene: Scene) -> Columns | None:
    """The C bends in proportion to its weight: linear in the vertical as seen from the C and from its swivel."""
    return of_twist(_statics(scene, scene.at))


def field(scene: Scene) -> Columns | None:
    """The tracker distorts as a smooth function of the place, in its own frame."""
    basis = scene.over_places
    turned = np.einsum("kb,bji->ikjb", basis, scene.R_world_carm)
    moved = np.zeros((6, len(basis), 6, basis.shape[1]))
    moved[:3, :, :3] = moved[3:, :, 3:] = turned
    return Columns(moved.reshape(6, -1, basis.shape[1]), TWIST * len(basis))


def marker(scene: Scene) -> Columns | None:
    """The orientation is distorted in the sensor's frame as a smooth function of the place."""
    basis = scene.over_places
    turned = np.zeros((6, len(basis), 3, basis.shape[1]))
    for axis in range(3):
        turned[3 + axis, :, axis] = basis
    return Columns(turned.reshape(6, -1, basis.shape[1]), ("rotation",) * (3 * len(basis)))


def backlash(scene: Scene) -> Columns | None:
    """Either joint's play, which a reversal takes up."""
    order = scene.blocks.order
    basis = np.empty_like(scene.angles)
    for joint, angle in enumerate(scene.angles):
        basis[joint, order] = play(angle[order] / (0.5 * PLAY_RAD))
    return of_twist(scene.blocks.mean(basis))


def drift(scene: Scene) -> Columns | None:
    """The base of each placement creeps as a polynomial of time."""
    columns = []
    for placement in range(scene.problem.placements):
        here = np.flatnonzero(scene.placement == placement)
        waves = legendre(scene.clock(here), DRIFT_ORDERS)
        moved = np.zeros((6, DRIFT_ORDERS, 6, len(scene.placement)))
        moved[..., here] = -scene.line.by_local[:, None, :6, here] * waves[:, None]
        columns.append(moved.reshape(6, -1, len(scene.placement)))
    return Columns(np.concatenate(columns, axis=1), TWIST * (DRIFT_ORDERS * len(columns)))


def smoothing(scene: Scene) -> Columns | None:
    """The tracker's low pass of the time constant τ: positions lag, and cut corners by ½ τ² of their acceleration.

    The part along the motion is the angles'; what is left is that of their speeds.
    """
    speed = _speeds(scene)
    if not speed.any():
        return None
    h = 0.02 / np.abs(speed).max()
    there, back = (scene.torus.poses((scene.at + s * h * speed).T, scene.placement)[:, :3, 3] for s in (1, -1))
    acceleration = (there + back - 2 * scene.poses[:, :3, 3]) / h**2
    moved = np.zeros((6, 1, len(acceleration)))
    moved[:3, 0] = 0.5 * np.einsum("bji,bj->ib", scene.R_world_carm, acceleration)
    return Columns(moved, ("time",))


def remounting(scene: Scene) -> Columns | None:
    """The sensor sits differently on the C in every placement, more than the poses within one placement tell."""
    placements = scene.problem.placements
    if placements < 2:
        return None
    moved = np.zeros((6, placements, 6, len(scene.placement)))
    mount = -scene.line.by_local[:, 8:14]
    for placement in range(placements):
        here = scene.placement == placement
        moved[:, placement][..., here] = mount[..., here]
    return Columns(moved.reshape(6, -1, len(scene.placement)), TWIST * placements)


EFFECTS: dict[str, Effect] = {
    effect.__name__: effect for effect in (deformation, gravity, field, marker, backlash, drift, smoothing, remounting)
}
"""By name."""


def _smooth(scene: Scene, angles: Array) -> Array:
    """(K, n) basis of `deformation` at ``angles`` (2, n)."""
    return Process.over(grid(*scene.range, STEPS), DEFORMATION_LENGTH, centred=True).basis(angles.T)


def _statics(scene: Scene, angles: Array) -> Array:
    """(8, n) basis of `gravity` at ``angles`` (2, n)."""
    return _products(angles) - _products(grid(*scene.range, STEPS).T).mean(axis=1, keepdims=True)


OF_DEFORMATION: dict[str, Callable[[Scene, Array], Array]] = {"deformation": _smooth, "gravity": _statics}
"""Bases of the effects that bend the C, by name; each has six coefficients, of a twist at the sensor."""


def _products(angles: Array) -> Array:
    """(8, n) products of 1, cos and sin of both angles (2, n) but for 1: what a vertical that is fixed in the world is
    made of in the frames of the swivel and of the C."""
    alpha, beta = ((np.ones_like(a), np.cos(a), np.sin(a)) for a in angles)
    return np.stack([a * b for a in alpha for b in beta])[1:]


def of_twist(basis: Array) -> Columns:
    """Every component of a twist in the carm frame as a function of its own, of the ``basis`` (K, n)."""
    K, n = basis.shape
    moved = np.zeros((6, K, 6, n))
    for axis in range(6):
        moved[axis, :, axis] = basis
    return Columns(moved.reshape(6, -1, n), TWIST * K)


def _speeds(scene: Scene) -> Array:
    """(2, B) of both angles, rad/s, by regression on neighbouring poses; 0 where the poses are stops."""
    speed, clock = np.zeros_like(scene.at), scene.problem.time_s
    if clock is None:
        return speed
    order, middle = scene.blocks.order, scene.blocks.middle
    position = np.empty(len(order), dtype=int)
    position[order] = np.arange(len(order))
    for here in scene.blocks.stretches:
        poses = order[here]
        step = np.median(np.diff(clock[poses])) if len(poses) > LEAST_SLOPE_POSES else np.inf
        if not 0 < step <= FASTEST_STEP_S:
            continue
        reach = min(max(LEAST_SLOPE_POSES, round(0.5 * SLOPE_S / step)), (len(poses) - 1) // 2)
        inside = np.flatnonzero(np.isin(middle, poses))
        t = clock[poses] - clock[poses[0]]
        speed[:, inside] = _slopes(t, scene.angles[:, poses], reach)[:, position[middle[inside]] - here.start]
    return speed


def _slopes(t: Array, x: Array, reach: int) -> Array:
    """(2, n) slopes of x (2, n) over t (n,) by regression on ``reach`` neighbours on either side."""
    window = np.ones(2 * reach + 1)

    def total(values: Array) -> Array:
        return np.convolve(values, window, "same")

    n = total(np.ones_like(t))
    mean = total(t) / n
    variance = total(t**2) / n - mean**2
    return np.stack([(total(t * a) / n - mean * total(a) / n) / variance for a in x])
