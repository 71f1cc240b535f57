"""What the motion tells: directions of the unknowns that noise, wobble and sag cannot fake.

docs/estimation.md, "What is told", derives the bounds.
"""

from dataclasses import dataclass

import numpy as np

from solvers.problem import Problem
from solvers.se3 import Array, log_so3

MIN_ARC_RAD = float(np.radians(5.0))
"""A rotation through less is wobble or sag, whatever the noise."""
NOISE_MULTIPLE = 10.0
"""A rotation through fewer standard deviations of one orientation is noise."""
FLOOR_RAD = float(np.radians(0.05))
"""Orientation noise where nothing tells it."""
MOST_NOISE_RAD = MIN_ARC_RAD / NOISE_MULTIPLE
"""Differences of neighbouring poses above this are motion: the poses are no stream."""
LEAST_FRAMES = 30
"""Fewer neighbouring frames do not tell the noise."""
DIFFERENCE = (-1.0, 3.0, -3.0, 1.0)
"""Third differences: a hand's motion at 60 Hz leaves a hundredth of a degree of them."""
MEDIAN_TO_SIGMA = 1.4826
FROM_FRAMES, FROM_FLOOR = 0.25, 1.0
"""Standard deviation, relative to the squared noise, of one that frames or nothing but the floor tells."""


@dataclass(frozen=True)
class TurnNoise:
    """Orientation noise an axis that does not depend on any fit."""

    sigma: float
    """rad."""
    sigma_of_square: float
    """Standard deviation of ``sigma`` squared, rad^2; 0 where the noise is given."""


@dataclass(frozen=True, eq=False)
class Turned:
    """How far the sensor turned across each of three directions of its frame."""

    directions: Array
    """(3, 3) orthonormal, a row each, fixed in the sensor; the one across which it turned least stands last."""
    spread: Array
    """(3,) mean square length of (R_i - mean R) d of a unit vector d, the noise taken off, rad^2."""
    told: np.ndarray
    """(3,) whether the sensor turned by `least_arc` across it."""


def turn_noise(problem: Problem) -> TurnNoise:
    """The given noise, that of the third differences of neighbouring frames of a stream, or the floor."""
    return noise_of_turns(problem.rotations, problem.placement, problem.sigma_r)


def noise_of_turns(R: Array, stretch: np.ndarray, sigma_r: float | None) -> TurnNoise:
    """`turn_noise` of orientations R (N, 3, 3) in stretches of time (numbers (N,)), with the given noise or None."""
    if sigma_r is not None:
        return TurnNoise(sigma_r, 0.0)
    found = _noise_of_frames(_steps_of(R), stretch)
    if found is None or found > MOST_NOISE_RAD:
        return TurnNoise(FLOOR_RAD, FROM_FLOOR * FLOOR_RAD**2)
    return TurnNoise(found, FROM_FRAMES * found**2)


def noise_of_readings(q: Array, stretch: np.ndarray, sigma: float | None) -> float:
    """Noise, rad, of an angle (N,) that is read at every pose, as `noise_of_turns` has it; NaN are no readings."""
    if sigma is not None:
        return sigma
    found = _noise_of_frames(np.diff(q)[:, None], stretch)
    return FLOOR_RAD if found is None or found > MOST_NOISE_RAD else found


def least_arc(sigma_r: float, min_arc: float = MIN_ARC_RAD, multiple: float = NOISE_MULTIPLE) -> float:
    """The arc, rad, by which a rotation must be swept to be told, with the orientation noise ``sigma_r``, rad."""
    return max(min_arc, multiple * sigma_r)


def turned(problem: Problem, sigma_r: float) -> Turned:
    """What the orientations of the poses tell, with the noise ``sigma_r``, rad.

    The eigenvectors of S = mean (R_i - Rbar)^T (R_i - Rbar), Rbar the mean of each placement. The noise contributes
    2 sigma_r^2 to each eigenvalue, a uniform sweep through the arc A adds A^2 / 12 across its axis.
    """
    values, vectors = np.linalg.eigh(scatter(problem))
    spread = np.maximum(values[::-1] - 2 * sigma_r**2, 0.0)
    return Turned(vectors.T[::-1], spread, spread >= least_arc(sigma_r) ** 2 / 12)


def basis(seen: Turned) -> Array:
    """(K, 3) orthonormal told directions: the sensor's axes where all are told, else as near to them as can be."""
    told = seen.directions[seen.told]
    if len(told) == 3:
        return np.eye(3)
    across = told.T @ told
    axes = np.sort(np.argsort(-np.diagonal(across), kind="stable")[: len(told)])
    U, _, Vt = np.linalg.svd(across[axes], full_matrices=False)
    return U @ Vt


def scatter(problem: Problem) -> Array:
    """S (3, 3) of `turned`, rad^2."""
    R = problem.rotations
    total = np.zeros((3, 3))
    for k in np.unique(problem.placement):
        here = R[problem.placement == k]
        mean = here.mean(axis=0)
        total += len(here) * (np.eye(3) - mean.T @ mean)
    return total / len(R)


def _steps_of(R: Array) -> Array:
    """(N - 1, 3) rotation vectors from each orientation to the next."""
    return log_so3(np.swapaxes(R[:-1], 1, 2) @ R[1:])


def _noise_of_frames(step: Array, stretch: np.ndarray) -> float | None:
    """Robust standard deviation of what steps by ``step`` (N - 1, K), by its third differences within each stretch
    (N,); None for too few frames."""
    third = step[2:] - 2 * step[1:-1] + step[:-2]
    third = third[(stretch[3:] == stretch[:-3]) & np.isfinite(third).all(axis=1)]
    if len(third) < LEAST_FRAMES:
        return None
    return float(MEDIAN_TO_SIGMA * np.median(np.abs(third)) / np.linalg.norm(DIFFERENCE))
