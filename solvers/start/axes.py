"""Both axes, the offset and the radius from poses alone: two problems that need moments of the poses only.

1. The directions of the axes (`solvers.start.rank_one`).
2. With y_i the part of R_i a perpendicular to n, normalised, and z_i = n x y_i,
   ``p_i = c + R z_i - R_i t`` is linear in c, R and t.

docs/estimation.md, 7, derives both.
"""

from collections.abc import Iterator

import numpy as np

from solvers.problem import ANGULAR, ORBITAL, Problem
from solvers.se3 import Array, skew
from solvers.start.rank_one import axes_energy, directions, refine_axes, unit
from solvers.torus import Axes

STARTS = 4
"""How many of the smallest eigenvectors are refined; the best is kept."""
SAME_AXIS = 0.99
"""Cosine above which two candidates have the same axis."""
RIVAL = 2.0
"""A candidate of less than this times the best one's energy explains the poses as well."""
BLOCK = 1024
"""Poses whose moments are taken at a time."""


def axes_of(problem: Problem, fix_non_orthogonality: bool = True, starts: int = STARTS) -> Axes:
    """The two axes, the offset and the radius, before any zero is given to the angles. Needs orientations."""
    P = problem.placements
    M = _moments(problem)
    n, a, s = _best(problem, M, *directions(M, fix_non_orthogonality, starts))
    if P > 1:
        n, s = _consistent_signs(problem, n, a, s)
        s = 0.0 if fix_non_orthogonality else s
        n, a, s = (x[0] for x in refine_axes(M, n[None], a[None], np.atleast_1d(s), fix_non_orthogonality))
    return _with_locus(problem, n, a, float(s))


def refit(problem: Problem, axes: Axes) -> Axes:
    """The axes that a few steps from ``axes`` reach, epsilon free, for poses of one placement."""
    M = _moments(problem)
    sine = np.sin([axes.non_orthogonality])
    n, a, s = refine_axes(M, axes.angular_axis[None], axes.orbital_axis[None], sine, fixed=False, steps=4)
    return _with_locus(problem, n[0], a[0], float(s[0]))


def ambiguous(problem: Problem) -> bool:
    """Whether two different pairs of axes explain the orientations almost equally well, and no label chooses.

    One orbital and one angular sweep are also those of a machine with its axes exchanged.
    """
    M = _moments(problem)
    n, a, s = directions(M, fixed=True, starts=STARTS)
    energy = axes_energy(M, n, a, s) + _unrest(problem, n, a)
    best = int(np.argmin(energy))
    other = np.minimum(np.abs(a @ a[best]), np.abs(n[:, 0] @ n[best, 0])) < SAME_AXIS
    return bool((energy[other] < RIVAL * energy[best] + len(problem) * 1e-12).any())


def _with_locus(problem: Problem, n: Array, a: Array, s: float) -> Axes:
    center, radius, offset = _locus(problem, n, a, shared_radius=True)
    return Axes(center, n, float(radius[0]), float(np.arcsin(np.clip(s, -1, 1))), offset, a)


def _best(problem: Problem, M: Array, n: Array, a: Array, s: Array) -> tuple[Array, Array, float]:
    """The candidate of least energy, its unrest in sweeps included; it is computed where it can decide."""
    energy = axes_energy(M, n, a, s)
    first = int(np.argmin(energy))
    bound = energy[first] + _unrest(problem, n[[first]], a[[first]])[0]
    rivals = np.flatnonzero(energy <= bound)
    best = rivals[np.argmin(energy[rivals] + _unrest(problem, n[rivals], a[rivals]))] if len(rivals) > 1 else first
    return n[best], a[best], float(s[best])


def _unrest(problem: Problem, n: Array, a: Array) -> Array:
    """(B,) by how much the axes of each candidate turn in sweeps that hold them still: the scatter of R_i a
    in orbital sweeps and of R_iT n in angular ones."""
    total = np.zeros(len(a))
    for joint in (ANGULAR, ORBITAL):
        poses = np.flatnonzero((problem.held[:, joint] >= 0) & (problem.held[:, 1 - joint] < 0))
        R, sweep = problem.rotations[poses], problem.held[poses, joint]
        for b in range(len(a)):
            turned = R @ a[b] if joint == ANGULAR else np.einsum("nij,ni->nj", R, n[b][problem.placement[poses]])
            mean = np.stack([np.bincount(sweep, turned[:, k]) for k in range(3)]) / np.maximum(np.bincount(sweep), 1)
            total[b] += ((turned - mean.T[sweep]) ** 2).sum()
    return total


def _consistent_signs(problem: Problem, n: Array, a: Array, s: float) -> tuple[Array, float]:
    """Directions of n with which every placement has the same sign of R and of sin(epsilon).

    R and, times the length of the offset, sin(epsilon) vote together, since either may be zero.
    """
    _, radius, offset = _locus(problem, n, a, shared_radius=False)
    y = np.einsum("nij,j->ni", problem.rotations, a)
    sine = np.array([-(y[problem.placement == p] @ n[p]).mean() for p in range(problem.placements)])
    flip = np.where(radius * radius[0] + (offset @ offset) * sine * sine[0] < 0, -1.0, 1.0)
    return n * flip[:, None], float((sine * flip).mean())


def _locus(problem: Problem, n: Array, a: Array, shared_radius: bool) -> tuple[Array, Array, Array]:
    """Least squares of ``p_i = c_p + R z_i - R_i t`` for n (P, 3) and a (3,): c (P, 3), R (1,) or (P,), t (3,).

    It needs the second moments of [vec(R_i), z_i, p_i] only. The centres are eliminated by centring each
    placement, which also keeps full precision far from the world's origin.
    """
    P = problem.placements
    K = 1 if shared_radius else P
    H, g, m = np.zeros((3 + K, 3 + K)), np.zeros(3 + K), np.empty((P, 15))
    for k in range(P):
        m[k], S = _locus_moments(problem, k, n[k], a)
        column = 3 + (0 if shared_radius else k)
        on_z, on_p = (np.einsum("rjr->j", S[:9, part].reshape(3, 3, 3)) for part in (slice(9, 12), slice(12, 15)))
        H[:3, :3] += np.einsum("rjrk->jk", S[:9, :9].reshape(3, 3, 3, 3))
        H[:3, column] -= on_z
        H[column, :3] -= on_z
        H[column, column] += np.trace(S[9:12, 9:12])
        g[:3] -= on_p
        g[column] += np.trace(S[9:12, 12:])
    x = np.asarray(np.linalg.lstsq(H, g, rcond=1e-15)[0], dtype=float)
    t, radius = x[:3], x[3:]
    center = m[:, 12:] + m[:, :9].reshape(-1, 3, 3) @ t - radius[:, None] * m[:, 9:12]
    return center, radius, t


def _locus_moments(problem: Problem, placement: int, n: Array, a: Array) -> tuple[Array, Array]:
    """Mean (15,) and scatter about it (15, 15) of [vec(R_i), z_i, p_i], with z_i along n x R_i a from the torus
    centre to the pivot. Summed about the first block's mean."""
    across = np.kron(skew(n), a).T
    total, S, count, about = np.zeros(15), np.zeros((15, 15)), 0, None
    for R, p in _blocks(problem, placement):
        w = np.concatenate([R, unit(R @ across), p], axis=1)
        about = w.mean(axis=0) if about is None else about
        w -= about
        total += w.sum(axis=0)
        S += w.T @ w
        count += len(R)
    mean = total / max(count, 1)
    return (0.0 if about is None else about) + mean, S - count * np.outer(mean, mean)


def _moments(problem: Problem) -> Array:
    """M (P, 10, 10): the sum of v vT over the poses of each placement."""
    M = np.zeros((problem.placements, 10, 10))
    for k in range(problem.placements):
        for R, _ in _blocks(problem, k):
            M[k, :9, :9] += R.T @ R
            M[k, :9, 9] += R.sum(axis=0)
            M[k, 9, 9] += len(R)
        M[k, 9, :9] = M[k, :9, 9]
    return M


def _blocks(problem: Problem, placement: int) -> Iterator[tuple[Array, Array]]:
    """vec(R_i) (n, 9) and p_i (n, 3) of the poses of a placement, in blocks that stay in the processor's cache."""
    R, p = problem.rotations.reshape(-1, 9), problem.p_world_sensor
    poses = None if problem.placements == 1 else np.flatnonzero(problem.placement == placement)
    n = len(problem) if poses is None else len(poses)
    for start in range(0, n, BLOCK):
        here = slice(start, start + BLOCK) if poses is None else poses[start : start + BLOCK]
        yield R[here], p[here]
