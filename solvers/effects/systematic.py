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
from solvers.effects.rows import Rows
from solvers.effects.variance import Mixed, most_likely
from solvers.estimate import Correlation, Note
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus

FIELD_LENGTHS = (0.5, 0.3, 0.8)
"""Of functions of the place, m; the most likely is taken, the others only where the first finds any."""
OF_PLACE = ("field", "marker")
ASKED = 1.0
"""Standard deviations by which an effect must show in the residuals to be estimated."""
LEAST_BLOCKS = 20
"""Fewer poses tell nothing of effects."""
DISAGREE = 4.75
"""Gain in log-likelihood of a variance between placements that chance makes once in a thousand."""
EXACT = 1e-6
"""Noise below this, m and rad, is rounding, and so are its effects."""
WORTH = 1.35
"""Gain in log-likelihood of an effect that is kept: chance makes it for one variance in twenty."""
SAME_RHO = 0.03
"""Change of a correlation that calls for no other round."""
ROUNDS = 3
"""In which noise that lasts is told from effects."""


@dataclass(frozen=True)
class Group:
    """One variance of one effect."""

    effect: str
    kind: str
    """``position`` (m), ``rotation`` (rad), ``angle`` (rad) or ``time`` (s²)."""


@dataclass(frozen=True, eq=False)
class _Setting:
    """What does not depend on the variances."""

    scene: Scene
    columns: tuple[tuple[str, Columns], ...]
    groups: tuple[Group, ...]
    rows: Rows

    @staticmethod
    def of(scene: Scene, effects: tuple[str, ...]) -> "_Setting":
        columns = tuple(_columns(scene, effects).items())
        groups = tuple(dict.fromkeys(Group(name, kind) for name, found in columns for kind in found.kinds))
        return _Setting(scene, columns, groups, _rows(scene.blocks, columns, groups))

    def of_length(self, length: float) -> "_Setting":
        """The same with another length (m) of the functions of the place, which alone depend on it."""
        scene, known = replace(self.scene, field_length=length), dict(self.columns)
        columns = tuple((known | _columns(scene, tuple(name for name in OF_PLACE if name in known))).items())
        return _Setting(scene, columns, self.groups, _rows(scene.blocks, columns, self.groups))


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
class Systematic:
    """The effects at their most likely variances."""

    setting: _Setting
    model: Mixed
    rho: Array
    """(2,) correlation of the noise of neighbouring blocks, by kind."""

    @property
    def gain(self) -> float:
        """In log-likelihood, over no effect at the same noise."""
        return self.model.log_likelihood - self.model.at(0 * self.model.variance, self.model.noise).log_likelihood

    def gain_of(self, name: str) -> float:
        """In log-likelihood, over all effects but this one."""
        return self.model.log_likelihood - self._without(name).log_likelihood

    def _without(self, name: str) -> Mixed:
        groups = np.array([group.effect != name for group in self.setting.groups], dtype=bool)
        return self.model.at(self.model.variance * groups, self.model.noise)

    def pruned(self) -> "Systematic":
        """Only the effects that gain what chance seldom makes, the one that gains least left out first."""
        found = self
        while found.names:
            least = min(found.names, key=found.gain_of)
            if found.gain_of(least) >= WORTH:
                break
            found = replace(found, model=most_likely(found._without(least)))
        return found

    @property
    def note(self) -> Note | None:
        """Whether the placements disagree about where the sensor sits on the C."""
        if "remounting" not in self.names or self.gain_of("remounting") < DISAGREE:
            return None
        variances = dict(zip(self.setting.groups, self.model.variance, strict=True))
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
        F = self.setting.rows.independent(self.rho) / np.sqrt(np.repeat(model.noise, 3))[:, None]
        left = np.einsum("wrb,w->rb", F, model.residual)
        F = np.concatenate([F[model.index] * model.scale[:, None, None], left[None]])
        some = (F[..., part].reshape(len(F), -1) for part in parts)
        sums = [here @ here.T for here in some]
        return Parted(model.equations, [M[:-1, :-1] for M in sums], [M[:-1, -1] for M in sums], model.scale)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects that there are."""
        found = zip(self.setting.groups, self.model.variance, strict=True)
        return tuple(dict.fromkeys(group.effect for group, variance in found if variance > 0))

    @property
    def correlation(self) -> Correlation:
        """For how many poses the noise lasts, beside the effects."""
        return Correlation(*np.maximum(self.model.noise * (1 + self.rho) / (1 - self.rho), 1.0).tolist())

    @property
    def step(self) -> Array:
        """(a,) from the estimate to the most likely chain, of its active unknowns."""
        return self.model.solution[: int(self.setting.scene.blocks.active.sum())]

    @property
    def full_step(self) -> Array:
        """(D,) the same of all unknowns."""
        active = self.setting.scene.blocks.active
        full = np.zeros(len(active))
        full[active] = self.step
        return full

    def shares(self, gain: Array) -> dict[str, Array]:
        """G Z_g λ_g Z_gᵀ Gᵀ (K, K) of every effect, from ``gain`` = G Z (K, m)."""
        return {
            name: (gain[:, own] * self.model.variance[self.model.group[own]]) @ gain[:, own].T
            for name in self.names
            for own in [self.columns_of(name)]
        }

    def amplitude(self, name: str) -> tuple[float, float]:
        """Root mean square displacement of the sensor by an effect, m and rad, as it is predicted."""
        columns = dict(self.setting.columns)[name]
        moved = np.einsum("imb,m->ib", columns.displacement, self.model.coefficients[self.columns_of(name)])
        position, rotation = ((part**2).sum(axis=0).mean() ** 0.5 for part in (moved[:3], moved[3:]))
        return float(position), float(rotation)

    def columns_of(self, name: str) -> np.ndarray:
        """(m,) mask of the columns of an effect."""
        return np.array([group.effect == name for group in self.setting.groups])[self.model.group]

    def refined(self, setting: _Setting) -> "Systematic":
        """The most likely variances in another setting, from these."""
        return _climbed(setting, setting.rows.whitened(self.rho, self.model), self.rho)


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
    blocks = Blocks.of(problem, torus, angles, sigma, active)
    if len(blocks.middle) < LEAST_BLOCKS or max(sigma) < EXACT:
        effects = ()
    best = _from_nothing(_Setting.of(Scene(problem, torus, angles, sigma, blocks, FIELD_LENGTHS[0]), effects))
    if {*OF_PLACE} & {*best.names}:
        others = [best.refined(best.setting.of_length(length)) for length in FIELD_LENGTHS[1:]]
        best = max((best, *others), key=lambda found: found.model.log_likelihood)
    return best.pruned()


def _from_nothing(setting: _Setting) -> Systematic:
    """The most likely variances, from no effect and noise that lasts as long as it seems to, or not at all."""
    rows = setting.rows
    nothing = most_likely(rows.model)
    lasting = rows.correlation(nothing)
    found = []
    for rho in [np.zeros(2), lasting] if lasting.any() else [lasting]:
        start = rows.whitened(rho, nothing)
        score, information = start.from_nothing()
        asked = score > ASKED * np.sqrt(information)
        start = start.at(np.where(asked, score / information, 0.0), start.noise)
        found.append(_climbed(setting, start, rho))
    return max(found, key=lambda one: one.model.log_likelihood)


def _climbed(setting: _Setting, start: Mixed, rho: Array) -> Systematic:
    """The most likely variances and correlation of the noise, from given ones."""
    fit = most_likely(start)
    for _ in range(ROUNDS):
        left = setting.rows.correlation(fit)
        if np.abs(left - rho).max() < SAME_RHO:
            break
        fit, rho = most_likely(setting.rows.whitened(left, fit)), left
    return Systematic(setting, fit, rho)


def _columns(scene: Scene, effects: tuple[str, ...]) -> dict[str, Columns]:
    """Of the effects that can show in the scene, by name."""
    every = {name: EFFECTS[name](scene) for name in effects}
    return {name: found for name, found in every.items() if found is not None}


def _rows(blocks: Blocks, columns: tuple[tuple[str, Columns], ...], groups: tuple[Group, ...]) -> Rows:
    """[U Z y] of all blocks, and the model without any effect so far."""
    Z = np.zeros((6, 0, len(blocks.middle)))
    if columns:
        Z = np.concatenate([found.displacement for _, found in columns], axis=1)
        Z = np.matmul(blocks.whiten.transpose(2, 0, 1), Z.transpose(2, 0, 1)).transpose(1, 2, 0)
    F = np.concatenate([-blocks.by_unknown[:6], Z, blocks.residual[:6, None]], axis=1)
    u, width = blocks.by_unknown.shape[1], F.shape[1]
    read = np.concatenate([-blocks.by_unknown[6:], blocks.residual[6:, None]], axis=1).swapaxes(0, 1).reshape(u + 1, -1)
    own = np.append(np.arange(u), width - 1)
    fixed = np.zeros((width, width))
    fixed[np.ix_(own, own)] = read @ read.T + blocks.fixed
    group = np.array([groups.index(Group(name, kind)) for name, found in columns for kind in found.kinds], dtype=int)
    model = Mixed(np.zeros((2, width, width)), fixed, blocks.rows, u, group, np.zeros(len(groups)), np.ones(2))
    return Rows.of(F, blocks.stretch, model)
