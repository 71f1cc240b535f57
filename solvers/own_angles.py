"""The rows of single poses and the blocks of their own angles. Arrays run over poses in their last axis."""

import numpy as np

from solvers.likelihood import LOCAL, AngleModel, Linearisation
from solvers.reduced import HELD, RESIDUAL, WIDTH
from solvers.se3 import Array


def weighted(line: Linearisation, model: AngleModel, sigma: tuple[float, ...]) -> tuple[Array, Array]:
    """B (rows, 16, n) and A (rows, 2, n), scaled by the noise; A is zero where an angle is not free."""
    scale = np.repeat(1 / np.asarray(sigma), 3)[:, None]
    if model.scale is not None:
        scale = scale / np.repeat(model.scale[: len(sigma)], 3, axis=0)
    n = line.residual.shape[1]
    B = np.empty((len(scale), WIDTH, n))
    np.multiply(line.by_local, scale[:, None], out=B[:, :LOCAL])
    A = line.by_angle * scale[:, None]
    held = model.sweep >= 0
    B[:, HELD] = np.where(held, A[:, model.sweep_joint, np.arange(n)], 0.0) if held.any() else 0.0
    B[:, RESIDUAL] = line.residual * scale
    return B, A * model.free


def blocks_of(A: Array) -> Array:
    """ATA of every pose from its rows A (rows, 2, N), as its entries 00, 01 and 11 (3, N)."""
    return np.stack([(A[:, 0] ** 2).sum(axis=0), (A[:, 0] * A[:, 1]).sum(axis=0), (A[:, 1] ** 2).sum(axis=0)])


def inverse_blocks(G: Array, model: AngleModel) -> Array:
    """inv(G + readings), entries 00, 01 and 11 (3, N) as those of G; the rows of angles that are not free are those
    of the identity. A ridge of 1e-12 keeps rounding small where both angles of a pose move the sensor alike."""
    a, d = G[[0, 2]] + model.precision + ~model.free
    b = G[1]
    ridge = 1e-12 * (a + d) + np.finfo(float).tiny
    a, d = a + ridge, d + ridge
    return np.stack([d, -b, a]) / (a * d - b * b)


def traces(G_inverse: Array, position: Array, rotation: Array) -> tuple[float, float]:
    """Sums over the poses of tr inv(G) P and tr inv(G) P inv(G) R, with P and R the blocks (3, N) of both kinds."""

    def product(block: Array) -> tuple[Array, ...]:
        (g, h, k), (a, b, d) = G_inverse, block
        return g * a + h * b, g * b + h * d, h * a + k * b, h * b + k * d

    p, r = product(position), product(rotation)
    exchanged = p[0] * r[0] + p[1] * r[2] + p[2] * r[1] + p[3] * r[3]
    return float((p[0] + p[3]).sum()), float(exchanged.sum())
