"""C-arms that bend by a known function of both angles, written out independently of the estimators."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from carm_kin.recording.recording import Recording
from carm_kin.results.deformation import Deformation, DeformationNode
from carm_kin.testing.truth import Machine, Motion, frame, machine, sweeps_deg

MACHINE = machine(3, 0.1, 0.01, world_m=1.5)
SIGMA_T, SIGMA_R = 1e-4, 5e-4
RANGE_DEG = 60
SAG_M = 2e-3


def sag_m(angles: np.ndarray) -> np.ndarray:
    """(N, 3) by which the sensor sinks, in the carm frame, at angles (N, 2)."""
    a, b = angles.T
    return SAG_M * np.stack([np.sin(a) * np.cos(b), np.sin(b), 1 - np.cos(a)], axis=1)


def shift_m(angles: np.ndarray) -> np.ndarray:
    """(N, 3) of the rotation centre in the sensor's frame, from its mean over the grid of `deformation`."""
    return -(sag_m(angles) - sag_m(_grid()).mean(axis=0)) @ MACHINE.T_sensor_carm[:3, :3].T


def mean_mount() -> np.ndarray:
    """(4, 4) the mount of the mean sag."""
    T = MACHINE.T_sensor_carm.copy()
    T[:3, 3] -= T[:3, :3] @ sag_m(_grid()).mean(axis=0)
    return T


def deformation(sigma_m: float = 1e-4) -> Deformation:
    """The sag as an exact calibration has it."""
    rows = zip(_grid(), shift_m(_grid()), strict=True)
    nodes = tuple(DeformationNode(a, b, shift, np.zeros(3), np.full(3, sigma_m)) for (a, b), shift in rows)
    ends = float(-np.radians(RANGE_DEG)), float(np.radians(RANGE_DEG))
    return Deformation(ends, ends, nodes)


def _grid() -> np.ndarray:
    x = np.radians(np.linspace(-RANGE_DEG, RANGE_DEG, 13))
    return np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)


def sweeps(alpha_deg: tuple[float, float] = (-60, 60), beta_deg: tuple[float, float] = (-60, 60)) -> Motion:
    """Five orbital and three angular sweeps over the ranges."""
    a, b = (np.linspace(*ends, 30) for ends in (alpha_deg, beta_deg))
    return sweeps_deg(np.linspace(*alpha_deg, 5), b, np.linspace(*beta_deg, 3), a)


def recorded(motion: Motion, seed: int, elsewhere: bool = False, labels: bool = True) -> Recording:
    """The poses of a motion, the base where it was or ``elsewhere``."""
    rng = np.random.default_rng([seed, 91])
    base = frame(rng, 1.5)[None] if elsewhere else MACHINE.T_world_torus
    p, R = replace(MACHINE, T_world_torus=base).poses(motion.angles)
    p = p + np.einsum("nij,nj->ni", R @ MACHINE.T_sensor_carm[:3, :3], sag_m(motion.angles))
    p = p + SIGMA_T * rng.normal(size=p.shape)
    R = R @ Rotation.from_rotvec(SIGMA_R * rng.normal(size=p.shape)).as_matrix()
    joint = (motion.held[:, 1] >= 0).astype(int)
    return Recording(
        p,
        R,
        sweep=motion.held.max(axis=1).astype(str).astype(object),
        moving=np.array(["orbital", "angular"], dtype=object)[joint],
        joints={"angular": motion.label[:, 0], "orbital": motion.label[:, 1]} if labels else {},
    )


__all__ = ["MACHINE", "Machine", "deformation", "mean_mount", "recorded", "sag_m", "shift_m", "sweeps"]
