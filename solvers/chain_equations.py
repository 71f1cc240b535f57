"""The normal equations of a machine's chain, every single value of a joint eliminated. docs/estimation.md, section 14.

Each pose gives six rows, and one more for every joint that is read: the reading's error over its sigma. Over the
values of its own (k of them, block G) a pose is reduced by itself, as in section 3; all other unknowns are global.
Rows are of four kinds, each with a variance of its own: positions, orientations, readings of angles, of lengths.
"""

from dataclasses import dataclass

import numpy as np

from solvers.chain_problem import ANGLES, KINDS, LENGTHS, ChainProblem, Layout
from solvers.machine import Machine, linearise
from solvers.se3 import Array

CHUNK = 4000
"""Poses linearised at once."""
RIDGE = 1e-12


@dataclass(frozen=True, eq=False)
class Reduced:
    """D global unknowns, N poses."""

    sigma: Array
    """(KINDS,) standard deviations with which the rows are weighted, m and rad."""
    H_by_kind: Array
    """(KINDS, D, D) information after the elimination."""
    g_by_kind: Array
    """(KINDS, D)."""
    squares: Array
    """(KINDS,) sums of squares with the values of single poses at their best."""
    counts: Array
    """(KINDS, KINDS) Helmert's matrix of the rows before the global unknowns take their share: the expected sum of
    squares of a kind by the variance of each."""
    distance2: Array
    """(N,) weighted squares of a pose with its own values at their best."""
    steps: tuple[tuple[np.ndarray, np.ndarray, Array], ...]
    """Poses (n,), columns (C,) and responses (n, J, C + 1) of the values to the columns and of their own."""
    factors: tuple[tuple[np.ndarray, Array], ...]
    """Columns (C,) and triangular factor (C, C) of the reduced rows of a group: all it tells of the unknowns."""
    length: Array
    """(D,) of the columns before the elimination."""

    @property
    def H(self) -> Array:
        """(D, D)."""
        return self.H_by_kind.sum(axis=0)

    @property
    def g(self) -> Array:
        """(D,)."""
        return self.g_by_kind.sum(axis=0)

    @property
    def cost(self) -> float:
        """Weighted sum of squares."""
        return float(self.squares.sum())

    def cost_at(self, ratio: Array) -> float:
        """The sum if the sigmas were divided by ``ratio`` (KINDS,), the values staying as they are."""
        return float((self.squares * ratio**2).sum())

    def squares_after(self, step: Array) -> Array:
        """(KINDS,) sums of squares after a step of the global unknowns."""
        return self.squares + 2 * self.g_by_kind @ step + (self.H_by_kind @ step) @ step

    def value_step(self, step: Array, shape: tuple[int, int]) -> Array:
        """Steps (N, J) of the values of single poses for a step of the global unknowns."""
        found = np.zeros(shape)
        for poses, columns, response in self.steps:
            found[poses] = -(response[..., :-1] @ step[columns] + response[..., -1])
        return found


def normal_equations(
    machine: Machine, values: Array, problem: ChainProblem, layout: Layout, sigma: Array, used: np.ndarray
) -> Reduced:
    """At the values (N, J) of the joints, weighted with ``sigma`` (KINDS,); poses that are not ``used`` (N,)
    have weight 0."""
    D = layout.size
    H, g, squares, counts = (np.zeros((KINDS, *shape)) for shape in ((D, D), (D,), (), (KINDS,)))
    distance2, length2, steps, factors = np.zeros(len(problem)), np.zeros(D), [], []
    for group in problem.groups:
        triangle, columns = np.zeros((0, 0)), np.zeros(0, dtype=int)
        for start in range(0, len(group), CHUNK):
            poses = group[start : start + CHUNK]
            columns, B, A, kinds = _rows(machine, values, problem, layout, sigma, poses)
            length2[columns] += (B[..., :-1] ** 2).sum(axis=(0, 1))
            C = np.swapaxes(A, 1, 2) @ B
            own = problem.free[poses][:, machine.paths[problem.sensor[poses[0]]]]
            inverse = _inverse(A, own)
            X = inverse @ C
            U = B - A @ X
            distance2[poses] = (U[..., -1] ** 2).sum(axis=1)
            weight = used[poses].astype(float)
            U = U * weight[:, None, None]
            counts += _counts(A, inverse, kinds * weight[:, None, None])
            for kind in range(KINDS):
                rows = (U * kinds[..., kind, None]).reshape(-1, U.shape[-1])
                moment = rows.T @ rows
                H[kind][np.ix_(columns, columns)] += moment[:-1, :-1]
                g[kind][columns] += moment[:-1, -1]
                squares[kind] += moment[-1, -1]
            stacked = U[..., :-1].reshape(-1, len(columns))
            triangle = np.linalg.qr(np.vstack([triangle, stacked]) if triangle.size else stacked, mode="r")
            spread = np.zeros((len(poses), values.shape[1], X.shape[-1]))
            spread[:, machine.paths[problem.sensor[poses[0]]]] = X
            steps.append((poses, columns, spread))
        factors.append((columns, triangle))
    return Reduced(sigma, H, g, squares, counts, distance2, tuple(steps), tuple(factors), np.sqrt(length2))


def _rows(
    machine: Machine, values: Array, problem: ChainProblem, layout: Layout, sigma: Array, poses: np.ndarray
) -> tuple[np.ndarray, Array, Array, Array]:
    """Of poses of one group: the global columns (C,), the weighted rows by them and the residual (n, 6 + k, C + 1),
    by the poses' own values (n, 6 + k, k), and which kind (n, 6 + k, KINDS) each row is."""
    p, s = int(problem.placement[poses[0]]), int(problem.sensor[poses[0]])
    path, n = machine.paths[s], len(poses)
    k = len(path)
    line = linearise(machine, values[poses], problem.T_world_sensor[poses], p, s)
    by_value = line.by_motion * (1 + machine.gains[path])
    constant = problem.constant[poses[0], path]
    parts = [line.by_base, line.by_placement.reshape(n, 6, 6 * k), line.by_motion]
    parts += [line.by_motion * values[poses][:, None, path], np.broadcast_to(np.eye(6), (n, 6, 6))]
    parts += [by_value[:, :, constant >= 0], -line.residual[:, :, None]]
    placements = [layout.placement(j) for j in path]
    own_constants = layout.constant(0) + constant[constant >= 0]
    columns = np.concatenate(
        [layout.base(p), *placements, layout.offset(0) + path, layout.gain(0) + path, layout.mount(s), own_constants]
    )
    weight = np.repeat(1 / sigma[:2], 3)[:, None]
    own, read = problem.free[poses][:, path], problem.read[poses][:, path]
    kind = np.where(problem.prismatic[path], LENGTHS, ANGLES)
    error = np.where(read, (values[poses] - problem.label[poses])[:, path] / sigma[kind], 0.0)
    B = np.zeros((n, 6 + k, len(columns) + 1))
    B[:, :6] = np.concatenate(parts, axis=2) * weight
    B[:, 6:, -1] = error
    A = np.zeros((n, 6 + k, k))
    A[:, :6] = by_value * weight * own[:, None]
    A[:, 6:][:, np.arange(k), np.arange(k)] = read / sigma[kind]
    kinds = np.zeros((n, 6 + k, KINDS))
    kinds[:, :3, 0] = kinds[:, 3:6, 1] = 1
    kinds[:, 6 + np.arange(k), kind] = read
    return columns, B, A, kinds


def _inverse(A: Array, own: np.ndarray) -> Array:
    """inv(AT A) (n, k, k), the rows of values that are not the pose's own those of the identity. A small ridge keeps
    rounding small where two joints move the sensor alike."""
    G = np.swapaxes(A, 1, 2) @ A
    k = G.shape[1]
    ridge = RIDGE * np.trace(G, axis1=1, axis2=2) + np.finfo(float).tiny
    G[:, np.arange(k), np.arange(k)] += ~own + ridge[:, None]
    return np.asarray(np.linalg.inv(G), dtype=float)


def _counts(A: Array, inverse: Array, kinds: Array) -> Array:
    """(KINDS, KINDS) sums over the poses of tr(P_a M P_b M), with M = 1 - A inv(G) AT and P_a the rows of a kind."""
    blocks = [inverse @ (np.swapaxes(A * kinds[..., a, None], 1, 2) @ A) for a in range(KINDS)]
    found = np.array([[np.einsum("nij,nji->", x, y) for y in blocks] for x in blocks])
    found += np.diag(kinds.sum(axis=(0, 1)) - 2 * np.array([np.einsum("nii->", x) for x in blocks]))
    return found
