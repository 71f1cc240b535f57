"""A closed form that needs no protocol: no labels, no sweeps, no initial guess.

1. ``nT R_i a + sin(epsilon) = 0`` is linear in the nine entries of n aT and in sin(epsilon). With
   v_i = [vec(R_i), 1] the smallest eigenvector of M = sum v_i v_iT, rounded to rank one, gives both
   axes. Where the motion is too small to separate that eigenvector, its neighbours are tried as
   well, and each start is refined on the rank-one problem, which needs M only.
2. With y_i the part of R_i a perpendicular to n, normalised, and z_i = n x y_i,
   ``p_i = c + R z_i - R_i t`` is linear in c, R and t.

docs/estimation.md derives both steps.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from solvers.estimate import Estimate
from solvers.problem import ANGULAR, ORBITAL, Problem
from solvers.se3 import Array, orthonormal_complement, skew
from solvers.torus import Axes

SAME_AXIS = 0.99
"""Cosine above which two candidates have the same axis."""
RIVAL = 2.0
"""A candidate of less than this times the best one's energy explains the poses as well."""

BLOCK = 1024
"""Poses whose moments are taken at a time."""
LEAST_GAIN = 1e-8
"""A step that changes the energy by a smaller part of it ends the refinement."""


@dataclass(frozen=True)
class Options:
    """Options of the closed form."""

    fix_non_orthogonality: bool = True
    """Take the axes as perpendicular (the paper's model) instead of estimating epsilon."""
    starts: int = field(default=4, metadata={"min": 1, "max": 9})
    """How many of the smallest eigenvectors are refined; the best is kept."""
    reject_outliers: bool = True
    """Leave out the poses that do not agree with one C-arm."""
    seed: int = 0
    """Seed of the samples from which the agreeing poses are found."""


def solve(problem: Problem, options: Options = Options()) -> Estimate:
    """The chain from poses alone. Needs orientations; raises ValueError without them."""
    from solvers import robust  # which is built on this module

    used = robust.inliers(problem, options.seed) if options.reject_outliers else np.ones(len(problem), dtype=bool)
    agreeing = problem if used.all() else problem.select(used)
    return Estimate.of_torus("closed_form", axes_of(agreeing, options).torus(agreeing), used=used)


def axes_of(problem: Problem, options: Options = Options()) -> Axes:
    """The two axes, the offset and the radius, before any zero is given to the angles."""
    P = problem.placements
    M = _moments(problem)
    n, a, s = _best(problem, M, *_directions(M, options))
    if P > 1:
        n, s = _consistent_signs(problem, n, a, s)
        s = 0.0 if options.fix_non_orthogonality else s
        n, a, s = (x[0] for x in refine_axes(M, n[None], a[None], np.atleast_1d(s), options.fix_non_orthogonality))
    return _with_locus(problem, n, a, float(s))


def refit(problem: Problem, axes: Axes) -> Axes:
    """The axes that a few steps from ``axes`` reach, epsilon free, for poses of one placement."""
    M = _moments(problem)
    sine = np.sin([axes.non_orthogonality])
    n, a, s = refine_axes(M, axes.angular_axis[None], axes.orbital_axis[None], sine, fixed=False, steps=4)
    return _with_locus(problem, n[0], a[0], float(s[0]))


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


def _blocks(problem: Problem, placement: int) -> Iterator[tuple[Array, Array]]:
    """vec(R_i) (n, 9) and p_i (n, 3) of the poses of a placement, in blocks that stay in the processor's cache."""
    R, p = problem.rotations.reshape(-1, 9), problem.p_world_sensor
    poses = None if problem.placements == 1 else np.flatnonzero(problem.placement == placement)
    n = len(problem) if poses is None else len(poses)
    for start in range(0, n, BLOCK):
        here = slice(start, start + BLOCK) if poses is None else poses[start : start + BLOCK]
        yield R[here], p[here]


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


def _directions(M: Array, options: Options) -> tuple[Array, Array, Array]:
    """Candidates n (B, P, 3), a (B, 3), sin(epsilon) (B,) from the moments: linear starts, rank-one refinement."""
    size = 9 if options.fix_non_orthogonality else 10
    P = len(M)
    _, vectors = np.linalg.eigh(M[:, :size, :size])
    W = np.swapaxes(vectors[:, :, : options.starts], 1, 2)[..., :9].reshape(P * options.starts, 3, 3)
    a = np.linalg.svd(W)[2][:, 0, :]
    n = np.stack([_best_normal(M, p, a) for p in range(P)], axis=1)
    return refine_axes(M, n, a, np.zeros(len(a)), options.fix_non_orthogonality)


def ambiguous(problem: Problem, options: Options = Options()) -> bool:
    """Whether two different pairs of axes explain the orientations almost equally well, and no label chooses.

    One orbital and one angular sweep are also those of a machine with its axes exchanged.
    """
    M = _moments(problem)
    n, a, s = _directions(M, options)
    energy = axes_energy(M, n, a, s) + _unrest(problem, n, a)
    best = int(np.argmin(energy))
    other = np.minimum(np.abs(a @ a[best]), np.abs(n[:, 0] @ n[best, 0])) < SAME_AXIS
    return bool((energy[other] < RIVAL * energy[best] + len(problem) * 1e-12).any())


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


def _best_normal(M: Array, p: int, a: Array) -> Array:
    """For each candidate a (B, 3), the n (B, 3) that minimises sum (nT R_i a)^2 in placement p."""
    A = np.einsum("ajbk,mj,mk->mab", M[p, :9, :9].reshape(3, 3, 3, 3), a, a)
    return np.linalg.eigh(A)[1][:, :, 0]


def _stacked(n: Array, a: Array, s: Array) -> Array:
    """k (B, P, 10) with kT v_i = nT R_i a + s."""
    outer = n[:, :, :, None] * a[:, None, None, :]
    return np.concatenate([outer.reshape(*n.shape[:2], 9), np.broadcast_to(s[:, None, None], (*n.shape[:2], 1))], -1)


def axes_energy(M: Array, n: Array, a: Array, s: Array) -> Array:
    """sum (nT R_i a + s)^2 (B,) from the moments M (P, 10, 10), or (B, P, 10, 10) of B sets of poses."""
    k = _stacked(n, a, s)
    return (k * (M @ k[..., None])[..., 0]).sum(axis=(1, 2))


def refine_axes(M: Array, n: Array, a: Array, s: Array, fixed: bool, steps: int = 8) -> tuple[Array, Array, Array]:
    """Damped Gauss-Newton on `axes_energy` over unit n (B, P, 3), unit a (B, 3) and s (B,).

    Its cost does not depend on the number of poses; B starts, or B sets of poses, advance together.
    """
    B, P = n.shape[:2]
    damping = np.full(B, 1e-3)
    cost = axes_energy(M, n, a, s)
    for _ in range(steps):
        J, Bn, Ba = _jacobian(n, a, fixed)
        k = _stacked(n, a, s)
        MJ = M @ J
        H = (np.swapaxes(J, 2, 3) @ MJ).sum(axis=1)
        g = np.einsum("bpix,bpi->bx", MJ, k)
        scale = np.einsum("bxx->bx", H) + 1e-12 * M[..., 9, 9].sum(axis=-1)[..., None]
        step = -np.linalg.solve(H + damping[:, None, None] * (scale[:, :, None] * np.eye(len(H[0]))), g[..., None])
        dn, da = step[:, : 2 * P, 0].reshape(B, P, 2), step[:, 2 * P : 2 * P + 2, 0]
        n_new = _unit(n + np.einsum("bpij,bpj->bpi", Bn, dn))
        a_new = _unit(a + np.einsum("bij,bj->bi", Ba, da))
        s_new = s if fixed else s + step[:, -1, 0]
        cost_new = axes_energy(M, n_new, a_new, s_new)
        better = cost_new <= cost
        settled = (np.abs(step).max(axis=(1, 2)) < 1e-10) | (np.abs(cost - cost_new) <= LEAST_GAIN * cost)
        n, a = np.where(better[:, None, None], n_new, n), np.where(better[:, None], a_new, a)
        s, cost = np.where(better, s_new, s), np.where(better, cost_new, cost)
        damping = np.where(better, damping * 0.03, damping * 30)
        if settled.all():
            break
    return n, a, s


def _jacobian(n: Array, a: Array, fixed: bool) -> tuple[Array, Array, Array]:
    """dk/d(n_1 .. n_P, a, s) (B, P, 10, 2P + 2 or 3) in the tangent bases Bn and Ba, which it returns."""
    B, P = n.shape[:2]
    Bn, Ba = orthonormal_complement(n), orthonormal_complement(a)
    J = np.zeros((B, P, 10, 2 * P + (2 if fixed else 3)))
    dn = np.einsum("bpix,bj->bpijx", Bn, a).reshape(B, P, 9, 2)
    for p in range(P):
        J[:, p, :9, 2 * p : 2 * p + 2] = dn[:, p]
    J[:, :, :9, 2 * P : 2 * P + 2] = np.einsum("bpi,bjx->bpijx", n, Ba).reshape(B, P, 9, 2)
    if not fixed:
        J[:, :, 9, -1] = 1
    return J, Bn, Ba


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _consistent_signs(problem: Problem, n: Array, a: Array, s: float) -> tuple[Array, float]:
    """Directions of n with which every placement has the same sign of R and of sin(epsilon).

    R and, times the length of the offset, sin(epsilon) vote together, since either may be zero.
    """
    _, radius, offset = _locus(problem, n, a, shared_radius=False)
    y = np.einsum("nij,j->ni", problem.rotations, a)
    skewness = np.array(
        [-(y[problem.placement == p] @ n[p]).mean() * np.linalg.norm(offset) for p in range(problem.placements)]
    )
    flip = np.where(radius * radius[0] + skewness * skewness[0] < 0, -1.0, 1.0)
    return n * flip[:, None], float((skewness * flip).mean() / np.linalg.norm(offset))


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
        w = np.concatenate([R, _unit(R @ across), p], axis=1)
        about = w.mean(axis=0) if about is None else about
        w -= about
        total += w.sum(axis=0)
        S += w.T @ w
        count += len(R)
    mean = total / max(count, 1)
    return (0.0 if about is None else about) + mean, S - count * np.outer(mean, mean)
