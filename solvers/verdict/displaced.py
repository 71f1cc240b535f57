"""The score test of a displacement of base or sensor at a part of the poses: docs/estimation.md, "Two sensors"."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from solvers.likelihood.f_test import f_tail
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus
from solvers.verdict.change import FREEDOM, SENSOR, UNSEEN
from solvers.verdict.residuals import neighbour_correlation

ROUNDING = 1e-9
"""Share of the greatest information below which that on another direction is rounding."""
MOST_ALIKE = 0.99
"""Greatest correlation of neighbours that is reckoned with."""
EXACT = 1e-3
"""Mean square of the weighted residuals below which they are rounding, not noise."""


@dataclass(frozen=True, eq=False)
class Displacement:
    """Of the sensor or the base, at some of the poses."""

    delta: Array
    """(6,) right perturbation [v, w], m and rad; 0 where it is not seen."""
    lowered: float
    """By how much the weighted sum of squares falls."""
    rank: int
    """Directions of the displacement that are seen."""
    left: float
    """Sum of squares that is left, and"""
    dof: int
    """its degrees of freedom."""
    tried: int
    """Among how many parts of the poses this one was chosen."""

    def probability(self, T: float = 1.0) -> float:
        """That noise alone lowers the sum of squares as much anywhere (a bound), where T poses tell as much as one."""
        if not self.rank or self.dof <= 0:
            return 1.0
        F = self.lowered / self.rank / max(self.left / self.dof, EXACT) / T
        return min(1.0, self.tried * f_tail(self.rank, max(self.dof / T, 1.0), F))

    def of_sensor(self, torus: Torus) -> tuple[float, float]:
        """Its size at the sensor, m and rad. The turn about the orbital axis is not seen: the least shift is told."""
        p = np.linalg.solve(torus.T_sensor_carm[:3, :3], -torus.T_sensor_carm[:3, 3])
        v, w = self.delta[:3], self.delta[3:]
        about_axis = np.cross([0.0, 1.0, 0.0], p)
        shift = v + np.cross(w, p)
        shift = shift - about_axis * (shift @ about_axis) / max(about_axis @ about_axis, 1e-12)
        return float(np.linalg.norm(shift)), float(np.linalg.norm(w[[0, 2]]))

    def of_sensor_in_words(self, torus: Torus) -> str:
        """Its size at the sensor."""
        shift, turn = self.of_sensor(torus)
        return f"{shift * 1e3:.1f} mm and {np.degrees(turn):.2f} deg"


@dataclass(frozen=True, eq=False)
class Nuisance:
    """All unknowns of the machine, eliminated from the rows of `solvers.verdict.change.rows_of`."""

    rows: Array
    """(6, C, n)."""
    problem: Problem
    V: Array
    """(D, K) whitens the information of the nuisance."""

    @staticmethod
    def of(rows: Array, problem: Problem) -> "Nuisance":
        """From the poses (n) of a problem."""
        size = 6 * problem.placements + rows.shape[1] - 7
        H = np.zeros((size, size))
        for p in range(problem.placements):
            index, U = _columns(p, problem, size), rows[:, :-1, problem.placement == p]
            H[np.ix_(index, index)] += np.matmul(U, U.swapaxes(1, 2)).sum(axis=0)
        scale = 1 / np.sqrt(np.maximum(np.diagonal(H), 1e-300))
        values, vectors = np.linalg.eigh(H * np.outer(scale, scale))
        kept = values > 1e-12 * values[-1]
        return Nuisance(rows, problem, scale[:, None] * vectors[:, kept] / np.sqrt(values[kept]))

    def besides(self, poses: np.ndarray) -> "Nuisance":
        """The same with a displacement of the sensor at the ``poses`` (n,) as one more nuisance."""
        own = self.rows[:, SENSOR] * poses
        return Nuisance.of(np.concatenate([self.rows[:, :-1], own, self.rows[:, -1:]], axis=1), self.problem)

    def displaced(self, poses: np.ndarray, of: slice = SENSOR) -> Displacement:
        """The most likely displacement at the ``poses`` (n,), a mask."""
        edges = np.array([0, len(poses)])
        return self._best(self._sums(poses, edges, of), np.array([0]), np.array([1]))[1]

    def stretch(self, edges: np.ndarray, of: slice = SENSOR) -> tuple[int, int, Displacement]:
        """Between which two of the ``edges``, rising pose numbers from 0 to n, a displacement lowers the sum of squares
        most, and the displacement. The whole is no stretch."""
        first, last = (index.ravel() for index in np.triu_indices(len(edges), 1))
        part = ~((first == 0) & (last == len(edges) - 1))
        first, last = first[part], last[part]
        k, found = self._best(self._sums(np.ones(edges[-1], dtype=bool), edges, of), first, last)
        return int(edges[first[k]]), int(edges[last[k]]), found

    def correlation_time(self, poses: np.ndarray, found: Displacement) -> float:
        """How many poses tell as much as one, once the sensor is displaced at the ``poses``: (1 + r) / (1 - r) by the
        correlation r of neighbours."""
        left = self.rows[:, -1] + np.einsum("rin,i->rn", self.rows[:, SENSOR], found.delta) * poses
        x = -self.V @ (self.V.T @ self._against(left))
        for p in range(self.problem.placements):
            here = self.problem.placement == p
            left[:, here] += np.einsum("rin,i->rn", self.rows[:, :-1, here], x[_columns(p, self.problem, len(x))])
        r = min(neighbour_correlation(self.problem, left), MOST_ALIKE)
        return (1 + r) / (1 - r)

    def _sums(self, poses: np.ndarray, edges: np.ndarray, of: slice) -> tuple[Array, Array, Array]:
        """Cumulative sums at the edges: of the own columns and the residual with the whitened nuisance (E, K, 7), with
        themselves (E, 7, 7); and the residual's whole with the nuisance (K,)."""
        U = self.rows * poses
        own = np.concatenate([U[:, of], U[:, -1:]], axis=1)
        size = len(self.V)
        D, E = np.zeros((len(edges), size, 7)), np.zeros((len(edges), 7, 7))
        for k, (a, b) in enumerate(pairwise(edges)):
            E[k + 1] = np.einsum("rin,rkn->ik", own[..., a:b], own[..., a:b])
            for p in np.unique(self.problem.placement[a:b]):
                here = a + np.flatnonzero(self.problem.placement[a:b] == p)
                D[k + 1, _columns(p, self.problem, size)] += np.einsum("rin,rkn->ik", U[:, :-1, here], own[..., here])
        whole = self._against(self.rows[:, -1])
        return np.einsum("dk,edi->eki", self.V, np.cumsum(D, axis=0)), np.cumsum(E, axis=0), whole @ self.V

    def _against(self, residual: Array) -> Array:
        """(D,) products of the nuisance's columns with weighted residuals (6, n)."""
        found = np.zeros(len(self.V))
        for p in range(self.problem.placements):
            here = self.problem.placement == p
            own = np.einsum("rin,rn->i", self.rows[:, :-1, here], residual[:, here])
            found[_columns(p, self.problem, len(found))] += own
        return found

    def _best(self, sums: tuple[Array, Array, Array], first: np.ndarray, last: np.ndarray) -> tuple[int, Displacement]:
        D, E, g = sums[0][last] - sums[0][first], sums[1][last] - sums[1][first], sums[2]
        D = D[..., :6]
        S = E[:, :6, :6] - D.swapaxes(1, 2) @ D
        pull = E[:, :6, 6] - np.einsum("ekj,k->ej", D, g)
        diagonal = np.diagonal(E[:, :6, :6], axis1=1, axis2=2)
        unit = 1 / np.sqrt(np.where(diagonal > ROUNDING * diagonal.max(axis=1, keepdims=True), diagonal, np.inf))
        values, vectors = np.linalg.eigh(S * unit[:, :, None] * unit[:, None])
        seen = values > UNSEEN
        z = np.einsum("eij,ei->ej", vectors, pull * unit)
        inverse = np.where(seen, 1 / np.where(seen, values, 1.0), 0.0)
        lowered = (inverse * z**2).sum(axis=1)
        k = int(np.argmax(lowered))
        delta = -unit[k] * (vectors[k] @ (inverse[k] * z[k]))
        cost = float((self.rows[:, -1] ** 2).sum() - g @ g)
        rank = int(seen[k].sum())
        dof = FREEDOM * len(self.problem) - self.V.shape[1] - rank
        return k, Displacement(delta, float(lowered[k]), rank, cost - float(lowered[k]), dof, len(first))


def _columns(p: int, problem: Problem, size: int) -> np.ndarray:
    """Where placement p's local unknowns stand among all."""
    return np.concatenate([6 * p + np.arange(6), np.arange(6 * problem.placements, size)])
