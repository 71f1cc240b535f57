"""The directions of both axes from the orientations' moments: the rank-one problem.

``nT R_i a + sin(epsilon) = 0`` at every pose is ``kT v_i = 0`` with k = [vec(n aT), sin(epsilon)] and
v_i = [vec(R_i), 1]. Everything here needs M = sum v_i v_iT only, so its cost does not depend on the
number of poses; starts, or sets of poses, advance together in a batch. docs/estimation.md, 7.
"""

import numpy as np

from solvers.se3 import Array, orthonormal_complement

LEAST_GAIN = 1e-8
"""A step that changes the energy by a smaller part of it ends the refinement."""


def directions(M: Array, fixed: bool, starts: int) -> tuple[Array, Array, Array]:
    """Candidates n (B, P, 3), a (B, 3), sin(epsilon) (B,) from M (P, 10, 10): linear starts, refined.

    ``fixed`` takes epsilon as 0; ``starts`` is how many of the smallest eigenvectors of each placement are refined.
    """
    size = 9 if fixed else 10
    P = len(M)
    _, vectors = np.linalg.eigh(M[:, :size, :size])
    W = np.swapaxes(vectors[:, :, :starts], 1, 2)[..., :9].reshape(P * starts, 3, 3)
    a = np.linalg.svd(W)[2][:, 0, :]
    n = np.stack([_best_normal(M, p, a) for p in range(P)], axis=1)
    return refine_axes(M, n, a, np.zeros(len(a)), fixed)


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
        n_new = unit(n + np.einsum("bpij,bpj->bpi", Bn, dn))
        a_new = unit(a + np.einsum("bij,bj->bi", Ba, da))
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


def unit(v: Array) -> Array:
    """``v`` (..., K) by its length; zeros stay zeros."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), np.finfo(float).tiny)
