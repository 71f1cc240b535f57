"""Simulated recordings: a chain, a protocol, noise and a seed give a recording and its truth."""

import os
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from carm_kin.machine.chain import Chain, chain_of
from carm_kin.machine.kinematics import Model
from carm_kin.machine.urdf import UrdfFile, as_urdf
from carm_kin.recording.recording import ROTATION_TOLERANCE, Recording
from carm_kin.results.result import CalibrationResult
from carm_kin.simulation.effects import Effects, lagging, tracked
from carm_kin.simulation.noise import Noise, checked, disturbed, readings, rounded
from carm_kin.simulation.plan import Plan, plan_of
from carm_kin.simulation.sag import sag_of
from carm_kin.simulation.truth import truth_of
from carm_kin.steps import step
from solvers.estimate import Note
from solvers.se3 import Array, inverse, rotation_from_quat_wxyz, transform

WORLD_M = 1.0
"""The torus centre is drawn from a cube of this half-width about the tracker's origin."""


@step("simulate a recording")
def simulate(
    urdf: UrdfFile | str | os.PathLike,
    protocol: str | Path = "clinical",
    *,
    sigma_t_m: float = 0.0,
    sigma_r_rad: float = 0.0,
    anisotropy: float = 1.0,
    correlation: float = 0.0,
    outliers: float = 0.0,
    missing: float = 0.0,
    sigma_reading_rad: float = 0.0,
    sigma_reading_m: float = 0.0,
    label_resolution_rad: float = 0.0,
    sag_m: float = 0.0,
    field_m: float = 0.0,
    creep_m: float = 0.0,
    backlash_rad: float = 0.0,
    smoothing_s: float = 0.0,
    rate_hz: float | None = None,
    labels: bool = True,
    T_world_torus: Array | None = None,
    T_sensor_mount: Array | None = None,
    angular: str | None = None,
    orbital: str | None = None,
    sensor_link: str | None = None,
    seed: int = 0,
) -> tuple[Recording, CalibrationResult]:
    """A recording of the C-arm in ``urdf`` (a path or a bundled name) and its truth.

    ``protocol`` is paper, clinical, minimal, free, joints, virtual or a TOML file. ``T_world_torus`` (4, 4), m,
    is drawn from the seed unless given. ``T_sensor_mount`` (4, 4) turns and moves the sensor in its link.
    ``anisotropy`` is the noise along the tracker's z axis over that across it. Without ``labels`` the recording tells
    nothing of the joints. The other numbers are those of `Noise` and, from ``sag_m`` to ``rate_hz``, of
    `carm_kin.simulation.effects.Effects`. The truth is a result of the solver ``truth``: its options are these numbers,
    its outliers the poses that were replaced; with a sag its rigid numbers are those of a deformation of mean zero over
    the recording's ranges of both angles, and its `deformation` says the rest. Raises InputError for bad input.
    """
    disturbing = (sigma_t_m, sigma_r_rad, anisotropy, correlation, outliers, missing)
    noise = checked(Noise(*disturbing, sigma_reading_rad, sigma_reading_m, label_resolution_rad))
    effects = Effects(sag_m, field_m, creep_m, backlash_rad, smoothing_s, rate_hz).checked(protocol)
    if seed < 0:
        raise InputError(f"the seed must be at least 0, not {seed}")
    for name, T in (("T_world_torus", T_world_torus), ("T_sensor_mount", T_sensor_mount)):
        _check_rigid(name, T)
    rng = np.random.default_rng(seed)
    file = as_urdf(urdf)
    chain = chain_of(file, sensor_link, angular, orbital)
    plan = plan_of(file, chain, protocol, rng)
    if T_world_torus is None:
        T_world_torus = transform(rotation_from_quat_wxyz(rng.normal(size=4)), rng.uniform(-WORLD_M, WORLD_M, 3))
    mount = np.eye(4) if T_sensor_mount is None else T_sensor_mount
    T_world_base = T_world_torus @ inverse(plan.geometries[0].T_base_torus)
    q, axes = plan.q.copy(), [chain.angular, chain.orbital]
    if effects.backlash_rad:
        q[:, axes] = lagging(q[:, axes], effects.backlash_rad)
    T = T_world_base @ Model(file, chain).forward_kinematics(q) @ mount
    sag = sag_of(chain, plan.geometries, mount, plan.q[:, axes], effects.sag_m) if effects.sag_m else None
    if sag is not None:
        T = sag.bent(T, T_world_base[:3, 2], q[:, chain.orbital])
    p, R, replaced = disturbed(tracked(T, plan, effects, seed), noise, rng, plan.part)
    seen = rng.random(len(T)) >= noise.missing
    recording = _recording(chain, plan, p, R, labels, noise, rng)
    recording = replace(recording, time_s=effects.times(plan)).select(seen)
    return replace(recording, missing=int((~seen).sum())), truth_of(
        plan,
        T_world_base,
        mount,
        options={"protocol": Path(protocol).name} | asdict(noise) | asdict(effects),
        noise=noise,
        deformation=sag.deformation(plan.geometries[0], plan.q[:, axes]) if sag else None,
        outliers=np.flatnonzero(replaced & seen),
        poses=len(recording),
        notes=tuple(Note("urdf", note) for note in (*file.notes, *chain.notes)),
        seed=seed,
    )


def _check_rigid(name: str, T: Array | None) -> None:
    """Raise InputError where a transform is given that is none."""
    if T is None:
        return
    if np.shape(T) != (4, 4) or not np.isfinite(T).all() or (np.asarray(T)[3] != (0, 0, 0, 1)).any():
        raise InputError(f"{name} must be a finite (4, 4) transform with the last row 0 0 0 1")
    R = np.asarray(T)[:3, :3]
    if np.abs(R.T @ R - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(R) < 0:
        raise InputError(f"{name} holds no rotation matrix")


def _recording(
    chain: Chain, plan: Plan, p: Array, R: Array, labels: bool, noise: Noise, rng: np.random.Generator
) -> Recording:
    placements = (plan.placement + 1).astype(str) if plan.placement.any() else None
    if not labels:
        return Recording(p, R, placement=placements)
    prismatic = frozenset(n for n, kind in zip(chain.names, chain.types, strict=True) if kind == "prismatic")
    sizes = [len(motion.q) for motion in plan.motions]
    joints = {}
    for name in dict.fromkeys(name for motion in plan.motions for name in motion.told):
        told = [motion.told.get(name, np.full(len(motion.q), np.nan)) for motion in plan.motions]
        sigma = noise.sigma_reading_m if name in prismatic else noise.sigma_reading_rad
        read = readings(np.concatenate(told), sigma, rng)
        joints[name] = read if name in prismatic else rounded(read, noise.label_resolution_rad)
    return Recording(
        p,
        R,
        sweep=np.repeat([motion.sweep for motion in plan.motions], sizes),
        moving=np.repeat([motion.moving for motion in plan.motions], sizes),
        placement=placements,
        joints=joints,
        prismatic=prismatic & joints.keys(),
    )
