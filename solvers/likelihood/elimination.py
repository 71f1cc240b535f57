"""Schur complements: the linearised likelihood reduced to the unknowns of the machine.

With B = [J | h | r] the weighted local Jacobian of a pose, the column of its sweep's unknown held
angle and the residual, A the columns of its own free angles and G = ATA plus the readings'
precision, the pose contributes ``BTB - (ATB)T inv(G) (ATB)``. The held angles are scalars, each of
which is eliminated in the same way once its poses and its label, if it has one, are summed.
Everything is a sum over poses, taken in blocks that stay in the processor's cache, so memory and time grow linearly.
"""

from collections.abc import Iterator

import numpy as np

from solvers.likelihood.linearise import LOCAL, AngleModel, Linearisation, linearise
from solvers.likelihood.reduced import HELD, RESIDUAL, WIDTH, OwnAngles, Reduced, traces, weighted
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus

BLOCK = 1024
"""Poses that are reduced at a time."""


def normal_equations(
    torus: Torus,
    angles: Array,
    problem: Problem,
    model: AngleModel,
    sigma: tuple[float, ...],
    used: np.ndarray | None = None,
) -> Reduced:
    """Linearise at ``angles`` (2, N) and eliminate them. ``sigma`` is the noise of position (m) and, where
    there are orientations, of rotation (rad). Poses that are not ``used`` (N,) have their angles fitted,
    but no say in anything else."""
    total = _Sums(problem.placements, len(model.sweep_placement), len(problem), 3 * len(sigma))
    for here in _blocks(len(problem)):
        part = problem.select(here)
        line = linearise(torus, angles[:, here], part)
        total.add(
            line,
            part,
            model.select(here),
            angles[:, here],
            sigma,
            None if used is None or used[here].all() else used[here],
            here,
        )
    return total.reduced(model, problem, sigma, model.label_error(angles))


def _blocks(n: int) -> Iterator[slice]:
    return (slice(start, min(start + BLOCK, n)) for start in range(0, n, BLOCK))


class _Sums:
    """Running sums over blocks of poses."""

    def __init__(self, placements: int, sweeps: int, n: int, rows: int):
        self.moment = np.zeros((placements, WIDTH, WIDTH))
        self.position_moment, self.reading_moment = np.zeros((2, placements, WIDTH, WIDTH))
        self.sweep, self.sweep_position, self.sweep_reading = np.zeros((3, sweeps, WIDTH))
        self.response = np.empty((2, WIDTH, n))
        self.left = np.empty((rows, n))
        self.distance2 = np.empty(n)
        self.squares = np.zeros(2)
        self.poses = self.free = 0
        self.reading_cost = self.absorbed_position = self.absorbed_readings = self.exchanged = 0.0

    def add(
        self,
        line: Linearisation,
        part: Problem,
        model: AngleModel,
        angles: Array,
        sigma: tuple[float, ...],
        used: np.ndarray | None,
        here: slice,
    ) -> None:
        """Add a block of poses."""
        B, A = weighted(line, model, sigma)
        error = model.reading_error(angles)
        angle = OwnAngles.of(B, A, model, error)
        C, X, own = angle.gradient, angle.response, (angle.position, angle.rotation)
        self.response[..., here] = X
        self.left[:, here] = left = B[:, RESIDUAL] - A[:, 0] * X[0, RESIDUAL] - A[:, 1] * X[1, RESIDUAL]
        self.distance2[here] = (left**2).sum(axis=0)
        if used is not None:
            B, C, A, error = (x * used for x in (B, C, A, error))
            own = own[0] * used, own[1] * used
        U = angle.left_of(B[:3], A[:3])
        self.poses += len(part) if used is None else int(used.sum())
        self.free += int((model.free if used is None else model.free * used).sum())

        V = self._readings(angle, error, model, used)
        for p, members in _members(part):
            self.moment[p] += _moment(B[..., members], B[..., members]) - _moment(C[..., members], X[..., members])
            self.position_moment[p] += _moment(U[..., members], U[..., members])
            if V is not None:
                self.reading_moment[p] += _moment(V[..., members], V[..., members])
        member = np.flatnonzero(model.sweep >= 0)
        if member.size:
            rows = np.einsum("rn,rkn->nk", B[:, HELD, member], B[..., member])
            rows -= np.einsum("jn,jkn->nk", C[:, HELD, member], X[..., member])
            np.add.at(self.sweep, model.sweep[member], rows)
            for sums, rows in ((self.sweep_position, U), (self.sweep_reading, V)):
                if rows is not None:
                    products = np.einsum("rn,rkn->nk", rows[:, HELD, member], rows[..., member])
                    np.add.at(sums, model.sweep[member], products)

        square = (B[:, RESIDUAL].reshape(len(sigma), -1) ** 2).sum(axis=1) * np.square(sigma)
        self.squares[: len(sigma)] += square
        absorbed, exchanged = traces(angle.inverse, *own)
        self.absorbed_position += absorbed
        self.exchanged += exchanged

    def _readings(self, angle: OwnAngles, error: Array, model: AngleModel, used: np.ndarray | None) -> Array | None:
        """The readings' rows after their poses' own angles are fitted (2, 16, n); None where there are none."""
        if not model.precision.any():
            return None
        known = model.precision if used is None else model.precision * used
        self.reading_cost += float((known * error**2).sum())
        self.absorbed_readings += float((known * angle.inverse[[0, 2]]).sum())
        return angle.readings(known, error)

    def reduced(self, model: AngleModel, problem: Problem, sigma: tuple[float, ...], label_error: Array) -> Reduced:
        """Eliminate the held angles, which are off their labels by ``label_error`` (S,), and put the placements
        together."""
        columns = columns_of(problem.placements)
        size = 6 * problem.placements + LOCAL - 6
        known = np.where(self.sweep[:, HELD] > 0, model.sweep_precision, 0.0)
        self.sweep[:, HELD] += known
        self.sweep[:, RESIDUAL] += known * label_error
        self.reading_cost += float((known * label_error**2).sum())
        own = self.sweep[:, HELD]
        ratio = self.sweep / np.where(own > 0, own, 1.0)[:, None]
        index = np.concatenate([columns[model.sweep_placement], np.full((len(own), 1), size)], axis=1)
        rho = _spread(ratio, index, size + 1)
        H = _assembled(self.moment, columns, size) - rho.T @ _spread(self.sweep, index, size + 1)
        M, L = (
            _without_sweeps(_assembled(moment, columns, size), _spread(sums, index, size + 1), rho, sums[:, HELD])
            for moment, sums in (
                (self.position_moment, self.sweep_position),
                (self.reading_moment, self.sweep_reading),
            )
        )
        if known.any():
            left = -rho
            left[:, -1] += label_error
            L += (left.T * known) @ left
        shares = [
            float((sums[:, HELD] / np.where(own > 0, own, 1.0)).sum())
            for sums in (self.sweep_position, self.sweep_reading)
        ]
        absorbed = self.absorbed_position + shares[0]
        labels = float((known / np.where(own > 0, own, 1.0)).sum())
        rotation = self.free + (own > 0).sum() - absorbed - self.absorbed_readings - shares[1] - labels
        H, M, L = (0.5 * (x + x.T) for x in (H, M, L))
        return Reduced(
            H=H[:-1, :-1],
            g=H[:-1, -1],
            position_information=M[:-1, :-1],
            reading_information=L[:-1, :-1],
            redundancy=(3 * self.poses - absorbed, float(3 * self.poses - rotation)),
            exchanged=self.exchanged,
            distance2=self.distance2,
            left=self.left,
            squares=(float(self.squares[0]), float(self.squares[1])),
            reading_cost=self.reading_cost,
            sigma=sigma,
            _position=(M[:-1, -1], float(M[-1, -1])),
            _reading=(L[:-1, -1], float(L[-1, -1])),
            _constant=float(H[-1, -1]) + self.reading_cost,
            _response=self.response,
            _sweep_response=ratio,
            _sweep_information=own,
            _columns=columns,
            _placement=problem.placement,
            _model=model,
        )


def columns_of(placements: int) -> np.ndarray:
    """(P, 14) positions of the local unknowns among all."""
    shared = 6 * placements + np.arange(LOCAL - 6)
    return np.stack([np.concatenate([6 * p + np.arange(6), shared]) for p in range(placements)])


def _members(part: Problem) -> list[tuple[int, slice | np.ndarray]]:
    """The placements in a block, each with its poses."""
    first = int(part.placement[0])
    if (part.placement == first).all():
        return [(first, slice(None))]
    return [(int(p), np.flatnonzero(part.placement == p)) for p in np.unique(part.placement)]


def _moment(left: Array, right: Array) -> Array:
    """Sum over rows and poses of the outer products of the columns."""
    return np.matmul(left, right.swapaxes(1, 2)).sum(axis=0)


def _assembled(moment: Array, columns: np.ndarray, size: int) -> Array:
    """(size + 1, size + 1) of the moments (P, 16, 16) of the placements, the residual's column last."""
    full = np.zeros((size + 1, size + 1))
    kept = np.r_[:LOCAL, RESIDUAL]
    for local, index in zip(moment, columns, strict=True):
        index = np.append(index, size)
        full[np.ix_(index, index)] += local[np.ix_(kept, kept)]
    return full


def _without_sweeps(M: Array, w: Array, rho: Array, own: Array) -> Array:
    """The moment of rows U - U_h rho_s from those of U: M, their products w with the held column, own with itself."""
    return M - rho.T @ w - w.T @ rho + (rho.T * own) @ rho


def _spread(rows: Array, index: np.ndarray, size: int) -> Array:
    """(S, size) of the sweeps' rows (S, 16), the residual's column last."""
    full = np.zeros((len(rows), size))
    np.put_along_axis(full, index, rows[:, np.r_[:LOCAL, RESIDUAL]], axis=1)
    return full
