"""What disturbs a simulated recording: noise of the poses and of the joints' readings, outliers, missing frames."""

from dataclasses import dataclass

import numpy as np

from carm_kin.errors import InputError
from solvers.se3 import Array, exp_so3, rotation_from_quat_wxyz

OUTLIER_M = (0.05, 0.5)
"""A gross outlier lies off by a distance between these and has a random orientation."""
MAX_RATIO = 100.0
"""Greatest ratio of the noise along two axes."""
MAX_SIGMA_M = 10.0
"""Larger noise is taken for a wrong unit."""


@dataclass(frozen=True)
class Noise:
    """What disturbs the poses."""

    sigma_t_m: float = 0.0
    """Position noise, one standard deviation an axis."""
    sigma_r_rad: float = 0.0
    """Orientation noise: a rotation vector in the sensor frame, one standard deviation an axis."""
    anisotropy: float = 1.0
    """Noise along the tracker's z axis, its line of sight, over that across it; turns about z are as much surer. The
    sigmas are then root mean squares over the axes."""
    correlation: float = 0.0
    """From frame to frame of a motion: the noise is a stationary process AR(1) with this coefficient and the sigmas."""
    outliers: float = 0.0
    """Share of poses that are replaced by gross outliers."""
    missing: float = 0.0
    """Share of frames in which the sensor is not seen."""
    sigma_reading_rad: float = 0.0
    """Error of the angles that the recording has: one draw a joint and value, so that a joint which is held
    has one error as long as it stands there."""
    sigma_reading_m: float = 0.0
    """The same for the positions of prismatic joints."""
    label_resolution_rad: float = 0.0
    """Step to which the recorded angles are rounded; 0 is exact."""


def checked(noise: Noise) -> Noise:
    """The same. Raises InputError that names the number which cannot be."""
    for name, share in (("outliers", noise.outliers), ("missing", noise.missing)):
        if not 0 <= share < 1:
            raise InputError(f"{name} must be a share of the poses, from 0 to below 1, not {share}")
    if not 0 <= noise.correlation < 1:
        raise InputError(f"correlation must be from 0 to below 1, not {noise.correlation}")
    for name, most in (
        ("sigma_t_m", MAX_SIGMA_M),
        ("sigma_r_rad", np.pi),
        ("sigma_reading_rad", np.pi),
        ("sigma_reading_m", MAX_SIGMA_M),
        ("label_resolution_rad", np.pi),
    ):
        if not 0 <= (sigma := getattr(noise, name)) <= most:
            raise InputError(f"{name} must be from 0 to {most:.3g}, not {sigma}")
    if not 1 / MAX_RATIO <= noise.anisotropy <= MAX_RATIO:
        raise InputError(f"anisotropy must be from {1 / MAX_RATIO:g} to {MAX_RATIO:g}, not {noise.anisotropy}")
    return noise


def disturbed(
    T: Array, noise: Noise, rng: np.random.Generator, part: np.ndarray | None = None
) -> tuple[Array, Array, np.ndarray]:
    """p (N, 3), R (N, 3, 3) of the poses T (N, 4, 4) with noise, and the mask (N,) of those that were replaced.

    ``part`` (N,) numbers the motions, between which noise is not correlated; None: they are one.
    """
    n = len(T)
    shift, turn = noise.sigma_t_m * rng.normal(size=(n, 3)), noise.sigma_r_rad * rng.normal(size=(n, 3))
    if noise.correlation:
        same = np.diff(np.zeros(n) if part is None else part, prepend=-1) == 0
        keep = np.where(same, noise.correlation, 0.0)
        shift, turn = (faded(np.sqrt(1 - keep**2)[:, None] * white, keep) for white in (shift, turn))
    if noise.anisotropy != 1:
        shift, turn = shift * _unit_rms(1, 1, noise.anisotropy), turn * _unit_rms(1, 1, 1 / noise.anisotropy)
        turn = np.einsum("nji,nj->ni", T[:, :3, :3], turn)
    p, R = T[:, :3, 3] + shift, T[:, :3, :3] @ exp_so3(turn)
    replaced = np.zeros(n, dtype=bool)
    replaced[rng.permutation(n)[: round(noise.outliers * n)]] = True
    k = int(replaced.sum())
    direction = rng.normal(size=(k, 3))
    p[replaced] += direction / np.linalg.norm(direction, axis=1, keepdims=True) * rng.uniform(*OUTLIER_M, size=(k, 1))
    R[replaced] = rotation_from_quat_wxyz(rng.normal(size=(k, 4)))
    return p, R, replaced


def faded(driven: Array, keep: Array) -> Array:
    """x (N, ...) with x_0 = driven_0, x_k = keep_k x_(k-1) + driven_k, of ``driven`` (N, ...) and ``keep`` (N,)."""
    x = driven.copy()
    for k in range(1, len(x)):
        x[k] += keep[k] * x[k - 1]
    return x


def _unit_rms(*axes: float) -> Array:
    return np.array(axes) / np.sqrt(np.mean(np.square(axes)))


def readings(values: Array, sigma: float, rng: np.random.Generator) -> Array:
    """Readings (N,) of a joint, whose error is the same wherever its value is the same."""
    distinct, number = np.unique(values, return_inverse=True)
    return (distinct + sigma * rng.normal(size=len(distinct)))[number.ravel()]


def rounded(values: Array, step: float) -> Array:
    """Values (N,) to the nearest multiple of ``step``, 0 for none."""
    return step * np.round(values / step) if step else values
