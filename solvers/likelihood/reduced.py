"""The likelihood reduced to the unknowns of the machine, and the blocks of the angles that are eliminated.

Arrays run over poses in their last axis.
"""

from dataclasses import dataclass

import numpy as np

from solvers.likelihood.linearise import LOCAL, AngleModel, Linearisation
from solvers.se3 import Array

HELD, RESIDUAL, WIDTH = LOCAL, LOCAL + 1, LOCAL + 2
"""Columns of a pose's weighted matrix B beyond the local Jacobian, and their number."""


@dataclass(frozen=True, eq=False)
class Reduced:
    """Normal equations ``H x = -g`` of the machine's D = 6 P + 8 unknowns, every angle eliminated."""

    H: Array
    """(D, D) marginal information."""
    g: Array
    """(D,) gradient of half the weighted sum of squares."""
    position_information: Array
    """(D, D) share of H that the position residuals carry, and"""
    reading_information: Array
    """(D, D) that readings and labels carry; the rotations carry the rest."""
    redundancy: tuple[float, float]
    """Number of position and of rotation residuals, each less the part that the angles absorb
    (without orientations the second is without meaning)."""
    exchanged: float
    """How much of one noise the angles of single poses carry into the other's residuals (docs/estimation.md, 4)."""
    squares: tuple[float, float]
    """Weighted sum of the squared position (m^2) and rotation (rad^2) residuals, not scaled by sigma."""
    reading_cost: float
    """The part of readings and labels in the sum of squares, scaled."""
    sigma: tuple[float, ...]
    distance2: Array
    """(N,) squared Mahalanobis distance of each pose's residual once its own free angles are fitted."""
    left: Array
    """(rows, N) weighted residuals of each pose once its own free angles are fitted."""
    _position: tuple[Array, float]
    """Gradient and constant that complete `position_information` to a quadratic form, and"""
    _reading: tuple[Array, float]
    """those of `reading_information`."""
    _constant: float
    """What the angles' own steps leave of `cost`."""
    _response: Array
    """(2, 16, N) what each free angle takes of every column of B."""
    _sweep_response: Array
    """(S, 16) the same of each held angle, scaled to its own column, and"""
    _sweep_information: Array
    """(S,) its own information; 0 where no pose of the sweep is used."""
    _columns: np.ndarray
    _placement: np.ndarray
    _model: AngleModel

    @property
    def cost(self) -> float:
        """Weighted sum of squares at the point of linearisation."""
        return self.cost_at(self.sigma)

    def cost_at(self, sigma: tuple[float, ...]) -> float:
        """The same if the noise were ``sigma``."""
        return float(sum(s / n**2 for s, n in zip(self.squares, sigma, strict=False))) + self.reading_cost

    def squares_after(self, x: Array) -> tuple[float, float]:
        """`squares` as they will be, to first order, after the step ``x`` (D,) and its `angle_step`."""
        position, reading = (
            max(float(constant + 2 * g @ x + x @ M @ x), 0.0)
            for M, (g, constant) in (
                (self.position_information, self._position),
                (self.reading_information, self._reading),
            )
        )
        if len(self.sigma) == 1:
            return position * self.sigma[0] ** 2, 0.0
        total = float(self._constant + 2 * self.g @ x + x @ self.H @ x)
        return position * self.sigma[0] ** 2, max(total - reading - position, 0.0) * self.sigma[1] ** 2

    @property
    def measured(self) -> np.ndarray:
        """(S,) mask of the held angles that used poses measure."""
        return self._sweep_information > 0

    def held_covariance(self, C: Array) -> Array:
        """(S, S), rad^2, of the held angles, given that of the machine's unknowns (D, D)."""
        response = np.zeros((len(self._sweep_information), len(C)))
        columns = self._columns[self._model.sweep_placement]
        np.put_along_axis(response, columns, self._sweep_response[:, :LOCAL], axis=1)
        own = np.divide(1.0, self._sweep_information, where=self.measured, out=np.full(len(response), np.inf))
        return np.diag(own) + response @ C @ response.T

    def angle_step(self, x: Array) -> Array:
        """The step of every angle (2, N) that goes with the step ``x`` (D,) of the machine."""
        local = x[self._columns]
        step = -self._response[:, RESIDUAL]
        if len(local) == 1:
            step -= np.einsum("jkn,k->jn", self._response[:, :LOCAL], local[0])
        else:
            step -= np.einsum("jkn,nk->jn", self._response[:, :LOCAL], local[self._placement])
        member = np.flatnonzero(self._model.sweep >= 0)
        if member.size:
            k = self._sweep_response
            held = -(k[:, RESIDUAL] + (k[:, :LOCAL] * local[self._model.sweep_placement]).sum(axis=1))
            held = held[self._model.sweep[member]]
            step[:, member] -= self._response[:, HELD, member] * held
            step[self._model.sweep_joint[member], member] = held
        return step


def weighted(line: Linearisation, model: AngleModel, sigma: tuple[float, ...]) -> tuple[Array, Array]:
    """B (rows, 16, n) and A (rows, 2, n), scaled by the noise; A is zero where an angle is not free."""
    scale = row_scale(model, sigma)
    n = line.residual.shape[1]
    B = np.empty((3 * len(sigma), WIDTH, n))
    np.multiply(line.by_local, scale[:, None], out=B[:, :LOCAL])
    A = line.by_angle * scale[:, None]
    B[:, RESIDUAL] = line.residual * scale
    if model.shape is not None and line.R_world_carm is not None:
        roots = shape_roots(model, line.R_world_carm)
        B[:, :LOCAL], B[:, RESIDUAL], A = (shaped(x, roots) for x in (B[:, :LOCAL], B[:, RESIDUAL], A))
    held = model.sweep >= 0
    B[:, HELD] = np.where(held, A[:, model.sweep_joint, np.arange(n)], 0.0) if held.any() else 0.0
    return B, A * model.free


def row_scale(model: AngleModel, sigma: tuple[float, ...]) -> Array:
    """(rows, 1) or (rows, n), 1 over the noise of each row, root mean square over its axes."""
    scale = np.repeat(1 / np.asarray(sigma), 3)[:, None]
    return scale if model.scale is None else scale / np.repeat(model.scale[: len(sigma)], 3, axis=0)


def shape_roots(model: AngleModel, R_world_carm: Array) -> tuple[Array, Array]:
    """(3, 3, n) each: takes a position, or a turn, from the carm frame to axes of the tracker in which the noise is
    isotropic, its root mean square the same. The model has a `NoiseShape`."""
    assert model.shape is not None
    roots = (inverse_root(S) for S in (model.shape.position, model.shape.rotation))
    first, second = (np.einsum("ij,jkn->ikn", root, R_world_carm) for root in roots)
    return first, second


def inverse_root(S: Array) -> Array:
    """The symmetric root of inv(S), S positive definite (3, 3)."""
    values, vectors = np.linalg.eigh(S)
    return (vectors / np.sqrt(values)) @ vectors.T


def shaped(rows: Array, roots: tuple[Array, Array]) -> Array:
    """Rows (6, ..., n), or the three of positions, in the axes of `shape_roots`."""
    parts = [np.einsum("ijn,j...n->i...n", M, rows[3 * k : 3 * k + 3]) for k, M in enumerate(roots[: len(rows) // 3])]
    return np.concatenate(parts)


def blocks_of(A: Array) -> Array:
    """ATA of every pose from its rows A (rows, 2, N), as its entries 00, 01 and 11 (3, N)."""
    return np.stack([(A[:, 0] ** 2).sum(axis=0), (A[:, 0] * A[:, 1]).sum(axis=0), (A[:, 1] ** 2).sum(axis=0)])


def inverse_blocks(G: Array, model: AngleModel) -> Array:
    """inv(G + readings), entries 00, 01 and 11 (3, N) as those of G; the rows of angles that are not free are those
    of the identity. A ridge of 1e-12 keeps rounding small where both angles of a pose move the sensor alike."""
    a, d = G[[0, 2]] + model.precision + ~model.free
    b = G[1]
    ridge = 1e-12 * (a + d) + np.finfo(float).tiny
    a, d = a + ridge, d + ridge
    return np.stack([d, -b, a]) / (a * d - b * b)


@dataclass(frozen=True, eq=False)
class OwnAngles:
    """The free angles of n poses at their best, from weighted columns B (rows, w, n) and A (rows, 2, n)."""

    gradient: Array
    """(2, w, n) AᵀB, the readings' part in the last column, that of the residual."""
    position: Array
    """(3, n) `blocks_of` the position rows, and"""
    rotation: Array
    """(3, n) of the rotation rows."""
    inverse: Array
    """(3, n) `inverse_blocks` of both and the readings."""
    response: Array
    """(2, w, n) what each angle takes of every column of B."""

    @staticmethod
    def of(B: Array, A: Array, model: AngleModel, error: Array) -> "OwnAngles":
        """With readings of the angles that are off by ``error`` (2, n)."""
        C = np.stack([np.einsum("rn,rkn->kn", A[:, j], B) for j in (0, 1)])
        C[:, -1] += model.precision * error
        position, rotation = blocks_of(A[:3]), blocks_of(A[3:])
        g, h, k = inverse = inverse_blocks(position + rotation, model)
        return OwnAngles(C, position, rotation, inverse, np.stack([g * C[0] + h * C[1], h * C[0] + k * C[1]]))

    def left_of(self, B: Array, A: Array) -> Array:
        """Some of the rows (r, w, n) less what the angles take of them."""
        return B - A[:, 0, None] * self.response[0] - A[:, 1, None] * self.response[1]

    def readings(self, precision: Array, error: Array) -> Array:
        """(2, w, n) the rows of the readings, of ``precision`` (2, n), with the angles at their best."""
        read = np.sqrt(precision)
        V = -read[:, None] * self.response
        V[:, -1] += read * error
        return V


def traces(G_inverse: Array, position: Array, rotation: Array) -> tuple[float, float]:
    """Sums over the poses of tr inv(G) P and tr inv(G) P inv(G) R, with P and R the blocks (3, N) of both kinds."""

    def product(block: Array) -> tuple[Array, ...]:
        (g, h, k), (a, b, d) = G_inverse, block
        return g * a + h * b, g * b + h * d, h * a + k * b, h * b + k * d

    p, r = product(position), product(rotation)
    exchanged = p[0] * r[0] + p[1] * r[2] + p[2] * r[1] + p[3] * r[3]
    return float((p[0] + p[3]).sum()), float(exchanged.sum())
