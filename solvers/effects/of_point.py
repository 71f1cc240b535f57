"""What a fixed point is worth where the tracker distorts or the base creeps.

The residual ``g_i = R_i t + p_i - c`` of the poses is, with the errors x of t along what is told and of c,

    g_i = U_i x + Σ_g Z_ig c_g + e_i,    U_i = [R_i Dᵀ, -I],    Z_i = displacement of the position, and turn × R_i t

and the estimate has, beside its own, the covariance B Λ Bᵀ with B = (Uᵀ U)⁻¹ Uᵀ Z: docs/estimation.md, "A fixed point".
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from solvers.effects.blocks import Cut
from solvers.effects.components import Components, Group
from solvers.effects.process import centred, over_places, over_times
from solvers.effects.rows import Rows
from solvers.effects.variance import Mixed
from solvers.estimate import Covariance, EffectFound, Estimate, SigmaPart, Told
from solvers.likelihood.correlation import Stretches
from solvers.problem import Problem
from solvers.se3 import Array, skew

LENGTHS = (0.5, 0.3, 0.8)
"""Of functions of the place, m."""
LEAST_BLOCKS = 20
"""Fewer poses tell nothing of effects."""
MOST = 5.0
"""Times the root mean square of the residuals that an effect may displace the tip by: of a field that hardly changes
where the poses are, they tell too little to say that it is greater."""
EXACT_M = 1e-7
"""Residuals below this are rounding."""


@dataclass(frozen=True, eq=False)
class PointScene:
    """The poses, block by block, at the estimate."""

    problem: Problem
    t: Array
    """(3,), m."""
    length: float
    """Of functions of the place, m."""

    @cached_property
    def cut(self) -> Cut:
        """The poses in blocks."""
        return Cut.of(Stretches.of(self.problem))

    @cached_property
    def over_places(self) -> Array:
        """(K, B) basis of a function of the place of the sensor, of mean zero over the poses."""
        return centred(over_places(self.problem.p_world_sensor[self.cut.middle], self.length))

    @cached_property
    def R(self) -> Array:
        """(B, 3, 3)."""
        return self.problem.rotations[self.cut.middle]

    @cached_property
    def by_turn(self) -> Array:
        """(3, 3, B) displacement of the tip by a turn of the sensor about the axes of the world, a column each."""
        return np.moveaxis(-skew(self.R @ self.t), 0, -1)

    @property
    def every_way(self) -> Array:
        """(3, 3, B) displacement of the tip along the axes of the world."""
        return np.broadcast_to(np.eye(3)[:, :, None], (3, 3, len(self.cut.first)))


Effect = Callable[[PointScene], dict[str, Array] | None]
"""Displacements (3, m, B) of the tip by unit coefficients, by the kind of their variance."""


def field(scene: PointScene) -> dict[str, Array]:
    """The tracker distorts as a smooth function of the place, in its own frame."""
    return {
        "position": _along(scene.over_places, scene.every_way),
        "rotation": _along(scene.over_places, scene.by_turn),
    }


def marker(scene: PointScene) -> dict[str, Array]:
    """The orientation is distorted as a smooth function of the place, in a frame that is fixed to the sensor.

    The mean over the poses belongs to that frame.
    """
    return {"rotation": _along(scene.over_places, np.moveaxis(-scene.R @ skew(scene.t), 0, -1))}


def drift(scene: PointScene) -> dict[str, Array]:
    """What the point stands on creeps as a polynomial of time, in every placement."""
    middle, clock = scene.cut.middle, scene.problem.time_s
    waves = over_times(scene.problem.placement[middle], None if clock is None else clock[middle])
    return {"position": _along(waves, scene.every_way)}


def remounting(scene: PointScene) -> dict[str, Array] | None:
    """The sensor sits differently on the pointer in every placement."""
    placement, P = scene.problem.placement[scene.cut.middle], scene.problem.placements
    if P < 2:
        return None
    return {"position": _along(np.eye(P)[placement].T, np.moveaxis(scene.R, 0, -1))}


EFFECTS: dict[str, Effect] = {effect.__name__: effect for effect in (field, marker, drift, remounting)}


def _along(basis: Array, directions: Array) -> Array:
    """(3, 3 K, B) every direction (3, 3, B) as a function of its own, of the ``basis`` (K, B)."""
    return np.einsum("ijb,kb->ikjb", directions, basis).reshape(3, -1, basis.shape[1])


@dataclass(frozen=True, eq=False)
class PointSystematic(Components):
    """The effects in the poses of a pointer at their most likely variances."""

    displacement: Array
    """(3, m, B) of the tip by unit coefficients, m."""
    directions: Array
    """(K, 3) along which t is told."""

    def allowed(self, estimate: Estimate) -> Estimate:
        """The estimate with the covariance that the effects give it, by parts."""
        u, shares = self.model.unknowns, self.shares(self.drawn)
        told, effects = _widened(estimate.told, sum(shares.values())), tuple(map(self.effect, self.names))
        if estimate.covariance is None or not shares:
            return replace(estimate, told=told, effects=effects)
        stated, K = estimate.covariance, len(self.directions)
        J = np.zeros((len(stated.names), u))
        J[:3, :K] = self.directions.T
        J[3:, K:] = np.eye(u - K)
        parts = {"noise": stated.matrix, **{name: J @ share @ J.T for name, share in shares.items()}}
        covariance = Covariance(stated.names, np.sum([*parts.values()], axis=0))
        by_part = tuple(SigmaPart(name, Covariance(stated.names, part)) for name, part in parts.items())
        return replace(estimate, told=told, covariance=covariance, sigma_parts=by_part, effects=effects)

    def effect(self, name: str) -> EffectFound:
        """What an effect does to the tip, as it is predicted."""
        (moved,) = self.rms(name, self.displacement[:, self.columns_of(name)])
        return EffectFound(name, moved, 0.0)


def _widened(told: Told | None, added: Array | int) -> Told | None:
    if told is None or isinstance(added, int):
        return told
    return replace(told, sigma=np.sqrt(told.sigma**2 + np.diagonal(added)[: len(told.sigma)]))


def point_systematic(
    problem: Problem, directions: Array, t: Array, residual: Array, effects: tuple[str, ...] = tuple(EFFECTS)
) -> PointSystematic | None:
    """The most likely ``effects`` in the poses of ``problem``, whose residuals (N, 3) the point t (3,), told along the
    ``directions`` (K, 3), leaves; None where the poses are too few or exact."""
    sigma = float(np.sqrt((residual**2).mean()))
    scenes = [PointScene(problem, t, length) for length in LENGTHS]
    if len(scenes[0].cut.first) < LEAST_BLOCKS or sigma < EXACT_M:
        return None
    found = [_in_scene(scene, directions, residual, sigma, effects) for scene in scenes]
    best = max(found, key=lambda one: one.model.log_likelihood).pruned()
    lever = {"position": 1.0, "rotation": max(float(np.linalg.norm(t)), EXACT_M)}
    most = np.array([(MOST * sigma / lever[group.kind]) ** 2 for group in best.groups])
    return best.capped(most)


def _in_scene(
    scene: PointScene, directions: Array, residual: Array, sigma: float, effects: tuple[str, ...]
) -> PointSystematic:
    every = {name: EFFECTS[name](scene) for name in effects if name in EFFECTS}
    kinds = [(Group(name, kind), Z) for name, of_kind in every.items() if of_kind for kind, Z in of_kind.items()]
    groups = tuple(group for group, _ in kinds)
    Z = np.concatenate([np.zeros((3, 0, len(scene.cut.first))), *(moved for _, moved in kinds)], axis=1)
    group = np.repeat(np.arange(len(groups)), [moved.shape[1] for _, moved in kinds]).astype(int)
    R, P = np.moveaxis(scene.problem.rotations, 0, -1), scene.problem.placements
    own = np.eye(P)[scene.problem.placement].T
    U = np.concatenate([np.einsum("ijn,kj->ikn", R, directions), -_along(own, np.eye(3)[:, :, None] + 0 * R)], axis=1)
    root = np.sqrt(scene.cut.count) / sigma
    F = np.concatenate([scene.cut.mean(U), Z, scene.cut.mean(residual.T)[:, None]], axis=1) * root
    u, width = U.shape[1], F.shape[1]
    rows = np.array([3.0 * len(scene.cut.first)])
    model = Mixed(
        np.zeros((1, width, width)), np.zeros((width, width)), rows, u, group, np.zeros(len(groups)), np.ones(1)
    )
    found = Components.of(groups, Rows.of(F, scene.cut.stretch, model))
    return PointSystematic(groups, found.rows, found.model, found.rho, Z, directions)
