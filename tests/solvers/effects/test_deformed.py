"""The rotation centre as a function of the angles, against the sag that was simulated."""

from dataclasses import replace

import numpy as np

import carm_kin
from benchmarks import realism
from carm_kin.calibrated.rotation_centre import RotationCentre


def taken(seed: int):
    """A C that sags by 2 mm; its recording, and its true offset (N, 3) and angles (N, 2) at every pose."""
    effect = next(one for one in realism.EFFECTS if one.name == "flex 2 mm")
    rng = np.random.default_rng([seed, realism.STREAM])
    machine, motion = realism.Machine.random(rng), realism.Motion.random(rng)
    xi = realism._sag(machine, motion.angles, effect, rng)
    p, R = machine.poses(motion.angles, xi)
    bend = realism.rotation(xi[:, 3:])
    inner = np.einsum("nji,nj->ni", bend, xi[:, :3]) + machine.sensor
    offset = -inner @ machine.R_carm_sensor
    p, R = realism.noisy(p, R, 2e-4 * rng.normal(size=p.shape), 1.4e-3 * rng.normal(size=p.shape))
    take = realism.Take(
        p, R, np.arange(len(p)) / 60.0, motion.sweep, motion.moving, np.full((len(p), 2), np.nan), np.zeros(len(p), int)
    )
    some = slice(None, None, 2)
    return machine, take.select(some), offset[some]


def test_the_offset_follows_the_angles():
    """Error of the offset at the poses within its ±, and of its changes far below that of a rigid C."""
    ratios, changes, rigid = [], [], []
    for seed in range(4):
        _, take, offset = taken(seed)
        result = carm_kin.calibrate(take.recording())
        bent, angles = result.deformation, result.angles_rad.T
        found = result.offset_sensor_pivot_m + bent.shift_m(*angles)
        ratios.append((found - offset) / bent.sigma_m(*angles))
        moved = offset - offset.mean(axis=0)
        changes.append(found - found.mean(axis=0) - moved)
        rigid.append(moved)
        assert not bent.extrapolated(*angles).any()
        assert bent.extrapolated(angles[0] + np.radians(200), angles[1]).all()
    assert np.sqrt(np.mean(np.square(ratios))) < 2  # 12 values that hardly depend on the pose
    assert np.sqrt(np.mean(np.square(changes))) < 0.7 * np.sqrt(np.mean(np.square(rigid)))


def test_it_is_applied_to_poses_in_use():
    """Poses of the bent C give a rotation centre nearer the true one, and their ± grows beyond the calibrated range."""
    _, take, _ = taken(1)
    result = carm_kin.calibrate(take.recording())
    T = np.tile(np.eye(4), (len(take), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = take.R, take.p
    bent, rigid = (RotationCentre(one).locate(T) for one in (result, replace(result, deformation=None)))
    scatter = [one.pivot_world_m - one.nearest.pivot_world_m for one in (bent, rigid)]
    assert np.sqrt((scatter[0] ** 2).mean()) < 0.9 * np.sqrt(
        (scatter[1] ** 2).mean()
    )  # noise of 1.4 mrad over 0.7 m is in both
    assert not bent.extrapolated.any()
    d = result.deformation
    middle = np.array([np.mean(d.alpha_range_rad)]), np.array([np.mean(d.beta_range_rad)])
    end = np.array([d.alpha_rad[-1]]), np.array([d.beta_rad[-1]])
    assert np.linalg.norm(d.sigma_m(*end)) > np.linalg.norm(d.sigma_m(*middle))


def test_a_rigid_machine_has_none():
    recording, _ = carm_kin.simulate("mobile_nonisocentric", sigma_t_m=2e-4, sigma_r_rad=1e-3, seed=1)
    result = carm_kin.calibrate(recording, systematic="none")
    assert result.deformation is None
    assert not RotationCentre(result).locate(recording.T_world_sensor[:3]).extrapolated.any()
