"""The likelihood reduced to the unknowns of the machine: what `solvers.elimination` gives."""

from dataclasses import dataclass

import numpy as np

from solvers.likelihood import LOCAL, AngleModel
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
    """(D, D) that the readings carry; the rotations carry the rest."""
    redundancy: tuple[float, float]
    """Number of position and of rotation residuals, each less the part that the angles absorb
    (without orientations the second is without meaning)."""
    exchanged: float
    """How much of one noise the angles of single poses carry into the other's residuals (docs/estimation.md, 4)."""
    squares: tuple[float, float]
    """Weighted sum of the squared position (m^2) and rotation (rad^2) residuals, not scaled by sigma."""
    reading_cost: float
    """The readings' part of the sum of squares, scaled."""
    sigma: tuple[float, ...]
    distance2: Array
    """(N,) squared Mahalanobis distance of each pose's residual once its own free angles are fitted."""
    _position: tuple[Array, float]
    """Gradient and constant that complete `position_information` to a quadratic form, and"""
    _reading: tuple[Array, float]
    """those of `reading_information`."""
    _constant: float
    """What the angles' own steps leave of `cost`."""
    _response: Array
    """(2, 16, N) what each free angle takes of every column of B."""
    _sweep_response: Array
    """(S, 16) the same of each held angle, scaled to its own column."""
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
