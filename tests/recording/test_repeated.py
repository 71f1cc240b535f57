"""A tracker that freezes: poses that repeat the one before are no measurements."""

from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.recording.checks import REPEATED, repeated
from carm_kin.recording.recording import Recording

SOUND, TRUTH = carm_kin.simulate("mobile_skewed", "clinical", sigma_t_m=5e-4, sigma_r_rad=1e-3, seed=4)
RNG = np.random.default_rng(0)


def frozen(stretches, recording: Recording = SOUND, jitter: float = 0.0) -> tuple[Recording, np.ndarray]:
    """In each of the stretches [first, end) the pose before ``first`` stands again; and the mask of these poses."""
    p, R = recording.p_world_sensor.copy(), recording.R_world_sensor.copy()
    bad = np.zeros(len(p), dtype=bool)
    for first, end in stretches:
        p[first:end], R[first:end], bad[first:end] = p[first - 1], R[first - 1], True
    p[bad] += jitter * RNG.uniform(-1, 1, (bad.sum(), 3))
    return replace(recording, p_world_sensor=p, R_world_sensor=R, time_s=0.02 * np.arange(len(p))), bad


def bare(recording: Recording) -> Recording:
    return Recording(recording.p_world_sensor, recording.R_world_sensor)


def test_all_but_the_first_are_marked():
    p, R = SOUND.p_world_sensor, SOUND.R_world_sensor
    order = np.array([0, 1, 1, 1, 2, 3, 1, 4, 4])
    assert np.flatnonzero(repeated(p[order], R[order])).tolist() == [2, 3, 8]
    assert repeated(p[order], None).tolist() == repeated(p[order], R[order]).tolist()
    assert repeated(p[:1], R[:1]).tolist() == [False]
    assert repeated(p[:0], R[:0]).tolist() == []
    assert not repeated(np.zeros((2, 3)), R[:2]).any()
    assert not repeated(p[:2], R[[0, 0]]).any()


@pytest.mark.parametrize("step, same", [(4e-7, True), (3e-6, False)])
def test_rounding_is_no_motion(step, same):
    p, R = np.array([[1.5, -0.7, 2.0]] * 2), np.stack([np.eye(3)] * 2)
    assert repeated(p + np.array([[0, 0, 0], [0, step, 0]]), R).tolist() == [False, same]
    turned = np.eye(3)
    turned[0, 1], turned[1, 0] = -step, step
    assert repeated(p, np.stack([np.eye(3), turned])).tolist() == [False, same]


@pytest.mark.parametrize("labels", [True, False])
@pytest.mark.parametrize(
    "stretches, jitter",
    [([(100, 300)], 0.0), ([(100, 200), (350, 450)], 0.0), ([(100, 300)], 2e-7)],
    ids=["one", "two", "rounded"],
)
def test_a_frozen_tracker_gives_what_the_other_poses_give(stretches, jitter, labels):
    recording, bad = frozen(stretches, jitter=jitter)
    rest = SOUND.select(~bad)
    if not labels:
        recording, rest = bare(recording), bare(rest)
    result, expected = carm_kin.calibrate(recording), carm_kin.calibrate(rest)
    np.testing.assert_array_equal(result.offset_sensor_pivot_m, expected.offset_sensor_pivot_m)
    np.testing.assert_array_equal(result.sigma.offset_sensor_pivot_m, expected.sigma.offset_sensor_pivot_m)
    assert (result.poses, result.used) == (len(recording), expected.used)
    assert np.isnan(result.angles_rad[bad]).all()
    reason = next(reason for reason in result.outliers.reasons if reason.reason == REPEATED)
    assert reason.indices == tuple(np.flatnonzero(bad))
    assert set(reason.indices) <= set(result.outliers.indices)
    told = [note.message for note in result.warnings if note.code == "duplicated_poses"]
    assert told == [f"{bad.sum()} of {len(recording)} poses are identical to the pose before them"]


def test_every_pose_written_twice_is_one():
    twice = SOUND.select(np.repeat(np.arange(len(SOUND)), 2))
    twice = replace(twice, pose_number=np.arange(len(twice)))
    result, expected = carm_kin.calibrate(twice), carm_kin.calibrate(SOUND)
    np.testing.assert_array_equal(result.sigma.offset_sensor_pivot_m, expected.sigma.offset_sensor_pivot_m)
    assert result.used == expected.used


def test_a_placement_in_which_the_tracker_was_frozen_throughout_is_refused():
    half = len(SOUND) // 2
    names = np.where(np.arange(len(SOUND)) < half, "a", "b")
    recording, _ = frozen([(half, len(SOUND))], replace(SOUND, placement=names, sweep=None, moving=None, joints={}))
    result = carm_kin.calibrate(recording)
    assert result.refusal is not None
    assert result.refusal.code == "too_few_poses"
    assert "placement 'b' has 0 poses" in result.refusal.message


def test_a_tracker_that_never_moves_is_a_machine_at_rest():
    recording, _ = frozen([(1, len(SOUND))])
    result = carm_kin.calibrate(recording)
    assert result.refusal is not None
    assert result.refusal.code == "one_axis_only"
