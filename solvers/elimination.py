"""Schur complements: the linearised likelihood reduced to the unknowns of the machine.

With B = [J | h | r] the weighted local Jacobian of a pose, the column of its sweep's unknown held
angle and the residual, A the columns of its own free angles and G = ATA plus the readings'
precision, the pose contributes ``BTB - (ATB)T inv(G) (ATB)``. The held angles are scalars, each of
which is eliminated in the same way once its poses are summed.
"""

from dataclasses import dataclass

import numpy as np

from solvers.likelihood import LOCAL, AngleModel, Linearisation
from solvers.problem import Problem
from solvers.se3 import Array

HELD, RESIDUAL = LOCAL, LOCAL + 1


@dataclass(frozen=True, eq=False)
class Reduced:
    """Normal equations ``H x = -g`` of the machine's D = 6 P + 8 unknowns, every angle eliminated."""

    H: Array
    """(D, D) marginal information."""
    g: Array
    """(D,) gradient of half the weighted sum of squares."""
    position_information: Array
    """(D, D) share of H that the position residuals carry; the rotations carry the rest."""
    redundancy: tuple[float, float]
    """Number of position and of rotation residuals, each less the part that the angles absorb
    (without orientations the second is without meaning)."""
    angle_gain: Array
    """(2, 14, N) and"""
    angle_start: Array
    """(2, N): the angles move by ``-(start + gain @ x)``, x the local unknowns of the pose."""
    columns: np.ndarray
    """(P, 14) where the local unknowns of each placement stand among the D."""
    placement: np.ndarray

    def angle_step(self, x: Array) -> Array:
        """The step of every angle (2, N) that goes with the step ``x`` (D,) of the machine."""
        local = x[self.columns]
        if len(local) == 1:
            return -(self.angle_start + np.einsum("jkn,k->jn", self.angle_gain, local[0]))
        return -(self.angle_start + np.einsum("jkn,nk->jn", self.angle_gain, local[self.placement]))


def columns_of(placements: int) -> np.ndarray:
    """(P, 14) global positions of the local unknowns."""
    shared = 6 * placements + np.arange(LOCAL - 6)
    return np.stack([np.concatenate([6 * p + np.arange(6), shared]) for p in range(placements)])


def reduce(
    line: Linearisation,
    model: AngleModel,
    problem: Problem,
    angles: Array,
    sigma: tuple[float, ...],
    weights: Array | None = None,
) -> Reduced:
    """Eliminate the angles. ``sigma`` is the noise of position (m) and, where there are orientations,
    of rotation (rad); ``weights`` (N,) scales the information of each pose."""
    row = np.repeat(1 / np.asarray(sigma), 3)[:, None]
    scale = row if weights is None else row * np.sqrt(weights)
    n = line.residual.shape[1]
    B = np.empty((len(row), LOCAL + 2, n))
    np.multiply(line.by_local, scale[:, None], out=B[:, :LOCAL])
    full = line.by_angle * scale[:, None]
    B[:, HELD] = np.where(model.sweep >= 0, full[:, model.sweep_joint, np.arange(n)], 0.0)
    B[:, RESIDUAL] = line.residual * scale
    A = full * model.free
    C = np.einsum("rjn,rkn->jkn", A, B)
    C[:, RESIDUAL] += model.precision * model.reading_error(angles)
    G_inverse = _inverse_blocks(A, model)
    X = np.einsum("ijn,jkn->ikn", G_inverse, C)

    columns = columns_of(problem.placements)
    size = 6 * problem.placements + LOCAL - 6
    H, g = np.zeros((size, size)), np.zeros(size)
    for p, here in enumerate(_members(problem)):
        S = _moment(B[..., here], B[..., here]) - _moment(C[..., here], X[..., here])
        H[np.ix_(columns[p], columns[p])] += S[:LOCAL, :LOCAL]
        g[columns[p]] += S[:LOCAL, RESIDUAL]
    k = _sweep_sums(B, C, X, model)
    _eliminate_sweeps(H, g, k, columns[model.sweep_placement])
    gain, start = _angle_response(X, k, model)

    M = np.zeros_like(H)
    for p, here in enumerate(_members(problem)):
        left = B[:3, :LOCAL, here] - np.einsum("rjn,jkn->rkn", full[:3, :, here], gain[..., here])
        M[np.ix_(columns[p], columns[p])] += _moment(left, left)
    return Reduced(
        H=0.5 * (H + H.T),
        g=g,
        position_information=M,
        redundancy=_redundancy(A, B, X, G_inverse, k, model),
        angle_gain=gain,
        angle_start=start,
        columns=columns,
        placement=problem.placement,
    )


def _members(problem: Problem) -> list:
    if problem.placements == 1:
        return [slice(None)]
    return [np.flatnonzero(problem.placement == p) for p in range(problem.placements)]


def _moment(left: Array, right: Array) -> Array:
    """Sum over rows and poses of the outer products of the columns."""
    return np.matmul(left, right.swapaxes(1, 2)).sum(axis=0)


def _inverse_blocks(A: Array, model: AngleModel) -> Array:
    """inv(G) (2, 2, N); the rows of angles that are not free are those of the identity. A ridge of 1e-12
    keeps poses in which both angles move the sensor alike from amplifying rounding."""
    a = (A[:, 0] ** 2).sum(axis=0) + model.precision[0] + ~model.free[0]
    d = (A[:, 1] ** 2).sum(axis=0) + model.precision[1] + ~model.free[1]
    b = (A[:, 0] * A[:, 1]).sum(axis=0)
    ridge = 1e-12 * (a + d) + np.finfo(float).tiny
    a, d = a + ridge, d + ridge
    return np.array([[d, -b], [-b, a]]) / (a * d - b * b)


def _sweep_sums(B: Array, C: Array, X: Array, model: AngleModel) -> Array:
    """(S, 16) the row of each held angle in the summed normal equations."""
    member = np.flatnonzero(model.sweep >= 0)
    k = np.zeros((len(model.sweep_placement), LOCAL + 2))
    if member.size:
        rows = np.einsum("rn,rkn->nk", B[:, HELD, member], B[..., member])
        rows -= np.einsum("jn,jkn->nk", C[:, HELD, member], X[..., member])
        np.add.at(k, model.sweep[member], rows)
    return k


def _eliminate_sweeps(H: Array, g: Array, k: Array, columns: np.ndarray) -> None:
    """Schur complement of the held angles, in place."""
    full = np.zeros((len(k), len(g)))
    np.put_along_axis(full, columns, k[:, :LOCAL], axis=1)
    weighted = full / k[:, HELD, None]
    H -= weighted.T @ full
    g -= weighted.T @ k[:, RESIDUAL]


def _redundancy(A: Array, B: Array, X: Array, G_inverse: Array, k: Array, model: AngleModel) -> tuple[float, float]:
    """The traces of the hat matrix of all angles, split over position, rotation and readings."""
    position = np.einsum("rin,ijn,rjn->", A[:3], G_inverse, A[:3])
    if len(k):
        held = B[:3, HELD] - np.einsum("rjn,jn->rn", A[:3], X[:, HELD])
        position += (held**2 / np.where(model.sweep >= 0, k[model.sweep, HELD], 1.0)).sum()
    readings = np.einsum("in,iin->", model.precision, G_inverse)
    rotation = model.free.sum() + len(k) - position - readings
    n = B.shape[2]
    return float(3 * n - position), float(3 * n - rotation)


def _angle_response(X: Array, k: Array, model: AngleModel) -> tuple[Array, Array]:
    """Gain (2, 14, N) and start (2, N) of every angle, held ones included."""
    if not len(k):
        return X[:, :LOCAL], X[:, RESIDUAL]
    member = np.flatnonzero(model.sweep >= 0)
    ratio = (k / k[:, HELD, None])[model.sweep[member]].T
    Y = X.copy()
    Y[..., member] -= X[:, None, HELD, member] * ratio
    Y[model.sweep_joint[member], :, member] = ratio.T
    return Y[:, :LOCAL], Y[:, RESIDUAL]
