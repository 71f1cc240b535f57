"""From the marginal information of the chain to the covariance of every reported quantity."""

import numpy as np

from solvers.estimate import Covariance
from solvers.likelihood.linearise import MOUNT_ROLL, TORUS_ROLL
from solvers.problem import Problem
from solvers.se3 import Array, skew
from solvers.torus import Torus

NORMAL_95 = 1.959963984540054
"""Half-width of a two-sided 95% interval in standard deviations."""
ONE_SIDED_95 = 1.6448536269514722
"""Where a one-sided 95% interval ends."""


def active_unknowns(problem: Problem, fix_non_orthogonality: bool) -> np.ndarray:
    """(D,) mask of the unknowns that the data can determine: not the zero of an angle that no label
    gives, and not epsilon where it is fixed."""
    placements = problem.placements
    alpha, beta = problem.zero_labelled
    active = np.ones(6 * placements + 8, dtype=bool)
    active[TORUS_ROLL : 6 * placements : 6] = alpha
    active[6 * placements + 1] = not fix_non_orthogonality
    active[6 * placements + 2 + MOUNT_ROLL] = beta
    return active


def marginal_covariance(H: Array, active: np.ndarray) -> Array:
    """inv(H) (D, D) over the active unknowns, zero elsewhere; by eigenvectors of the scaled matrix, so
    that a direction without information gets a large variance instead of an exception."""
    C = np.zeros_like(H)
    values, vectors, scale = scaled_spectrum(H, active)
    inverse = (vectors / np.maximum(values, 1e-15)) @ vectors.T
    C[np.ix_(active, active)] = inverse / np.outer(scale, scale)
    return C


def scaled_spectrum(H: Array, active: np.ndarray) -> tuple[Array, Array, Array]:
    """Eigenvalues and vectors of H over the active unknowns, each unknown scaled to unit information."""
    inner = H[np.ix_(active, active)]
    if not np.isfinite(inner).all():
        return np.zeros(len(inner)), np.eye(len(inner)), np.ones(len(inner))
    scale = np.sqrt(np.maximum(np.diagonal(inner), 1e-150))
    values, vectors = np.linalg.eigh(inner / np.outer(scale, scale))
    return values, vectors, scale


def covariance_of(torus: Torus, C: Array) -> Covariance:
    """Covariance of offset, axes, radii, epsilon and centres from that of the unknowns (D, D)."""
    J, names = reported_jacobian(torus)
    return Covariance(names, J @ C @ J.T)


def reported_jacobian(torus: Torus) -> tuple[Array, tuple[str, ...]]:
    """Derivative (K, D) of the reported quantities by the unknowns, and their names."""
    placements = len(torus.T_world_torus)
    split = 6 * placements
    R_sc = torus.T_sensor_carm[:3, :3]
    offset = np.zeros((3, split + 8))
    offset[:, split + 2 : split + 5] = R_sc
    orbital = np.zeros_like(offset)
    orbital[:, split + 5 :] = -R_sc @ skew([0.0, 1.0, 0.0])
    major, epsilon = np.eye(split + 8)[split : split + 2]
    lever = torus.offset - torus.orbital_axis * (torus.orbital_axis @ torus.offset)
    direction = lever / max(torus.minor_radius, np.finfo(float).tiny)
    minor = direction @ offset - (torus.orbital_axis @ torus.offset) * (direction @ orbital)
    rows, names = [offset, major, minor, epsilon, orbital], [*_xyz("offset_sensor_pivot")]
    names += ["major_radius", "minor_radius", "axis_non_orthogonality", *_xyz("orbital_axis_sensor")]
    for p in range(placements):
        R_wt = torus.T_world_torus[p, :3, :3]
        center, angular = np.zeros_like(offset), np.zeros_like(offset)
        center[:, 6 * p : 6 * p + 3] = R_wt
        angular[:, 6 * p + 3 : 6 * p + 6] = -R_wt @ skew([1.0, 0.0, 0.0])
        rows += [center, angular]
        names += [*_xyz(f"torus_center_world[{p}]"), *_xyz(f"angular_axis_world[{p}]")]
    return np.vstack(rows), tuple(names)


def interval_of_magnitude(value: float, sigma: float) -> tuple[float, float]:
    """The 95% interval of |x|, where ``value`` is a normal estimate of x with the standard deviation ``sigma``.

    The image under |.| of ``value`` ± 1.96 ``sigma``; where that contains 0 it begins at 0 and is one-sided.
    It holds the true |x| with a probability of 95% at x = 0 and from about 3 sigma on, of up to 97.5% between.
    """
    reach = NORMAL_95 * sigma
    return max(abs(value) - reach, 0.0), abs(value) + reach


def radius_95(C: Array) -> float:
    """The radius of the ball about an estimate that holds the truth with 95%, of its covariance C (3, 3).

    The squared error is taken as gamma-distributed with its own mean and variance (Satterthwaite), the quantile after
    Wilson and Hilferty: within 2% for any C.
    """
    values = np.maximum(np.linalg.eigvalsh(C), 0.0)
    mean, squares = float(values.sum()), float((values**2).sum())
    if mean == 0:
        return 0.0
    spread = 2 * squares / (9 * mean**2)
    return float(np.sqrt(mean * (1 - spread + ONE_SIDED_95 * np.sqrt(spread)) ** 3))


def _xyz(name: str) -> list[str]:
    return [f"{name}_{axis}" for axis in "xyz"]
