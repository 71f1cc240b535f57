"""Whether unknowns that were not estimated would explain what the residuals still show: docs/estimation.md, section 16.

A score test at the estimate. With the estimated unknowns eliminated like the values, the others would lower the
weighted sum of squares Q by T = gT inv(S) g, S = H_oo - H_oe C H_eo. Without anything to explain T is chi-square.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from solvers.chain.chain import ChainEstimate
from solvers.chain.equations import normal_equations
from solvers.chain.noise import redundancy
from solvers.chain.problem import ChainProblem
from solvers.se3 import Array

EXACT = 1e-6
"""Noise of the poses below which residuals are rounding, m and rad."""
NOTHING_LEFT = 1e-6
"""Share of a direction's information up to which the estimated unknowns explain it."""


@dataclass(frozen=True)
class LeftOut:
    """What the unknowns that were not estimated would change."""

    share: float
    """Part that they would take away of the squares of one kind of data, the greatest of all kinds."""
    kind: int
    """Which kind, as in `solvers.chain.problem`."""
    probability: float
    """That noise alone takes away as much of all squares."""
    most: str
    """The group of unknowns that takes away most by itself."""


def left_out(
    problem: ChainProblem, estimate: ChainEstimate, groups: Mapping[str, np.ndarray], correlation: float = 0.0
) -> LeftOut | None:
    """The test of all unknowns in the ``groups`` (name -> positions among D) that were not estimated; None where there
    are none, or no noise to compare with.

    Residuals of neighbouring poses with a ``correlation`` r tell as much as (1 - r) / (1 + r) times as many poses.
    """
    groups = {name: own[~estimate.active[own]] for name, own in groups.items()}
    others = np.concatenate([np.zeros(0, dtype=int), *groups.values()])
    if not others.size or max(estimate.sigma[:2]) < EXACT:
        return None
    wanted, C = estimate.active.copy(), estimate.white
    wanted[others] = True
    at = normal_equations(
        estimate.machine, estimate.values, problem, estimate.layout, estimate.sigma, estimate.used, wanted
    )
    across = C @ at.H[:, others]
    scale = np.sqrt(np.maximum(np.diagonal(at.H)[others], 1e-150))
    S = (at.H[np.ix_(others, others)] - at.H[others] @ across) / np.outer(scale, scale)
    g = at.g[others] / scale
    found, rank = _solved(S, g)
    drop, dof = float(g @ found), float(redundancy(at, C).sum())
    if rank == 0 or dof <= rank or at.cost <= drop:
        return None
    F = drop / rank / ((at.cost - drop) / (dof - rank))
    step = np.zeros(len(C))
    step[others] = -found / scale
    step += across @ (found / scale)
    shares = np.where(at.squares > 0, 1 - at.squares_after(step) / np.maximum(at.squares, 1e-300), 0.0)
    names = np.repeat([*groups], [len(own) for own in groups.values()])
    alone = {
        name: float(g[names == name] @ _solved(S[np.ix_(*[names == name] * 2)], g[names == name])[0]) for name in groups
    }
    return LeftOut(
        share=float(shares.max()),
        kind=int(shares.argmax()),
        probability=float(fdtrc(rank, dof - rank, F * (1 - correlation) / (1 + correlation))),
        most=max(alone, key=lambda name: alone[name]),
    )


def _solved(S: Array, g: Array) -> tuple[Array, int]:
    """inv(S) g over the directions that are left, and their number."""
    values, vectors = np.linalg.eigh(S)
    kept = values > NOTHING_LEFT
    return vectors[:, kept] @ ((g @ vectors[:, kept]) / values[kept]), int(kept.sum())
