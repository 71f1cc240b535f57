"""What a machine's chain is worth where the tracker distorts or the base creeps: docs/estimation.md, section 16.

The weighted rows of a pose, its own joint values eliminated, are ``U x + Z c + e`` with the chain's unknowns x. The
estimate stays; its covariance grows by B Λ Bᵀ with B = (Uᵀ U)⁻¹ Uᵀ Z.
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers.chain.chain import ChainEstimate
from solvers.chain.equations import rows_beside
from solvers.chain.problem import ORIENTATIONS, POSITIONS, ChainProblem
from solvers.effects.blocks import Cut
from solvers.effects.components import Components, Group
from solvers.effects.process import centred, over_places, over_times
from solvers.effects.rows import Rows
from solvers.effects.variance import Mixed
from solvers.estimate import EffectFound
from solvers.likelihood.correlation import Stretches
from solvers.se3 import Array

LENGTH_M = 0.5
"""Of functions of the place."""
LEAST_BLOCKS = 40
"""Fewer poses tell nothing of effects beside the unknowns of a chain."""
MOST_POSES = 3000
"""Of more, evenly picked ones."""
MOST = 5.0
"""Times the root mean square of the residuals that an effect is taken for, at most."""
EXACT = 1e-6
"""Noise below this, m and rad, is rounding."""
EFFECTS = ("field", "marker", "drift")
KINDS = ("position", "rotation")


@dataclass(frozen=True, eq=False)
class ChainSystematic(Components):
    """The effects in the poses of a chain at their most likely variances."""

    displacement: Array
    """(6, m, B) of the sensor, in its own frame, by unit coefficients: m and rad."""
    active: np.ndarray
    """(D,) mask of the unknowns x."""

    def allowed(self, estimate: ChainEstimate) -> ChainEstimate:
        """The estimate with the covariance that the effects give it, by parts."""
        parts = {}
        for name, share in self.shares(self.drawn).items():
            parts[name] = np.zeros_like(estimate.covariance)
            parts[name][np.ix_(self.active, self.active)] = share
        covariance = estimate.covariance + sum(parts.values())
        return replace(estimate, covariance=covariance, parts=parts, effects=tuple(map(self.effect, self.names)))

    def effect(self, name: str) -> EffectFound:
        """What an effect does to the sensor, as it is predicted."""
        position, rotation = self.rms(name, self.displacement[:, self.columns_of(name)])
        return EffectFound(name, position, rotation)


def chain_systematic(
    problem: ChainProblem, estimate: ChainEstimate, effects: tuple[str, ...] = EFFECTS
) -> ChainSystematic | None:
    """The most likely ``effects`` in the used poses; None where they are too few or exact."""
    used = np.flatnonzero(estimate.used)
    some = used[:: max(1, -(-len(used) // MOST_POSES))]
    part = problem.select(some)
    cut = Cut.of(Stretches.within([part.placement, part.sensor, *part.held.T], part.time_s))
    sigma = estimate.sigma[[POSITIONS, ORIENTATIONS]]
    if len(cut.first) < LEAST_BLOCKS or sigma.max() < EXACT:
        return None
    groups, group, Z = _columns(part, effects)
    at = estimate.machine, estimate.values[some]
    found = rows_beside(*at, part, estimate.layout, estimate.sigma, estimate.active, Z)
    F = cut.mean(found.rows) * np.sqrt(cut.count)
    u, width = int(estimate.active.sum()), F.shape[1]
    fixed = found.readings
    fixed[:u, :u] += np.diag(estimate.precision[estimate.active])
    rows = np.maximum(found.left * len(cut.first) / len(part), 1.0)
    model = Mixed(np.zeros((2, width, width)), fixed, rows, u, group, np.zeros(len(groups)), np.ones(2))
    best = Components.of(groups, Rows.of(F, cut.stretch, model)).pruned()
    residual = estimate.residual[some]
    size = [float(np.sqrt((residual[:, k] ** 2).mean())) for k in (slice(0, 3), slice(3, 6))]
    most = np.array([(MOST * size[KINDS.index(one.kind)]) ** 2 for one in groups])
    moved = cut.mean(np.moveaxis(Z, 0, -1))
    return ChainSystematic(groups, best.rows, best.model, best.rho, moved, estimate.active).capped(most)


def _columns(problem: ChainProblem, effects: tuple[str, ...]) -> tuple[tuple[Group, ...], np.ndarray, Array]:
    """The groups, that of each column, and the displacements (N, 6, m) of the sensor in its own frame."""
    n, R = len(problem), np.swapaxes(problem.T_world_sensor[:, :3, :3], 1, 2)
    over = centred(over_places(problem.T_world_sensor[:, :3, 3], LENGTH_M))
    own = np.broadcast_to(np.eye(3), R.shape)
    every = {
        "field": {"position": _along(over, R), "rotation": _along(over, R)},
        "marker": {"rotation": _along(over, own)},
        "drift": {"position": _along(over_times(problem.placement, problem.time_s), R)},
    }
    groups, group, columns = [], [], [np.zeros((n, 6, 0))]
    for name in effects:
        for kind, moved in every.get(name, {}).items():
            rows = np.zeros((n, 6, moved.shape[2]))
            rows[:, 3 * KINDS.index(kind) : 3 * KINDS.index(kind) + 3] = moved
            group += [len(groups)] * moved.shape[2]
            groups.append(Group(name, kind))
            columns.append(rows)
    return tuple(groups), np.array(group, dtype=int), np.concatenate(columns, axis=2)


def _along(basis: Array, directions: Array) -> Array:
    """(N, 3, 3 K) every direction (N, 3, 3), a column each, as a function of its own, of the ``basis`` (K, N)."""
    return np.einsum("nij,kn->nikj", directions, basis).reshape(len(directions), 3, -1)
