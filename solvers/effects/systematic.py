"""What an estimate of the chain is worth where the machine bends and the tracker distorts.

The residual r of a block of poses, of which the poses' own angles are eliminated, is

    r = -J x + Σ_g Z_g c_g + e,    c_g ~ N(0, λ_g I),    e_k ~ N(0, d_k I)

with the unknowns x of the chain at its estimate, effects g of `columns` and the noise of kind k, which counts T_k times
where it lasts. Variances by restricted likelihood (`variance`). Where the data ask for effects the estimate is that of
all this together, else the maximum-likelihood one with the covariance that the effects give it:

    Cov = C (Σ_k d_k J_kᵀ J_k) C + B Λ Bᵀ,    C = (Jᵀ J)⁻¹,  B = C Jᵀ Z
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers.effects.blocks import Blocks
from solvers.effects.columns import EFFECTS, Columns, Scene
from solvers.effects.components import Components, Group
from solvers.effects.rows import Rows
from solvers.effects.variance import Mixed
from solvers.estimate import Correlation, EffectFound, Note
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus

FIELD_LENGTHS = (0.5, 0.3, 0.8)
"""Of functions of the place, m; the most likely is taken, the others only where the first finds any."""
OF_PLACE = ("field", "marker")
LEAST_BLOCKS = 20
"""Fewer poses tell nothing of effects."""
DISAGREE = 4.75
"""Gain in log-likelihood of a variance between placements that chance makes once in a thousand."""
EXACT = 1e-6
"""Noise below this, m and rad, is rounding, and so are its effects."""


@dataclass(frozen=True, eq=False)
class Parted:
    """Henderson's equations of all, and of some of the blocks, in unknowns and coefficients that are scaled."""

    whole: Array
    """(v, v)."""
    parts: list[Array]
    """(v, v) each."""
    gradients: list[Array]
    """(v,) each, Fᵀ r of what is left of the rows."""
    scale: Array
    """(v,) unknowns per scaled one."""


@dataclass(frozen=True, eq=False)
class Systematic(Components):
    """The effects in the poses of a C-arm at their most likely variances."""

    scene: Scene
    columns: dict[str, Columns]
    """By effect."""

    @staticmethod
    def within(scene: Scene, effects: tuple[str, ...]) -> "Systematic":
        """Those of the ``effects`` that the data ask for."""
        columns = _columns(scene, effects)
        groups = tuple(dict.fromkeys(Group(name, kind) for name, found in columns.items() for kind in found.kinds))
        found = Components.of(groups, _rows(scene.blocks, columns, groups))
        return Systematic(groups, found.rows, found.model, found.rho, scene, columns)

    def of_length(self, length: float) -> "Systematic":
        """The same with another length (m) of the functions of the place, which alone depend on it."""
        scene = replace(self.scene, field_length=length)
        columns = self.columns | _columns(scene, tuple(name for name in OF_PLACE if name in self.columns))
        rows = _rows(scene.blocks, columns, self.groups)
        model = rows.whitened(self.rho, self.model)
        return replace(self, rows=rows, model=model, scene=scene, columns=columns).climbed()

    @property
    def note(self) -> Note | None:
        """Whether the placements disagree about where the sensor sits on the C."""
        if "remounting" not in self.names or self.gain_of("remounting") < DISAGREE:
            return None
        variances = dict(zip(self.groups, self.model.variance, strict=True))
        shift, turn = (np.sqrt(variances[Group("remounting", kind)]) for kind in ("position", "rotation"))
        return Note(
            "placements_disagree",
            f"the placements of the base disagree about where the sensor sits on the C by {shift * 1e3:.2g} mm and "
            f"{np.degrees(turn):.2g} deg (one sigma an axis), more than noise and other effects explain; the ± allows "
            "for it, and more placements would tell it better",
        )

    def parted(self, parts: list[np.ndarray]) -> "Parted":
        """Henderson's equations at the solution, and what each of the ``parts``, blocks by index, adds to them."""
        model = self.model
        F = self.rows.independent(self.rho) / np.sqrt(np.repeat(model.noise, 3))[:, None]
        left = np.einsum("wrb,w->rb", F, model.residual)
        F = np.concatenate([F[model.index] * model.scale[:, None, None], left[None]])
        some = (F[..., part].reshape(len(F), -1) for part in parts)
        sums = [here @ here.T for here in some]
        return Parted(model.equations, [M[:-1, :-1] for M in sums], [M[:-1, -1] for M in sums], model.scale)

    @property
    def correlation(self) -> Correlation:
        """For how many poses the noise lasts, beside the effects."""
        return Correlation(*np.maximum(self.model.noise * (1 + self.rho) / (1 - self.rho), 1.0).tolist())

    @property
    def step(self) -> Array:
        """(a,) from the estimate to the most likely chain, of its active unknowns."""
        return self.model.solution[: int(self.scene.blocks.active.sum())]

    @property
    def full_step(self) -> Array:
        """(D,) the same of all unknowns."""
        active = self.scene.blocks.active
        full = np.zeros(len(active))
        full[active] = self.step
        return full

    def effect(self, name: str) -> EffectFound:
        """What an effect does to the sensor, as it is predicted."""
        position, rotation = self.rms(name, self.columns[name].displacement)
        return EffectFound(name, position, rotation)


def systematic(
    problem: Problem,
    torus: Torus,
    angles: Array,
    sigma: tuple[float, float],
    active: np.ndarray,
    effects: tuple[str, ...] = tuple(EFFECTS),
) -> Systematic:
    """The most likely ``effects`` in the poses of ``problem`` at the estimate ``torus``, ``angles`` (2, N), whose
    ``active`` (D,) unknowns and noise ``sigma`` (m, rad) are those of the fit."""
    blocks = Blocks.at(problem, torus, angles, sigma, active)
    if len(blocks.middle) < LEAST_BLOCKS or max(sigma) < EXACT:
        effects = ()
    best = Systematic.within(Scene(problem, torus, angles, sigma, blocks, FIELD_LENGTHS[0]), effects)
    if {*OF_PLACE} & {*best.names}:
        others = [best.of_length(length) for length in FIELD_LENGTHS[1:]]
        best = max((best, *others), key=lambda found: found.model.log_likelihood)
    return best.pruned()


def _columns(scene: Scene, effects: tuple[str, ...]) -> dict[str, Columns]:
    """Of the effects that can show in the scene, by name."""
    every = {name: EFFECTS[name](scene) for name in effects}
    return {name: found for name, found in every.items() if found is not None}


def _rows(blocks: Blocks, columns: dict[str, Columns], groups: tuple[Group, ...]) -> Rows:
    """[U Z y] of all blocks, and the model without any effect so far."""
    Z = np.zeros((6, 0, len(blocks.middle)))
    if columns:
        Z = np.concatenate([found.displacement for found in columns.values()], axis=1)
        Z = np.matmul(blocks.whiten.transpose(2, 0, 1), Z.transpose(2, 0, 1)).transpose(1, 2, 0)
    F = np.concatenate([-blocks.by_unknown[:6], Z, blocks.residual[:6, None]], axis=1)
    u, width = blocks.by_unknown.shape[1], F.shape[1]
    read = np.concatenate([-blocks.by_unknown[6:], blocks.residual[6:, None]], axis=1).swapaxes(0, 1).reshape(u + 1, -1)
    own = np.append(np.arange(u), width - 1)
    fixed = np.zeros((width, width))
    fixed[np.ix_(own, own)] = read @ read.T + blocks.fixed
    group = np.array(
        [groups.index(Group(name, kind)) for name, found in columns.items() for kind in found.kinds], dtype=int
    )
    model = Mixed(np.zeros((2, width, width)), fixed, blocks.rows, u, group, np.zeros(len(groups)), np.ones(2))
    return Rows.of(F, blocks.stretch, model)
