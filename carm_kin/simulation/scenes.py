"""Random C-arms and recordings of them in solver terms, for studies: known truth, known noise, no URDF.

Geometries are those of the design: the torus pose uniform, R in 50 to 200 mm, the sensor in the carm
frame within 300 mm across and 600 to 800 mm along z, its orientation uniform. Metres and radians.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from carm_kin.simulation.noise import Noise, disturbed
from solvers.problem import Problem
from solvers.se3 import Array, inverse, rotation_from_quat_wxyz, transform
from solvers.torus import Torus


@dataclass(frozen=True, eq=False)
class Motion:
    """True angles of N poses and what the recording tells of them, as in `Problem`."""

    angles: Array
    held: np.ndarray
    label: Array
    placement: np.ndarray


def random_frame(rng: np.random.Generator, half_width_m: float = 1.0) -> Array:
    """(4, 4): a uniform rotation, a position in a cube."""
    return transform(rotation_from_quat_wxyz(rng.normal(size=4)), rng.uniform(-half_width_m, half_width_m, 3))


def random_torus(
    rng: np.random.Generator,
    major_radius: float | None = None,
    ring: bool = False,
    epsilon: float = 0.0,
    placements: int = 1,
) -> Torus:
    """A machine of the design's table; ``ring``: R is 1.1 to 1.5 times the minor radius."""
    T_world_torus = np.stack([random_frame(rng) for _ in range(placements)])
    T_carm_sensor = random_frame(rng, 0.0)
    T_carm_sensor[:3, 3] = [*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.6, 0.8)]
    R = rng.uniform(0.05, 0.2) if major_radius is None else major_radius
    if ring:
        R = rng.uniform(1.1, 1.5) * np.hypot(T_carm_sensor[0, 3], T_carm_sensor[2, 3])
    return Torus(T_world_torus, float(R), epsilon, inverse(T_carm_sensor), np.ones(placements, dtype=bool), True)


def sweeps_deg(
    alphas: Iterable[float],
    beta_path: Sequence[float] | Array,
    betas: Iterable[float],
    alpha_path: Sequence[float] | Array,
    placement: int = 0,
    first_sweep: int = 0,
) -> Motion:
    """An orbital sweep at each alpha, then an angular one at each beta, the held angle labelled; degrees."""
    angles, held, label = [], [], []
    for joint, values, path in ((0, alphas, beta_path), (1, betas, alpha_path)):
        for value in values:
            part = np.empty((len(path), 2))
            part[:, joint], part[:, 1 - joint] = np.radians(value), np.radians(path)
            number, known = np.full((len(path), 2), -1), np.full((len(path), 2), np.nan)
            number[:, joint], known[:, joint] = first_sweep + len(angles), np.radians(value)
            angles, held, label = [*angles, part], [*held, number], [*label, known]
    stacked = np.concatenate(angles)
    return Motion(stacked, np.concatenate(held), np.concatenate(label), np.full(len(stacked), placement))


def joined(first: Motion, second: Motion) -> Motion:
    """One motion after the other."""
    names = ("angles", "held", "label", "placement")
    return Motion(*(np.concatenate([getattr(first, name), getattr(second, name)]) for name in names))


def paper(alphas: Iterable[float] = range(-90, 91, 10), betas: Iterable[float] = range(0, 161, 20)) -> Motion:
    """The paper's protocol: full circles, a pose every degree; all sweeps are 10,080 poses."""
    return sweeps_deg(alphas, np.arange(360.0), betas, np.arange(360.0))


def observed(
    torus: Torus, motion: Motion, sigma_t: float, sigma_r: float, rng: np.random.Generator, outliers: float = 0.0
) -> tuple[Problem, np.ndarray]:
    """The recording with its noise, and the mask (N,) of the poses replaced by gross outliers."""
    T = torus.poses(motion.angles, motion.placement)
    p, R, gross = disturbed(T, Noise(sigma_t, sigma_r, outliers=outliers), rng)
    return Problem(p, R, motion.placement, motion.held, motion.label), gross


def signs(torus: Torus, truth: Torus) -> tuple[int, int]:
    """+1 or -1 for n and a: whether the estimate's axes point as the truth's; (n, a) and (-n, -a) are one machine."""
    n = np.sign(torus.angular_axis[0] @ truth.angular_axis[0])
    return int(n), int(np.sign(torus.orbital_axis @ truth.orbital_axis))
