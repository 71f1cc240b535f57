"""A closed form that needs no protocol: no labels, no sweeps, no initial guess.

1. ``nT R_i a + sin(epsilon) = 0`` is linear in the nine entries of n aT and in sin(epsilon). With
   v_i = [vec(R_i), 1] the smallest eigenvector of M = sum v_i v_iT, rounded to rank one, gives both
   axes. Where the motion is too small to separate that eigenvector, its neighbours are tried as
   well, and each start is refined on the rank-one problem, which needs M only.
2. With y_i the part of R_i a perpendicular to n, normalised, and z_i = n x y_i,
   ``p_i = c + R z_i - R_i t`` is linear in c, R and t.

docs/estimation.md derives both steps.
"""

from dataclasses import dataclass, field

import numpy as np

from solvers.estimate import Estimate
from solvers.problem import ANGULAR, ORBITAL, Problem
from solvers.se3 import Array, orthonormal_complement
from solvers.torus import Axes

SAME_AXIS = 0.99
"""Cosine above which two candidates have the same axis."""
RIVAL = 2.0
"""A candidate of less than this times the best one's energy explains the poses as well."""


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
    R, placement, P = problem.rotations, problem.placement, problem.placements
    M = _moments(R, placement, P)
    candidates = _directions(M, options)
    best = np.argmin(axes_energy(M, *candidates) + _unrest(problem, *candidates[:2]))
    n, a, s = candidates[0][best], candidates[1][best], float(candidates[2][best])
    if P > 1:
        n, s = _consistent_signs(problem, n, a, s)
        s = 0.0 if options.fix_non_orthogonality else s
        n, a, s = (x[0] for x in refine_axes(M, n[None], a[None], np.atleast_1d(s), options.fix_non_orthogonality))
    z = _pivot_directions(R, n[placement], a)
    center, radius, offset = _locus(problem, z, shared_radius=True)
    return Axes(center, n, float(radius[0]), float(np.arcsin(np.clip(s, -1, 1))), offset, a)


def _moments(R: Array, placement: np.ndarray, P: int) -> Array:
    """M (P, 10, 10): the sum of v vT over the poses of each placement."""
    v = np.concatenate([R.reshape(-1, 9), np.ones((len(R), 1))], axis=1)
    return np.stack([v[placement == p].T @ v[placement == p] for p in range(P)]) if P > 1 else (v.T @ v)[None]


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
    M = _moments(problem.rotations, problem.placement, problem.placements)
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
        for poses in problem.sweeps(joint):
            R = problem.rotations[poses]
            fixed = n[:, problem.placement[poses[0]]]
            turned = np.einsum("nij,bj->bni", R, a) if joint == ANGULAR else np.einsum("nij,bi->bnj", R, fixed)
            total += ((turned - turned.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2))
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


def refine_axes(M: Array, n: Array, a: Array, s: Array, fixed: bool, steps: int = 12) -> tuple[Array, Array, Array]:
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
        n, a = np.where(better[:, None, None], n_new, n), np.where(better[:, None], a_new, a)
        s, cost = np.where(better, s_new, s), np.where(better, cost_new, cost)
        damping = np.where(better, damping * 0.03, damping * 30)
        if np.abs(step).max() < 1e-13:
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


def _pivot_directions(R: Array, n: Array, a: Array) -> Array:
    """z_i (N, 3): the direction from the torus centre to the pivot of each pose, with n (N, 3)."""
    z = np.cross(n, R @ a)
    return _unit(z)


def _consistent_signs(problem: Problem, n: Array, a: Array, s: float) -> tuple[Array, float]:
    """Directions of n with which every placement has the same sign of R and of sin(epsilon).

    R and, times the length of the offset, sin(epsilon) vote together, since either may be zero.
    """
    z = _pivot_directions(problem.rotations, n[problem.placement], a)
    _, radius, offset = _locus(problem, z, shared_radius=False)
    y = np.einsum("nij,j->ni", problem.rotations, a)
    skewness = np.array(
        [-(y[problem.placement == p] @ n[p]).mean() * np.linalg.norm(offset) for p in range(problem.placements)]
    )
    flip = np.where(radius * radius[0] + skewness * skewness[0] < 0, -1.0, 1.0)
    return n * flip[:, None], float((skewness * flip).mean() / np.linalg.norm(offset))


def _locus(problem: Problem, z: Array, shared_radius: bool) -> tuple[Array, Array, Array]:
    """Least squares of ``p_i = c_p + R z_i - R_i t``: c (P, 3), R (1,) or (P,), t (3,).

    The centres are eliminated by centring each placement, which also keeps full precision far from
    the world's origin.
    """
    p, R, P = problem.p_world_sensor, problem.rotations, problem.placements
    members = [slice(None)] if P == 1 else [np.flatnonzero(problem.placement == k) for k in range(P)]
    means = [(p[i].mean(0), R[i].mean(0), z[i].mean(0)) for i in members]
    K = 1 if shared_radius else P
    H, g = np.zeros((3 + K, 3 + K)), np.zeros(3 + K)
    for k, (i, (mp, mR, mz)) in enumerate(zip(members, means, strict=True)):
        column = 3 + (0 if shared_radius else k)
        A = np.concatenate([(mR - R[i]), (z[i] - mz)[:, :, None]], axis=2).reshape(-1, 4)
        index = np.array([0, 1, 2, column])
        H[np.ix_(index, index)] += A.T @ A
        g[index] += A.T @ (p[i] - mp).ravel()
    x = np.asarray(np.linalg.lstsq(H, g, rcond=1e-15)[0], dtype=float)
    t, radius = x[:3], x[3:]
    per_placement = np.broadcast_to(radius, (P,))
    center = np.stack([mp + mR @ t - r * mz for (mp, mR, mz), r in zip(means, per_placement, strict=True)])
    return center, radius, t
