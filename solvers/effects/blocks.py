"""The linearised likelihood of stretches of neighbouring poses: as much as slow effects need, and no more."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solvers.likelihood.correlation import Stretches
from solvers.likelihood.elimination import columns_of
from solvers.likelihood.linearise import LOCAL, AngleModel, Linearisation, linearise
from solvers.likelihood.reduced import HELD, RESIDUAL, OwnAngles, row_scale, shape_roots, shaped, weighted
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus

MOST_BLOCKS = 480
"""Stretches into which the poses are cut, about."""


@dataclass(frozen=True, eq=False)
class Cut:
    """N poses cut into B stretches of neighbours, or blocks, about `MOST_BLOCKS` of them."""

    order: np.ndarray
    """(N,) the poses as they follow one another."""
    number: np.ndarray
    """(N,) of the contiguous stretch of each pose of `order`; it never falls."""
    first: np.ndarray
    """(B,) where each block begins in `order`."""

    @staticmethod
    def of(stretches: Stretches) -> "Cut":
        """Blocks of one size, the last of a stretch less."""
        n = len(stretches.order)
        size = -(-n // MOST_BLOCKS)
        begins = np.concatenate([[True], np.diff(stretches.number) > 0])
        start = np.flatnonzero(begins)
        within = np.arange(n) - start[np.cumsum(begins) - 1]
        return Cut(stretches.order, stretches.number, np.flatnonzero(within % size == 0))

    @cached_property
    def count(self) -> np.ndarray:
        """(B,) number of poses."""
        return np.diff(np.append(self.first, len(self.order)))

    @cached_property
    def middle(self) -> np.ndarray:
        """(B,) the pose in the middle of each block."""
        return self.order[self.first + self.count // 2]

    @property
    def stretch(self) -> np.ndarray:
        """(B,) number of the contiguous stretch of poses in which it lies; it never falls."""
        return self.number[self.first]

    def mean(self, values: Array) -> Array:
        """(..., B) means over the blocks of the values (..., N) of all poses."""
        return np.add.reduceat(values[..., self.order], self.first, axis=-1) / self.count


@dataclass(frozen=True, eq=False)
class Blocks(Cut):
    """Each block of poses of one sweep as one pose of the mean of their rows.

    The rows are those of the weighted linearisation with the poses' own angles eliminated, times the root of the
    number of poses: the variance of white noise is then 1.
    """

    active: np.ndarray
    """(D,) the unknowns of the chain that are determined."""
    by_unknown: Array
    """(6 + 2, u, B) derivative of the residual by the unknowns: the machine's active ones, then the held angles."""
    residual: Array
    """(6 + 2, B) position, rotation, and two of the readings, all 0 where there are none."""
    whiten: Array
    """(6, 6, B) takes a displacement (m, rad, in the carm frame) to the rows."""
    rows: Array
    """(2,) number of position and of rotation rows, less what the eliminated angles absorb."""
    fixed: Array
    """(u + 1, u + 1) information of the labels of held angles on the unknowns, less their gradient, and their cost."""

    @staticmethod
    def at(problem: Problem, torus: Torus, angles: Array, sigma: tuple[float, float], active: np.ndarray) -> "Blocks":
        """Of all poses at the estimate ``torus``, ``angles`` (2, N), with its noise (m, rad) and ``active`` (D,)
        unknowns."""
        model = AngleModel.of(problem)
        line = linearise(torus, angles, problem)
        B, A = weighted(line, model, sigma)
        error = model.reading_error(angles)
        angle = OwnAngles.of(B, A, model, error)
        g, h, k = angle.inverse
        absorbed = np.stack([g * a + 2 * h * b + k * d for a, b, d in (angle.position, angle.rotation)])
        B = np.concatenate([angle.left_of(B, A), angle.readings(model.precision, error)])

        cut = Cut.of(Stretches.of(problem))
        middle, root = cut.middle, np.sqrt(cut.count)
        B = cut.mean(B) * root
        sweep = np.maximum.reduceat(model.sweep[cut.order], cut.first)
        by_unknown = _among_all(B, problem.placement[middle], sweep, model)[:, _kept(active, model)]
        weights = _weights(line, model, sigma, middle)
        return Blocks(
            cut.order,
            cut.number,
            cut.first,
            active=active,
            by_unknown=by_unknown,
            residual=B[:, RESIDUAL],
            whiten=_projected(A[..., middle], angle.inverse[:, middle], weights) * root,
            rows=3 * len(cut.first) - cut.mean(absorbed).sum(axis=1),
            fixed=_labels(model, angles, active),
        )

    @property
    def stretches(self) -> list[slice]:
        """Where each contiguous stretch of poses stands in `order`."""
        edges = self.first[np.flatnonzero(np.diff(self.stretch)) + 1]
        return [slice(a, b) for a, b in zip([0, *edges], [*edges, len(self.order)], strict=True)]


def _among_all(B: Array, placement: np.ndarray, sweep: np.ndarray, model: AngleModel) -> Array:
    """(6, D + S, B) the columns of the blocks' own unknowns and of their held angle, if any, among those of all."""
    placements, poses = int(placement.max()) + 1, np.arange(len(placement))
    size, sweeps = 6 * placements + LOCAL - 6, len(model.sweep_placement)
    full = np.zeros((len(B), size + sweeps, len(placement)))
    full[:, columns_of(placements)[placement], poses[:, None]] = B[:, :LOCAL].swapaxes(1, 2)
    held = np.flatnonzero(sweep >= 0)
    full[:, size + sweep[held], held] = B[:, HELD, held]
    return full


def _kept(active: np.ndarray, model: AngleModel) -> np.ndarray:
    return np.concatenate([active, np.ones(len(model.sweep_placement), dtype=bool)])


def _projected(A: Array, G: Array, weights: Array) -> Array:
    """(6, 6, B): I - A inv(G) Aᵀ of the poses' own angles, times the weights."""
    g, h, k = G
    first, second = A[:, 0] * g + A[:, 1] * h, A[:, 0] * h + A[:, 1] * k
    P = np.eye(len(A))[:, :, None] - A[:, None, 0] * first - A[:, None, 1] * second
    return np.einsum("rsb,stb->rtb", P, weights)


def _weights(line: Linearisation, model: AngleModel, sigma: tuple[float, float], poses: np.ndarray) -> Array:
    """(6, 6, B) takes a displacement in the carm frame to weighted rows."""
    scale = np.broadcast_to(row_scale(model, sigma), (6, line.residual.shape[1]))[:, poses]
    weights = np.eye(6)[:, :, None] * scale
    return weights if line.R_world_carm is None else shaped(weights, shape_roots(model, line.R_world_carm[..., poses]))


def _labels(model: AngleModel, angles: Array, active: np.ndarray) -> Array:
    """(u + 1, u + 1) of the labels of held angles, which are off by their error at the estimate."""
    known, error = model.sweep_precision, model.label_error(angles)
    u = int(active.sum()) + len(known)
    fixed, own = np.zeros((u + 1, u + 1)), np.arange(u - len(known), u)
    fixed[own, own] = known
    fixed[own, -1] = fixed[-1, own] = -known * error
    fixed[-1, -1] = (known * error**2).sum()
    return fixed
