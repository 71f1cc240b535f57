"""Batches of small fits and the consensus among them; nothing loops over poses or hypotheses."""

from collections.abc import Callable

import numpy as np

from solvers.se3 import Array

SCALE_FLOOR_M = 1e-7
"""Least robust standard deviation assumed, m, so that noise-free data keep all their poses."""


def fit_circles(p: Array) -> tuple[Array, Array, Array]:
    """Plane and circle through points ``p`` (..., k, 3), m: centre (..., 3), unit normal (..., 3), radius.

    Total least squares for the plane, then Kasa's algebraic circle in its principal axes, where the
    normal equations are diagonal.
    """
    mean = p.mean(axis=-2)
    q = p - mean[..., None, :]
    values, vectors = np.linalg.eigh(np.swapaxes(q, -1, -2) @ q)
    in_plane = vectors[..., 1:]
    uv = q @ in_plane
    square = (uv**2).sum(axis=-1)
    shift = 0.5 * np.einsum("...ki,...k->...i", uv, square) / np.maximum(values[..., 1:], 1e-18)
    radius = np.sqrt((shift**2).sum(axis=-1) + square.mean(axis=-1))
    return mean + np.einsum("...ij,...j->...i", in_plane, shift), vectors[..., 0], radius


def circle_distance(p: Array, center: Array, normal: Array, radius: Array) -> Array:
    """Distance, m, of points (M, 3) from circles (H, 3), (H, 3), (H,) -> (H, M)."""
    q = p - center[:, None, :]
    height = np.einsum("hmi,hi->hm", q, normal)
    in_plane = np.sqrt(np.maximum((q**2).sum(axis=-1) - height**2, 0.0))
    return np.hypot(height, in_plane - radius[:, None])


def best_circles(p: Array, rng: np.random.Generator, hypotheses: int = 64) -> np.ndarray:
    """Inlier mask (M,) of the circle through three of the points (M, 3) with the least median distance.

    The best circle is fitted again to its nearer half before the scale is taken.
    """
    sample = rng.integers(len(p), size=(hypotheses, 3))
    distance = circle_distance(p, *fit_circles(p[sample]))
    best = distance[np.argmin(np.median(distance, axis=1))]
    for share in (0.5, 0.6):
        near = np.argsort(best)[: max(3, int(np.ceil(share * len(p))))]
        best = circle_distance(p, *(x[None] for x in fit_circles(p[near])))[0]
    return best <= 3.5 * max(np.median(best) / 1.1774, SCALE_FLOOR_M)


def consensus(
    distance: Callable[[slice | int, np.ndarray], Array],
    hypotheses: int,
    poses: np.ndarray,
    inlier_width_m: float | None,
    rng: np.random.Generator,
    scored: int = 600,
) -> np.ndarray:
    """The members of ``poses`` that agree with the best of many hypotheses.

    ``distance(h, i)`` gives the distances (m) of poses i from the surfaces of hypotheses h. Hypotheses
    are ranked on a random part of the poses: by the number within the band where its full width is
    given, else by their median distance, which also sets the scale.
    """
    part = poses[rng.permutation(len(poses))[:scored]]
    d = distance(slice(0, hypotheses), part)
    if inlier_width_m is None:
        score = np.median(d, axis=1)
    else:
        score = -(d <= inlier_width_m / 2).sum(axis=1)
    best = distance(slice(int(np.argmin(score)), int(np.argmin(score)) + 1), poses)[0]
    half_width = inlier_width_m / 2 if inlier_width_m else 3 * max(1.4826 * float(np.median(best)), SCALE_FLOOR_M)
    return poses[best <= half_width]
