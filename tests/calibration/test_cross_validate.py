"""The held-out check: honest on sound poses, worse on a bent machine, refused where too little is left."""

from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.calibration.cross_validate import cross_validate, fold_of_poses
from carm_kin.errors import InputError, RefusedError
from carm_kin.recording.recording import Recording
from carm_kin.results.result import CalibrationResult
from helpers.command import fails, run
from solvers.se3 import exp_so3

NOISE = {"sigma_t_m": 3e-4, "sigma_r_rad": 1e-3}


@pytest.fixture(scope="module")
def sweeps() -> Recording:
    return carm_kin.simulate("mobile_skewed", "minimal", seed=1, **NOISE)[0]


@pytest.fixture(scope="module")
def free() -> Recording:
    return carm_kin.simulate("mobile_skewed", "free", seed=2, **NOISE)[0]


def test_the_held_out_error_is_the_noise_less_what_the_angles_absorb(sweeps):
    found = cross_validate(sweeps, 4)
    assert [fold.sweeps for fold in found.per_fold] == [(s.label,) for s in (sweeps.sweeps[3], *sweeps.sweeps[:3])]
    assert found.overall.poses == sum(fold.poses for fold in found.per_fold) == len(sweeps)
    assert found.overall.dof == pytest.approx(5 * len(sweeps), rel=1e-3)
    assert found.overall.chi2_per_dof == pytest.approx(1, abs=0.1)
    assert 1.3 * NOISE["sigma_t_m"] < found.overall.translation_rms_m < 1.05 * np.sqrt(3) * NOISE["sigma_t_m"]
    assert 1.4 * NOISE["sigma_r_rad"] < found.overall.rotation_rms_rad < 1.05 * np.sqrt(3) * NOISE["sigma_r_rad"]


def test_without_sweeps_the_folds_are_contiguous_and_two_residuals_a_pose_are_absorbed(free):
    number = fold_of_poses(free, 5)
    assert (np.diff(number) >= 0).all()
    assert np.bincount(number).tolist() == [200] * 5
    found = cross_validate(free, 5)
    assert found.overall.dof == pytest.approx(4 * len(free), rel=1e-3)
    assert found.overall.chi2_per_dof == pytest.approx(1, abs=0.1)
    assert all(fold.sweeps == () for fold in found.per_fold)


def test_a_sensor_that_creeps_is_seen(free):
    """Fits to the other folds do not predict poses taken with the sensor elsewhere in its mount."""
    turn = exp_so3(np.radians(np.linspace(0, 2, len(free)))[:, None] * np.array([0.0, 0.0, 1.0]))
    moved = replace(free, R_world_sensor=free.R_world_sensor @ turn)
    found = cross_validate(moved, 5, reject_outliers=False, systematic="none")
    assert (
        found.per_fold[4].rotation_rms_rad > 3 * cross_validate(free, 5, systematic="none").per_fold[4].rotation_rms_rad
    )


def test_outliers_are_not_scored():
    recording, truth = carm_kin.simulate("mobile_skewed", "free", outliers=0.1, seed=3, **NOISE)
    found = cross_validate(recording, 3)
    assert found.overall.poses == pytest.approx(len(recording) - truth.outliers.count, abs=2)
    assert found.overall.translation_rms_m < 6e-4


def test_a_fold_that_leaves_no_motion_about_an_axis_is_refused_by_itself(sweeps):
    two = sweeps.select(np.isin(sweeps.sweep_number, [1, 3]))
    found = cross_validate(two, 2)
    assert [fold.refusal is None for fold in found.per_fold] == [False, False]
    assert found.overall.refusal.message.startswith("every fold is refused, the first since")
    assert found.overall.translation_rms_m is None


def test_a_fold_that_leaves_a_placement_nothing_to_fit_is_refused_by_itself(sweeps, free):
    """The second placement has one sweep of each joint, the first all of them."""
    T = exp_so3(np.array([0.3, -0.2, 0.1]))
    again = sweeps.select(np.isin(sweeps.sweep_number, [1, 3]))
    both = Recording(
        np.concatenate([sweeps.p_world_sensor, again.p_world_sensor @ T.T + 0.2]),
        np.concatenate([sweeps.R_world_sensor, T @ again.R_world_sensor]),
        sweep=np.concatenate([sweeps.sweep, again.sweep + " again"]),
        moving=np.concatenate([sweeps.moving, again.moving]),
        placement=np.array(["A"] * len(sweeps) + ["B"] * len(again)),
    )
    found = cross_validate(both, 6, systematic="none")
    refused = {fold.sweeps: fold.refusal for fold in found.per_fold if fold.refusal}
    assert set(refused) == {(f"{s.label} again",) for s in again.sweeps}
    codes = "unobservable", "one_axis_only"
    assert all("'B'" in note.message or note.code in codes for note in refused.values())
    assert found.overall.chi2_per_dof == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("folds, expected", [(1, "at least 2 folds, not 1"), (5, "4 sweeps can be held out")])
def test_impossible_numbers_of_folds(folds, expected, sweeps):
    with pytest.raises(InputError, match=expected):
        cross_validate(sweeps, folds)


def test_a_recording_that_is_refused_and_a_solver_without_a_chain(sweeps):
    with pytest.raises(RefusedError):
        cross_validate(replace(sweeps.select(sweeps.sweep_number == 1), sweep=None, moving=None), 3)
    with pytest.raises(InputError, match="no complete chain"):
        cross_validate(sweeps, 4, "surface")


def test_the_command_writes_it_and_reads_it_back(sweeps, tmp_path, capsys):
    carm_kin.write_recording(sweeps, tmp_path / "rec.csv")
    out = tmp_path / "out.json"
    ended = run(capsys, "calibrate", tmp_path / "rec.csv", "--cross-validate", 4, "--json", out)
    assert ended.status == 0
    assert "held out, overall" in ended.out
    assert "angles absorb 1.0 of 6" in ended.out
    result = CalibrationResult.from_json(out)
    assert result.to_json() == out.read_text()
    assert result.cross_validation.per_fold[0].sweeps == ("angular +0.0 deg",)
    assert "at least 2 parts" in fails(capsys, "calibrate", tmp_path / "rec.csv", "--cross-validate", 1)


def test_labels_that_are_off_spoil_no_prediction(sweeps):
    """The labels of the held-out sweeps, off by far more than their digits tell, count as readings."""
    off = np.radians(np.random.default_rng(5).uniform(-0.5, 0.5, len(sweeps.sweeps)))[sweeps.sweep_number]
    found = cross_validate(replace(sweeps, joints={joint: angle + off for joint, angle in sweeps.joints.items()}), 4)
    assert found.overall.chi2_per_dof == pytest.approx(1, abs=0.15)


def test_a_placement_that_is_left_out_is_not_scored(sweeps):
    """One sweep of the orbital joint stands elsewhere: the others are held out as if it were not there."""
    orbital = next(sweep for sweep in sweeps.sweeps if sweep.moving == "orbital")
    placement = np.where(np.isin(np.arange(len(sweeps)), orbital.poses), "B", "A")
    rest = sweeps.select(placement == "A")
    found = cross_validate(replace(sweeps, placement=placement), 4, systematic="none")
    alone = cross_validate(rest, 3, systematic="none")
    assert [fold.sweeps for fold in found.per_fold if fold.poses] == [fold.sweeps for fold in alone.per_fold]
    assert found.overall.poses == alone.overall.poses == len(rest)
    assert found.overall.translation_rms_m == pytest.approx(alone.overall.translation_rms_m, rel=1e-6)
