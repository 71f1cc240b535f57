"""The normal equations of a machine's chain, every single value of a joint eliminated. docs/estimation.md, section 16.

Each pose gives six rows, and one more for every joint that is read: the reading's error over its sigma. Over the
values of its own (k of them, block G) a pose is reduced by itself, as in section 3; all other unknowns are global.
Rows are of four kinds, each with a variance of its own: positions, orientations, readings of angles, of lengths.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from solvers.chain.machine import Linearised, Machine, linearise
from solvers.chain.problem import ANGLES, KINDS, LENGTHS, ORIENTATIONS, POSITIONS, ChainProblem, Layout
from solvers.se3 import Array

CHUNK = 1000
"""Poses linearised at once."""
RIDGE = 1e-12


@dataclass(frozen=True, eq=False)
class Reduced:
    """D global unknowns, N poses. What was not asked for has rows and columns of zeros."""

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
    exchanged: dict[tuple[int, int], Array]
    """(D, D) for each two kinds a < b: sum of VaT inv(G) Vb, with Va = AaT Ua and U the reduced rows."""
    distance2: Array
    """(N,) weighted squares of a pose with its own values at their best."""
    steps: tuple[tuple[np.ndarray, np.ndarray, np.ndarray, Array], ...]
    """Poses (n,), joints (k,), columns (C,) and responses (n, k, C + 1) of the joints' values to the columns and of
    their own."""

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

    def cost_at(self, sigma: Array) -> float:
        """The sum if the sigmas were these (KINDS,), the values staying as they are."""
        return float((self.squares * (self.sigma / sigma) ** 2).sum())

    def squares_after(self, step: Array) -> Array:
        """(KINDS,) sums of squares after a step of the global unknowns."""
        return np.maximum(self.squares + 2 * self.g_by_kind @ step + (self.H_by_kind @ step) @ step, 0.0)

    def value_step(self, step: Array, shape: tuple[int, int]) -> Array:
        """Steps (N, J) of the values of single poses for a step of the global unknowns."""
        found = np.zeros(shape)
        for poses, joints, columns, response in self.steps:
            found[poses[:, None], joints] = -(response[..., :-1] @ step[columns] + response[..., -1])
        return found


def normal_equations(
    machine: Machine,
    values: Array,
    problem: ChainProblem,
    layout: Layout,
    sigma: Array,
    used: np.ndarray,
    wanted: np.ndarray,
) -> Reduced:
    """By the ``wanted`` (D,) unknowns at the values (N, J) of the joints, weighted with ``sigma`` (KINDS,); poses that
    are not ``used`` (N,) have weight 0."""
    D = layout.size
    H, g, squares, counts = (np.zeros((KINDS, *shape)) for shape in ((D, D), (D,), (), (KINDS,)))
    distance2, steps, exchanged = np.zeros(len(problem)), [], {}
    for block in _blocks(machine, values, problem, layout, sigma, wanted):
        inverse, X, U = block.eliminated()
        distance2[block.poses] = np.einsum("nr,nr->n", U[..., -1], U[..., -1])
        weight = used[block.poses].astype(float)
        if not weight.all():
            U *= weight[:, None, None]
        counts += _counts(block, inverse, weight)
        for pair, moment in _exchanged(block, inverse, U).items():
            exchanged.setdefault(pair, np.zeros((D, D)))[np.ix_(block.columns, block.columns)] += moment
        for kind in np.unique(block.kind):
            rows = U[:, block.kind == kind].reshape(-1, U.shape[-1])
            moment = rows.T @ rows
            H[kind][np.ix_(block.columns, block.columns)] += moment[:-1, :-1]
            g[kind][block.columns] += moment[:-1, -1]
            squares[kind] += moment[-1, -1]
        steps.append((block.poses, block.joints, block.columns, X))
    return Reduced(sigma, H, g, squares, counts, exchanged, distance2, tuple(steps))


def factors(
    machine: Machine,
    values: Array,
    problem: ChainProblem,
    layout: Layout,
    sigma: Array,
    used: np.ndarray,
    wanted: np.ndarray,
) -> tuple[Array, Array]:
    """All that the ``used`` poses tell of the ``wanted`` unknowns, as in `normal_equations`: rows (M, D) whose moments
    are the information, triangular for every group of poses, and the length (D,) of the columns before the
    elimination."""
    length2, rows = np.zeros(layout.size), []
    triangle, before = np.zeros((0, 0)), np.zeros(0, dtype=int)
    for block in _blocks(machine, values, problem, layout, sigma, wanted):
        length2[block.columns] += (block.B[..., :-1] ** 2).sum(axis=(0, 1))
        U = block.eliminated()[2][used[block.poses], :, :-1].reshape(-1, len(block.columns))
        if not np.array_equal(before, block.columns):
            rows.append(_spread(triangle, before, layout.size))
            triangle, before = np.zeros((0, U.shape[1])), block.columns
        triangle = np.asarray(np.linalg.qr(np.vstack([triangle, U]), mode="r"), dtype=float)
    rows.append(_spread(triangle, before, layout.size))
    return np.concatenate(rows), np.sqrt(length2)


@dataclass(frozen=True, eq=False)
class Beside:
    """What all poses tell of the wanted unknowns and of other columns beside them."""

    rows: Array
    """(6, w, N) weighted rows [U Z y] of the positions and orientations, the poses' own values eliminated."""
    readings: Array
    """(w, w) moments of the rows of the readings."""
    left: Array
    """(2,) number of position and of orientation rows, less what the own values take."""


def rows_beside(
    machine: Machine,
    values: Array,
    problem: ChainProblem,
    layout: Layout,
    sigma: Array,
    wanted: np.ndarray,
    Z: Array,
) -> Beside:
    """The rows of the poses with the columns ``Z`` (N, 6, m), displacements of the sensor in its frame (m, rad), beside
    the ``wanted`` (D,) unknowns."""
    u, m = int(wanted.sum()), Z.shape[2]
    place = np.cumsum(wanted) - 1
    width = u + m + 1
    rows, readings, left = np.zeros((6, width, len(problem))), np.zeros((width, width)), np.zeros(2)
    weight = np.repeat(1 / sigma[[POSITIONS, ORIENTATIONS]], 3)
    for block in _blocks(machine, values, problem, layout, sigma, wanted):
        index = np.concatenate([place[block.columns], u + np.arange(m + 1)])
        beside = np.zeros((*block.B.shape[:2], m))
        beside[:, :6] = Z[block.poses] * weight[:, None]
        B = np.concatenate([block.B[..., :-1], beside, -block.B[..., -1:]], axis=2)
        inverse, _, U = replace(block, B=B).eliminated()
        for r in range(6):
            rows[r][np.ix_(index, block.poses)] = U[:, r].T
        own = U[:, 6:].reshape(-1, len(index))
        readings[np.ix_(index, index)] += own.T @ own
        counts = _counts(block, inverse, np.ones(len(block.poses)))
        left += counts[[POSITIONS, ORIENTATIONS]][:, [POSITIONS, ORIENTATIONS]].sum(axis=1)
    return Beside(rows, readings, left)


def _spread(rows: Array, columns: np.ndarray, size: int) -> Array:
    found = np.zeros((len(rows), size))
    found[:, columns] = rows
    return found


@dataclass(frozen=True, eq=False)
class _Block:
    """n poses with the same unknowns: m weighted rows a pose, k joints that have values of their own."""

    poses: np.ndarray
    joints: np.ndarray
    """(k,)."""
    columns: np.ndarray
    """(C,) global unknowns."""
    B: Array
    """(n, m, C + 1) by the global unknowns, and the residual."""
    A: Array
    """(n, m, k) by the poses' own values; 0 where the value is no unknown."""
    own: np.ndarray
    """(n, k) whether it is one."""
    kind: np.ndarray
    """(m,) of the rows."""
    present: np.ndarray
    """(n, m) whether there is such a row; else it is 0."""

    def eliminated(self) -> tuple[Array, Array, Array]:
        """inv(AT A) (n, k, k), the responses of the own values (n, k, C + 1), and B less what they take."""
        At = np.swapaxes(self.A, 1, 2)
        inverse = _inverse(At @ self.A, self.own)
        X = inverse @ (At @ self.B)
        return inverse, X, self.B - self.A @ X


def _blocks(
    machine: Machine, values: Array, problem: ChainProblem, layout: Layout, sigma: Array, wanted: np.ndarray
) -> Iterator[_Block]:
    for group in problem.groups:
        path = machine.paths[problem.sensor[group[0]]]
        free, read = (path[part[group][:, path].any(axis=0)] for part in (problem.free, problem.read))
        for start in range(0, len(group), CHUNK):
            poses = group[start : start + CHUNK]
            yield _block(machine, values, problem, layout, sigma, wanted, poses, free, read)


def _block(
    machine: Machine,
    values: Array,
    problem: ChainProblem,
    layout: Layout,
    sigma: Array,
    wanted: np.ndarray,
    poses: np.ndarray,
    free: np.ndarray,
    read: np.ndarray,
) -> _Block:
    """Of ``poses`` of one group, in which the joints ``free`` have values of their own and the joints ``read`` (part
    of them) readings."""
    p, s = int(problem.placement[poses[0]]), int(problem.sensor[poses[0]])
    line = linearise(machine, values[poses], problem.T_world_sensor[poses], p, s)
    columns, twists = _twists(line, values[poses], problem.constant[poses[0]], layout, p, s, wanted)
    n, m = len(poses), 6 + len(read)
    weight = np.repeat(1 / sigma[[POSITIONS, ORIENTATIONS]], 3)
    B, A = np.zeros((n, m, len(columns) + 1)), np.zeros((n, m, len(free)))
    np.multiply(twists, weight[:, None], out=B[:, :6, :-1])
    B[:, :6, -1] = -line.residual * weight
    own, known = problem.free[poses[:, None], free], problem.read[poses[:, None], read]
    for i, j in enumerate(free):
        k = int(np.flatnonzero(line.path == j)[0])
        A[:, :6, i] = line.by_motion(k) * ((1 + machine.gains[j]) * weight) * own[:, i, None]
    kind = np.where(problem.prismatic[read], LENGTHS, ANGLES)
    error = (values[poses[:, None], read] - problem.label[poses[:, None], read]) / sigma[kind]
    B[:, 6:, -1] = np.where(known, error, 0.0)
    for i, j in enumerate(read):
        A[:, 6 + i, np.flatnonzero(free == j)[0]] = known[:, i] / sigma[kind[i]]
    return _Block(
        poses,
        free,
        columns,
        B,
        A,
        own,
        np.concatenate([np.repeat([POSITIONS, ORIENTATIONS], 3), kind]),
        np.concatenate([np.ones((n, 6), dtype=bool), known], axis=1),
    )


def _twists(
    line: Linearised,
    values: Array,
    constant: np.ndarray,
    layout: Layout,
    placement: int,
    sensor: int,
    wanted: np.ndarray,
) -> tuple[np.ndarray, Array]:
    """The wanted unknowns (C,) that these poses see, and the twists (n, 6, C) by them; ``constant`` (J,) numbers the
    constants that they share."""
    n, path, gains = len(values), line.path, line.machine.gains
    columns, parts = [], []

    def add(own: np.ndarray, twist: Array) -> None:
        columns.append(own[wanted[own]])
        parts.append(twist[..., wanted[own]])

    add(layout.base(placement), line.by_base())
    for k, j in enumerate(path):
        if wanted[layout.placement(j)].any():
            add(layout.placement(j), line.by_placement(k))
        scalars = [layout.offset(j), layout.gain(j)]
        scales = [np.ones(n), values[:, j]]
        if constant[j] >= 0:
            scalars.append(layout.constant(int(constant[j])))
            scales.append(np.full(n, 1 + gains[j]))
        if wanted[scalars].any():
            add(np.array(scalars), line.by_motion(k)[:, :, None] * np.stack(scales, axis=1)[:, None])
    add(layout.mount(sensor), np.broadcast_to(np.eye(6), (n, 6, 6)))
    return np.concatenate(columns), np.concatenate(parts, axis=2)


def _inverse(G: Array, own: np.ndarray) -> Array:
    """inv(G) (n, k, k), the rows of values that are not the pose's own those of the identity. A small ridge keeps
    rounding small where two joints move the sensor alike."""
    k = G.shape[1]
    ridge = RIDGE * np.trace(G, axis1=1, axis2=2) + np.finfo(float).tiny
    G[:, np.arange(k), np.arange(k)] += ~own + ridge[:, None]
    return np.asarray(np.linalg.inv(G), dtype=float)


def _counts(block: _Block, inverse: Array, weight: Array) -> Array:
    """(KINDS, KINDS) sums over the poses of tr(P_a M P_b M), with M = 1 - A inv(G) AT and P_a the rows of a kind."""
    found = np.zeros((KINDS, KINDS))
    kinds = [int(kind) for kind in np.unique(block.kind)]
    shares = {}
    for a in kinds:
        rows = block.A[:, block.kind == a]
        shares[a] = inverse @ (np.swapaxes(rows, 1, 2) @ rows)
        found[a, a] = weight @ (block.present[:, block.kind == a].sum(axis=1) - 2 * np.einsum("nii->n", shares[a]))
    for a in kinds:
        for b in kinds:
            found[a, b] += np.einsum("n,nij,nji->", weight, shares[a], shares[b])
    return found


def _exchanged(block: _Block, inverse: Array, U: Array) -> dict[tuple[int, int], Array]:
    """(C, C) for each two kinds a < b: sum of VaT inv(G) Vb, with Va = AaT Ua."""
    kinds = [int(kind) for kind in np.unique(block.kind)]
    V = {a: np.swapaxes(block.A[:, block.kind == a], 1, 2) @ U[:, block.kind == a, :-1] for a in kinds}
    found = {}
    for a in kinds[:-1]:
        W = inverse @ V[a]
        found |= {(a, b): np.tensordot(W, V[b], axes=((0, 1), (0, 1))) for b in kinds if b > a}
    return found
