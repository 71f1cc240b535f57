"""What a chain's result says beside its numbers, and what is refused."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import carm_kin
from carm_kin.calibration.chain.calibrate import FreeJoints, calibrate_chain
from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from helpers.chained import (
    ARM_AXES,
    ARM_JOINTS,
    C_ARM,
    C_JOINTS,
    LIFTS,
    SIGMA_R,
    SIGMA_T,
    arm,
    arm_recording,
    c_arm_recording,
    codes,
    grossly,
    kinematics,
    noisy,
    parsed,
    perturbed,
    poses_of,
    random_values,
    recorded,
    stand,
)
from helpers.simulated import frame
from solvers.verdict.limits import Limits

EXACT = {"sigma_reading_rad": 0.0}


def refusal(recording, text=C_ARM, **options):
    """The refusal, of a result that holds no numbers."""
    result = calibrate_chain(recording, parsed(text), **options)
    assert result.status == "refused"
    assert result.offset_sensor_pivot_m is result.covariance is result.chain is None
    return result.refusal


# --- refusals -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("known", [C_JOINTS, ()])
@pytest.mark.parametrize("moving", ["orbital", "angular"])
def test_motion_about_one_axis_is_refused(known, moving):
    recording = c_arm_recording(1, known)[2]
    found = refusal(recording.select(recording.moving == moving).select(slice(0, 25)))
    assert found.code in ("one_axis_only", "unobservable", "too_uncertain")


def test_too_few_poses():
    assert refusal(c_arm_recording(1, C_JOINTS)[2].select(slice(0, 5))).code == "too_few_poses"


def test_a_joint_that_moved_unsaid_is_a_misfit():
    """The lift moves by 0.3 m, and no column mentions it."""
    recording = c_arm_recording(2, ("angular", "orbital"), (), LIFTS)[2]
    silent = recorded(poses_of(recording), joints=dict(recording.joints))
    found = refusal(silent)
    assert found.code == "misfit"
    assert "does a joint move that the recording does not mention" in found.message


def test_a_wrong_urdf_is_a_misfit_where_its_errors_are_not_free():
    """The noise is estimated, so that chi-square is 1; what the numbers left out would explain tells it."""
    text, _, recording, _ = arm_recording(3)
    found = refusal(recording, arm(), free=FreeJoints(("j2",)), **ARM_AXES, **EXACT)
    assert found.code == "misfit"
    assert "that were not free explain" in found.message
    wrong = max(range(1, 7), key=lambda k: f"origin of j{k}:" in found.message)
    assert f"j{wrong}" in found.message
    assert calibrate_chain(recording, parsed(text), free=FreeJoints(("none",)), **ARM_AXES, **EXACT).refusal is None


def test_small_errors_of_numbers_that_are_not_free_are_warned_of():
    text = perturbed(arm(), 0.25e-3, 0.0, 4, ["j3"])
    q = random_values(ARM_JOINTS, 600, 4)
    T = noisy(stand(4) @ kinematics(text, "tool", q), SIGMA_T, SIGMA_R, 4)
    result = calibrate_chain(recorded(T, joints=q), parsed(arm()), free=FreeJoints(("j6",)), **ARM_AXES, **EXACT)
    assert result.refusal is None
    (note,) = [warning for warning in result.warnings if warning.code == "more_to_free"]
    assert "most of all the origin of j3" in note.message
    sound = calibrate_chain(recorded(T, joints=q), parsed(text), free=FreeJoints(("j6",)), **ARM_AXES, **EXACT)
    assert "more_to_free" not in codes(sound)


@pytest.mark.parametrize("factor, words", [(1e3, "millimetres read as|no machine"), (1e-3, "metres read as")])
def test_a_wrong_unit_is_a_misfit(factor, words):
    recording = c_arm_recording(1, C_JOINTS)[2]
    T = poses_of(recording)
    T[:, :3, 3] *= factor
    found = refusal(recorded(T, joints=recording.joints, prismatic=recording.prismatic))
    assert found.code == "misfit"
    assert re.search(words, found.message)


@pytest.mark.parametrize("change", ["inverted", "transposed"])
def test_poses_turned_round_are_a_misfit(change):
    recording = c_arm_recording(1, C_JOINTS)[2]
    T = poses_of(recording)
    turned = np.linalg.inv(T) if change == "inverted" else T
    if change == "transposed":
        turned[:, :3, :3] = np.swapaxes(T[:, :3, :3].copy(), 1, 2)
    assert refusal(recorded(turned, joints=recording.joints, prismatic=recording.prismatic)).code == "misfit"


def test_readings_of_the_wrong_sign_are_a_misfit():
    recording = arm_recording(5)[2]
    joints = {**recording.joints, "j3": -recording.joints["j3"]}
    assert refusal(recorded(poses_of(recording), joints=joints), arm(), **ARM_AXES).code == "misfit"


def test_poses_that_exceed_a_given_noise_are_a_misfit():
    found = refusal(arm_recording(6)[2], arm(), sigma_t_m=SIGMA_T / 3, sigma_r_rad=SIGMA_R / 3, **ARM_AXES, **EXACT)
    assert found.code in ("misfit", "too_many_outliers")


def test_half_of_the_poses_from_another_machine_are_too_many_outliers():
    recording = arm_recording(7)[2]
    T, gross = grossly(poses_of(recording), 0.4, 7)
    strict = Limits(max_rejected_share=0.3)
    assert gross.mean() == 0.4
    assert refusal(recorded(T, joints=recording.joints), arm(), limits=strict, **ARM_AXES).code == "too_many_outliers"


def test_an_iteration_that_ends_early_is_refused():
    assert refusal(arm_recording(8)[2], arm(), max_iterations=2, **ARM_AXES).code == "not_converged"


def test_short_arcs_are_too_uncertain():
    """Angles within 2 degrees, and a noise of 0.25 mm."""
    q = random_values(["angular", "orbital"], 100, 9, np.radians(2.0))
    T = noisy(stand(9) @ kinematics(C_ARM, "sensor", q), SIGMA_T, SIGMA_R, 9)
    assert refusal(recorded(T, joints=q), **EXACT).code in ("too_uncertain", "one_axis_only")


def test_recordings_that_nothing_links_are_refused():
    """Two sensors, each in a placement of its own."""
    from helpers.chained import BIPLANE

    names = ["f_angular", "f_orbital", "l_angular", "l_orbital"]
    q = random_values(names, 40, 1)
    parts = [
        recorded(kinematics(BIPLANE, link, q), joints=q, metadata={"sensor": np.full(40, link)})
        for link in ("frontal", "lateral")
    ]
    assert refusal(parts, BIPLANE).code == "unobservable"


def test_positions_alone_are_an_input_error():
    recording = c_arm_recording(1, C_JOINTS)[2]
    with pytest.raises(InputError, match="has no orientations"):
        calibrate_chain(replace(recording, R_world_sensor=None), parsed(C_ARM))


@pytest.mark.parametrize(
    "joints, words",
    [
        ({"elbow": "deg"}, "names the joint 'elbow'"),
        ({"lift": "deg"}, "column q_lift_deg: joint 'lift' slides: its column is q_lift_mm"),
        ({"angular": "mm"}, "column q_angular_mm: joint 'angular' turns: its column is q_angular_deg"),
    ],
)
def test_joints_that_the_machine_does_not_have(joints, words):
    recording = c_arm_recording(1, C_JOINTS)[2]
    values = {name: np.zeros(len(recording)) for name in joints}
    slides = frozenset(name for name, unit in joints.items() if unit == "mm")
    with pytest.raises(InputError, match=words):
        calibrate_chain(recorded(poses_of(recording), joints=values, prismatic=slides), parsed(C_ARM))


def test_a_pose_without_a_sensor_is_an_input_error():
    recording = c_arm_recording(1, C_JOINTS)[2]
    named = np.full(len(recording), "sensor", dtype=object)
    named[7] = ""
    with pytest.raises(InputError, match="pose 7 names no sensor link"):
        calibrate_chain(replace(recording, metadata={"sensor": named.astype(str)}), parsed(C_ARM))


@pytest.mark.parametrize("free", [FreeJoints(("elbow",)), FreeJoints(zeros=("elbow",)), FreeJoints(gains=("x",))])
def test_free_joints_that_there_are_not(free):
    with pytest.raises(InputError, match="valid: all, axes, none"):
        calibrate_chain(c_arm_recording(1, C_JOINTS)[2], parsed(C_ARM), free=free)


@pytest.mark.parametrize("name", ["sigma_t_m", "sigma_r_rad", "sigma_reading_rad", "sigma_reading_m"])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_noise_that_is_none(name, value):
    with pytest.raises(InputError, match=name):
        calibrate_chain(c_arm_recording(1, C_JOINTS)[2], parsed(C_ARM), **{name: value})


# --- notes --------------------------------------------------------------------------------------------------------


def test_joints_at_rest_and_joints_not_mentioned():
    recording = c_arm_recording(2, ("angular", "orbital"))[2]
    result = calibrate_chain(recording, parsed(C_ARM))
    assert "joints_at_zero" in codes(result)
    assert "lift: at rest or hardly moved in all poses" in result.chain.not_identifiable
    assert {joint.joint for joint in result.chain.joints} <= {"angular", "orbital"}
    assert result.observability.unobservable == result.chain.not_identifiable


def test_what_is_not_identifiable_is_named_by_joint_and_direction():
    """Of the two axes 2 of 12 numbers are told, and the sentences name the other 10."""
    result = calibrate_chain(c_arm_recording(2, C_JOINTS)[2], parsed(C_ARM))
    told = {(joint.joint, part) for joint in result.chain.joints for part in joint.estimated}
    named = set()
    for sentence in result.chain.not_identifiable:
        owner, _, rest = sentence.partition(" (")
        if owner in ("angular", "orbital"):
            named |= {(owner, part) for part in rest.split(")")[0].split(", ")}
            assert "the poses do not tell it from" in sentence
    assert len(told) == 2
    everything = {(j, part) for j in ("angular", "orbital") for part in ("x", "y", "z", "rx", "ry", "rz")}
    assert told | named == everything
    assert not told & named


def hardly_moving(seed=3):
    """An arm whose third joint moves by little more than the 5 degrees that count as motion."""
    truth, q = perturbed(arm(), 1e-3, 2e-3, seed), random_values(ARM_JOINTS, 60, seed)
    q["j3"] = 0.045 * q["j3"]
    T = noisy(stand(seed) @ kinematics(truth, "tool", q), 5 * SIGMA_T, 5 * SIGMA_R, seed)
    return recorded(T, joints=q)


def test_weak_joints_are_warned_of_and_held_by_a_prior():
    wild = calibrate_chain(hardly_moving(), parsed(arm()), **ARM_AXES, **EXACT)
    assert "weak_joints" in codes(wild)
    tame = calibrate_chain(hardly_moving(), parsed(arm()), prior_t=1e-3, prior_r=2e-3, **ARM_AXES, **EXACT)
    assert "weak_joints" not in codes(tame)
    (note,) = [warning for warning in tame.warnings if warning.code == "held_by_prior"]
    assert "j3" in note.message or "j4" in note.message
    for joint in tame.chain.joints:
        assert (joint.shift_sigma_m <= 1e-3 * (1 + 1e-9)).all()
        assert (joint.turn_sigma_rad <= 2e-3 * (1 + 1e-9)).all()


def test_a_joint_that_turns_by_less_than_the_least_arc_keeps_its_numbers_and_is_named():
    """Of 3 degrees nothing is told, whatever the exactness of the poses; 5 degrees are the least."""
    truth, q = perturbed(arm(), 1e-3, 2e-3, 3), random_values(ARM_JOINTS, 60, 3)
    q["j3"] = np.radians(1.5) * q["j3"] / np.abs(q["j3"]).max()
    T = noisy(stand(3) @ kinematics(truth, "tool", q), 1e-5, 1e-5, 3)
    result = calibrate_chain(recorded(T, joints=q), parsed(arm()), **ARM_AXES, **EXACT)
    assert "j3: at rest or hardly moved in all poses" in result.chain.not_identifiable
    assert "j3" not in {joint.joint for joint in result.chain.joints}


def test_a_joint_far_from_its_nominal_place_is_warned_of():
    far = C_ARM.replace('xyz="0.8 0.02 0.1"', 'xyz="0.8 0.02 0.2"')
    assert far != C_ARM
    recording = c_arm_recording(4, C_JOINTS)[2]
    assert "far_from_nominal" in codes(calibrate_chain(recording, parsed(far)))
    assert "far_from_nominal" not in codes(calibrate_chain(recording, parsed(C_ARM)))


def test_noise_that_is_not_independent_is_warned_of():
    recording = c_arm_recording(5, C_JOINTS, noise=0.0)[2]
    rng = np.random.default_rng(0)
    white = rng.normal(size=(len(recording) + 3, 3))
    drift = sum(white[k : len(recording) + k] for k in range(4)) * SIGMA_T / 2
    noisy_poses = poses_of(recording)
    noisy_poses[:, :3, 3] += drift
    told = {
        "joints": recording.joints,
        "sweep": recording.sweep,
        "moving": recording.moving,
        "prismatic": recording.prismatic,
    }
    assert "correlated_residuals" in codes(calibrate_chain(recorded(noisy_poses, **told), parsed(C_ARM)))
    assert "correlated_residuals" not in codes(calibrate_chain(c_arm_recording(5, C_JOINTS)[2], parsed(C_ARM)))


def test_changes_come_with_their_sigma():
    """Over 30 recordings the estimated numbers of the joints, less the true ones, are within their sigmas: the truth
    differs from the URDF in the identifiable directions alone."""
    result = calibrate_chain(c_arm_recording(6, C_JOINTS)[2], parsed(C_ARM))
    (joint,) = [joint for joint in result.chain.joints if len(joint.estimated) == 2]
    parts = [("xyz".index(p), "shift") if len(p) == 1 else ("xyz".index(p[1]), "turn") for p in joint.estimated]
    normalised = []
    for seed in range(30):
        q = random_values(["angular", "orbital"], 40, seed)
        T = noisy(stand(seed) @ kinematics(C_ARM, "sensor", q), SIGMA_T, SIGMA_R, seed)
        (found,) = calibrate_chain(
            recorded(T, joints=q), parsed(C_ARM), free=FreeJoints((joint.joint,)), **EXACT
        ).chain.joints
        if found.estimated != joint.estimated:
            continue
        values = {"shift": (found.shift_m, found.shift_sigma_m), "turn": (found.turn_rad, found.turn_sigma_rad)}
        normalised += [values[kind][0][k] / values[kind][1][k] for k, kind in parts]
    assert len(normalised) >= 40
    assert np.std(normalised) == pytest.approx(1, abs=4 / np.sqrt(2 * len(normalised)) + 0.02)


# --- poses and files ----------------------------------------------------------------------------------------------


def test_residuals_per_sweep_add_up():
    recording = c_arm_recording(7, C_JOINTS, outliers=0.1)[2]
    result = calibrate_chain(recording, parsed(C_ARM))
    rows = result.residuals_per_sweep
    assert [row.label for row in rows] == ["s0", "s1", "s2", "s3", "s4"]
    assert sum(row.poses for row in rows) == result.used < len(recording)
    for name in ("translation_rms_m", "rotation_rms_rad"):
        total = sum(row.poses * getattr(row, name) ** 2 for row in rows)
        assert total == pytest.approx(result.used * getattr(result.residuals, name) ** 2)
    mean = sum(row.poses * row.chi2_per_dof for row in rows) / result.used
    assert mean == pytest.approx(1, abs=0.1)  # less what the machine takes: 14 of 560


def test_sweeps_of_several_recordings():
    """They are numbered by recording, and each has its own residuals."""
    quiet, loud = (c_arm_recording(7, C_JOINTS, noise=noise)[2] for noise in (1.0, 1.5))
    result = calibrate_chain([quiet, loud], parsed(C_ARM))
    rows = result.residuals_per_sweep
    assert [row.label for row in rows] == [f"{k}: s{n}" for k in (1, 2) for n in range(5)]
    sums = [sum(row.poses * row.translation_rms_m**2 for row in part) for part in (rows[:5], rows[5:])]
    assert sums[1] / sums[0] == pytest.approx(1.5**2, rel=0.1)  # the noise is the same but for its size


def test_a_noisy_sweep_shows():
    recording = c_arm_recording(8, C_JOINTS)[2]
    T = poses_of(recording)
    loud = recording.sweep == "s2"
    T[loud] = noisy(T[loud], 2 * SIGMA_T, 0.0, 1)
    told = {
        "joints": recording.joints,
        "sweep": recording.sweep,
        "moving": recording.moving,
        "prismatic": recording.prismatic,
    }
    rows = calibrate_chain(recorded(T, **told), parsed(C_ARM), reject_outliers=False).residuals_per_sweep
    assert max(rows, key=lambda row: row.chi2_per_dof).label == "s2"
    assert max(rows, key=lambda row: row.translation_rms_m).label == "s2"


def again_and_again(recording: Recording, pose: int, times: int) -> Recording:
    """With one pose repeated."""
    return recording.select(np.sort([*range(len(recording)), *[pose] * times]))


def test_repeated_poses_are_left_out_and_listed():
    recording = c_arm_recording(9, C_JOINTS)[2]
    frozen = again_and_again(recording, 30, 40)
    frozen = replace(frozen, pose_number=np.arange(len(frozen)))
    result, clean = (calibrate_chain(r, parsed(C_ARM)) for r in (frozen, recording))
    np.testing.assert_array_equal(result.offset_sensor_pivot_m, clean.offset_sensor_pivot_m)
    np.testing.assert_array_equal(result.sigma.offset_sensor_pivot_m, clean.sigma.offset_sensor_pivot_m)
    assert result.outliers.indices == tuple(range(31, 71))
    assert [reason.reason for reason in result.outliers.reasons] == ["identical to the pose before"]
    assert (result.poses, result.used) == (len(recording) + 40, len(recording))
    assert "duplicated_poses" in codes(result)
    assert np.isnan(result.angles_rad[31:71]).all()
    assert np.isfinite(np.delete(result.angles_rad, range(31, 71), axis=0)).all()


def test_repeated_poses_of_each_of_two_sensors():
    """Two trackers in turn: a pose that equals the one before last is a repetition of its own sensor's."""
    from helpers.chained import BIPLANE

    names = ["f_angular", "f_orbital", "l_angular", "l_orbital"]
    q = random_values(names, 80, 3)
    named = np.array(["frontal", "lateral"] * 40)
    frontal, lateral = (kinematics(BIPLANE, link, q) for link in ("frontal", "lateral"))
    T = noisy(np.where((named == "frontal")[:, None, None], frontal, lateral), SIGMA_T, SIGMA_R, 3)
    T[22] = T[20]
    result = calibrate_chain(recorded(T, joints=q, metadata={"sensor": named}), parsed(BIPLANE))
    (reason,) = result.outliers.reasons
    assert (reason.reason, reason.indices) == ("identical to the pose before", (22,))


def test_outliers_of_several_recordings_are_counted_on():
    """Missing frames count; the second recording goes on where the first ends."""
    first, second = (arm_recording(k, n=60)[2] for k in (0, 0))
    T = poses_of(second)
    T[5, :3, 3] += 0.3
    seen = np.arange(60) % 10 > 0
    parts = [
        replace(first.select(seen), missing=6),
        replace(recorded(T, joints=second.joints).select(seen), missing=6),
    ]
    result = calibrate_chain(parts, parsed(arm()), **ARM_AXES)
    assert result.outliers.indices == (65,)
    assert result.poses == 108


def test_json_of_a_chain_is_read_again(tmp_path):
    result = calibrate_chain(c_arm_recording(10, C_JOINTS, ("lift",), LIFTS, outliers=0.1)[2], parsed(C_ARM), folds=3)
    text = result.to_json(tmp_path / "a.json")
    again = carm_kin.CalibrationResult.from_json(tmp_path / "a.json")
    assert again.to_json() == text
    chain = json.loads(text)["chain"]
    assert chain["sensors"][0]["offset_sensor_pivot_mm"] == pytest.approx(1e3 * result.offset_sensor_pivot_m)
    changed = {joint["joint"]: joint for joint in chain["joints"]}
    for joint in result.chain.joints:
        assert changed[joint.joint]["shift_mm"] == pytest.approx(1e3 * joint.shift_m)
        assert changed[joint.joint]["turn_deg"] == pytest.approx(np.degrees(joint.turn_rad))
    assert chain["nominal"]["translation_rms_mm"] > chain["calibrated"]["translation_rms_mm"]


def test_a_chains_result_can_be_checked_against_a_new_recording():
    recording, _ = carm_kin.simulate("mobile_skewed", sigma_t_m=0.2e-3, sigma_r_rad=1e-3, seed=1)
    new, _ = carm_kin.simulate("mobile_skewed", sigma_t_m=0.2e-3, sigma_r_rad=1e-3, seed=2)
    saved = calibrate_chain(recording, "mobile_nonisocentric")
    assert not carm_kin.check(saved, new).failures


@given(st.integers(0, 1000))
@settings(max_examples=8)
def test_the_frame_of_the_world_does_not_matter(seed):
    recording = arm_recording(11, n=50)[2]
    W = frame(np.random.default_rng(seed), 3.0)
    here, there = (
        calibrate_chain(recorded(T, joints=recording.joints), parsed(arm()), **ARM_AXES, **EXACT)
        for T in (poses_of(recording), W @ poses_of(recording))
    )
    np.testing.assert_allclose(there.offset_sensor_pivot_m, here.offset_sensor_pivot_m, atol=1e-6)
    np.testing.assert_allclose(there.sigma.offset_sensor_pivot_m, here.sigma.offset_sensor_pivot_m, rtol=1e-3)
    np.testing.assert_allclose(there.chain.bases[0].T_world_base, W @ here.chain.bases[0].T_world_base, atol=1e-5)
