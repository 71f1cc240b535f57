"""Which unknowns the data determine, by rank-revealing QR of the reduced Jacobian in steps of preference."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from solvers.se3 import Array

RANK = 1e-7
"""Length of a column, relative to its length before all elimination, below which the values of joints and the
columns chosen before it explain it."""
NAMED = 0.05
"""Share of the largest coefficient below which a column has no part in a combination."""


@dataclass(frozen=True, eq=False)
class Dependence:
    """An unknown that the data do not tell from others."""

    unknown: int
    others: np.ndarray
    """(M,) unknowns that move the sensor in the same way at all poses."""
    coefficients: Array
    """(M,) a unit of the unknown does what so much of the others does."""


@dataclass(frozen=True, eq=False)
class Identifiable:
    """A choice of unknowns that the data determine."""

    active: np.ndarray
    """(D,) mask."""
    dependent: tuple[Dependence, ...]
    """What was left out, each with what it cannot be told from."""


def identifiable(rows: Array, length: Array, stages: Sequence[np.ndarray]) -> Identifiable:
    """Choose from the ``stages`` of unknowns, earlier ones first, as many as the data determine.

    ``rows`` (M, D) and ``length`` (D,) are those of `solvers.chain.equations.factors`. Within a stage the pivot is the
    column that the chosen ones explain least.
    """
    J = np.asarray(np.linalg.qr(rows / np.where(length > 0, length, 1.0), mode="r"), dtype=float)
    chosen = np.zeros(0, dtype=int)
    left = J
    for stage in stages:
        _, R, order = scipy.linalg.qr(left[:, stage], mode="economic", pivoting=True)  # pyright: ignore
        chosen = np.concatenate([chosen, stage[order[: np.count_nonzero(np.abs(np.diagonal(R)) > RANK)]]])
        Q = np.linalg.qr(J[:, chosen])[0]
        left = J - Q @ (Q.T @ J)
    active = np.zeros(len(length), dtype=bool)
    active[chosen] = True
    rest = np.array([i for stage in stages for i in stage if not active[i]], dtype=int)
    found = np.linalg.lstsq(J[:, chosen], J[:, rest], rcond=None)[0].T if rest.size else np.zeros((0, len(chosen)))
    return Identifiable(active, tuple(_dependence(i, chosen, c, length) for i, c in zip(rest, found, strict=True)))


def _dependence(unknown: int, others: np.ndarray, scaled: Array, length: Array) -> Dependence:
    part = np.abs(scaled) > NAMED * max(np.abs(scaled).max(initial=0.0), NAMED)
    part &= length[unknown] > 0
    return Dependence(unknown, others[part], scaled[part] * length[unknown] / length[others[part]])
