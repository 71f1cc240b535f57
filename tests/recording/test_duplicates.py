"""Copies of earlier poses, and positions at rest, are no measurements."""

from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.recording.duplicates import COPIED, STANDING, copied, standing
from carm_kin.recording.recording import Recording

SOUND, _ = carm_kin.simulate("mobile_skewed", "clinical", sigma_t_m=5e-4, sigma_r_rad=1e-3, seed=4)
N = len(SOUND)
P, R = SOUND.p_world_sensor, SOUND.R_world_sensor


@pytest.mark.parametrize(
    "order, marked",
    [
        ([0, 1, 2, 3, 4, 5, 6, 7, 2, 8], []),
        ([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 2, 3, 4], [11, 12, 13]),
        ([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 4, 3, 2], [11, 12, 13]),
        ([0, 1, 2, 3, 2, 4, 2, 5, 6, 7], [4, 6]),
        ([0, 1, 0, 1], [2, 3]),
        ([0], []),
        ([], []),
    ],
    ids=["one by chance", "a stretch", "backwards", "three times", "half of them", "one pose", "none"],
)
def test_what_counts_as_a_copy(order, marked):
    order = np.array(order, dtype=int)
    assert np.flatnonzero(copied(P[order], R[order])).tolist() == marked
    assert np.flatnonzero(copied(P[order], None)).tolist() == marked


def test_a_position_at_rest_needs_a_turn_and_three_poses():
    p = P[:40:4].copy()
    assert not standing(p, R[:40:4]).any()
    p[[2, 5]] = 0.0
    assert not standing(p, R[:40:4]).any()
    p[8] = 0.0
    assert np.flatnonzero(standing(p, R[:40:4])).tolist() == [2, 5, 8]
    assert not standing(p, np.broadcast_to(np.eye(3), (10, 3, 3))).any()


@pytest.mark.parametrize("shuffled", [False, True])
def test_a_file_ten_times_over_is_one_file(shuffled):
    order = np.tile(np.arange(N), 10)
    if shuffled:
        order = np.random.default_rng(0).permutation(order)
    many = replace(SOUND.select(order), pose_number=np.arange(10 * N))
    # systematic effects depend on the order of the poses in time
    result, expected = (carm_kin.calibrate(one, systematic="none") for one in (many, SOUND))
    # the order of the sums differs where the poses were shuffled, and where outliers start from random samples
    np.testing.assert_allclose(result.sigma.offset_sensor_pivot_m, expected.sigma.offset_sensor_pivot_m, rtol=1e-2)
    assert result.poses == 10 * N
    assert result.used == expected.used
    assert "copied_poses" in {note.code for note in result.warnings}
    assert sum(r.count for r in result.outliers.reasons) == 10 * N - result.used


@pytest.mark.parametrize("where", [(0.0, 0.0, 0.0), (0.3, 0.2, 1.0)], ids=["at zero", "at rest"])
def test_nine_in_twenty_positions_at_rest_leave_what_the_others_say(where):
    bad = np.random.default_rng(1).permutation(N) < 0.45 * N
    p = np.where(bad[:, None], where, P)
    result = carm_kin.calibrate(replace(SOUND, p_world_sensor=p))
    expected = carm_kin.calibrate(SOUND.select(~bad))
    np.testing.assert_array_equal(result.offset_sensor_pivot_m, expected.offset_sensor_pivot_m)
    reasons = {r.reason: r.indices for r in result.outliers.reasons}
    assert reasons[STANDING] == tuple(np.flatnonzero(bad))
    assert COPIED not in reasons


def test_a_sensor_that_never_leaves_its_place_is_not_left_out():
    """All at rest: there is nothing else to calibrate from, and the unit is asked for."""
    result = carm_kin.calibrate(Recording(np.zeros((N, 3)), R))
    assert result.refusal is not None
    assert result.poses == N
