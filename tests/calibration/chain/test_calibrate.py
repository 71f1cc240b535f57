"""Chains calibrated from recordings: against closed poses, the two-axis solvers and what must be refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.calibration.chain.calibrate import FreeJoints, calibrate_chain
from carm_kin.calibration.chain.calibrated_urdf import calibrated_urdf
from carm_kin.errors import InputError
from carm_kin.machine.chain import chain_of, nominal_geometry
from helpers.chained import (
    ARM_AXES,
    ARM_JOINTS,
    BIPLANE,
    C_ARM,
    C_JOINTS,
    LIFTS,
    PLANAR,
    SHIFT,
    SIGMA_R,
    SIGMA_T,
    TURN,
    arm,
    arm_recording,
    c_arm_recording,
    c_arm_sweeps,
    codes,
    kinematics,
    noisy,
    parsed,
    perturbed,
    poses_of,
    random_values,
    recorded,
    stand,
    swept,
)


def prediction(result, nominal: str, truth: str, base: np.ndarray, link: str, q) -> tuple[float, float]:
    """Errors an axis (m, rad) of the calibrated file and base at joint values q, by the text of the file alone."""
    text = calibrated_urdf(parsed(nominal), result.chain).data.decode()
    found = result.chain.bases[0].T_world_base @ kinematics(text, link, q)
    off = np.linalg.inv(found) @ base @ kinematics(truth, link, q)
    turn = Rotation.from_matrix(off[:, :3, :3]).magnitude()
    return float(np.sqrt((off[:, :3, 3] ** 2).mean())), float(np.sqrt((turn**2).mean() / 3))


@pytest.mark.parametrize("seed", range(4))
def test_an_arm_predicts_poses_that_it_was_not_given(seed):
    """Within 1.2 times the noise: the noise of a held-out pose and the error of the prediction together."""
    truth, base, recording, _ = arm_recording(seed)
    result = calibrate_chain(recording, parsed(arm()), **ARM_AXES)
    assert result.refusal is None
    t, w = prediction(result, arm(), truth, base, "tool", random_values(ARM_JOINTS, 200, seed + 1000))
    assert np.hypot(t, SIGMA_T) < 1.2 * SIGMA_T
    assert np.hypot(w, SIGMA_R) < 1.2 * SIGMA_R
    assert sum(len(joint.estimated) for joint in result.chain.joints) == 4 * 6 + 6 - 12
    assert result.noise.translation_m == pytest.approx(SIGMA_T, rel=0.15)  # 570 degrees of freedom: 3% one sigma
    assert result.noise.rotation_rad == pytest.approx(SIGMA_R, rel=0.15)
    assert result.chain.nominal.translation_rms_m > 4 * result.chain.calibrated.translation_rms_m
    assert result.chain.calibrated.translation_rms_m == pytest.approx(np.sqrt(3) * SIGMA_T, rel=0.2)


def test_an_arm_without_noise_is_found_exactly():
    truth, base, recording, _ = arm_recording(5, noise=False)
    result = calibrate_chain(recording, parsed(arm()), **ARM_AXES, sigma_reading_rad=0.0)
    t, w = prediction(result, arm(), truth, base, "tool", random_values(ARM_JOINTS, 50, 6))
    assert max(t, w) < 1e-9


@pytest.mark.parametrize("unread", [["j1"], ["j4"], ["j5", "j6"]])
def test_joints_that_nobody_reads(unread):
    """Their values are unknown at every pose; all but their zeros is told."""
    truth, _, recording, _ = arm_recording(8)
    blank = {name: np.full(100, np.nan) for name in unread}
    result = calibrate_chain(
        recorded(poses_of(recording), joints={**recording.joints, **blank}), parsed(arm()), **ARM_AXES
    )
    assert result.refusal is None
    assert result.noise.translation_m == pytest.approx(SIGMA_T, rel=0.2)
    assert sum(len(joint.estimated) for joint in result.chain.joints) <= 4 * 6 + 6 - 12
    g = nominal_geometry(chain_of(parsed(truth), "tool", "j1", "j2"))
    if unread == ["j1"]:  # a zero of j1 turns the base alone
        assert (np.abs(result.offset_sensor_pivot_m - g.offset) < 5 * result.sigma.offset_sensor_pivot_m).all()


def test_two_joints_near_the_base_that_nobody_reads_are_refused():
    """The start has nothing to go by; it says so instead of trying every pose as a place of its own."""
    recording = arm_recording(8)[2]
    joints = {name: values for name, values in recording.joints.items() if name not in ("j1", "j2")}
    result = calibrate_chain(recorded(poses_of(recording), joints=joints), parsed(arm()), **ARM_AXES)
    assert result.status == "refused"


@pytest.mark.parametrize("share", [0.2, 0.4])
def test_gross_outliers_of_an_arm_are_listed(share):
    truth, base, recording, gross = arm_recording(7, outliers=share, sigma_q=np.radians(0.02))
    result = calibrate_chain(recording, parsed(arm()), **ARM_AXES)
    assert result.outliers.indices == tuple(np.flatnonzero(gross))
    assert result.outliers.count == len(result.outliers.indices) == round(100 * share)
    assert "many_rejected" in codes(result)
    t, w = prediction(result, arm(), truth, base, "tool", random_values(ARM_JOINTS, 100, 8))
    assert t < SIGMA_T
    assert w < SIGMA_R


def test_noise_of_the_readings_is_estimated():
    ratios = []
    for seed in range(6):
        _, _, recording, _ = arm_recording(seed, sigma_q=np.radians(0.1))
        ratios.append(calibrate_chain(recording, parsed(arm()), **ARM_AXES).chain.reading_sigma_rad / np.radians(0.1))
    assert np.mean(ratios) == pytest.approx(1, abs=0.05)  # some 200 degrees of freedom each: 2% one sigma


# --- the two-axis machine -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("urdf", ["mobile_nonisocentric", "mobile_skewed", "mobile_isocentric"])
@pytest.mark.parametrize("labels", [True, False])
def test_agrees_with_the_two_axis_solver_without_noise(urdf, labels):
    recording, truth = carm_kin.simulate(urdf, "clinical" if labels else "free", labels=labels)
    recording = recording.select(slice(None, None, 5))
    chain, two_axes = calibrate_chain(recording, urdf), carm_kin.calibrate(recording)
    for result in (chain, two_axes):
        np.testing.assert_allclose(result.offset_sensor_pivot_m, truth.offset_sensor_pivot_m, atol=1e-9)
        assert result.major_radius_m == pytest.approx(truth.major_radius_m, abs=1e-9)
    centres = [result.placements[0].torus_center_world_m for result in (chain, two_axes)]
    np.testing.assert_allclose(*centres, atol=1e-9)


@pytest.mark.parametrize("labels", [True, False])
@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_agrees_with_the_two_axis_solver_to_a_tenth_of_a_sigma(labels, outliers):
    noise = {"sigma_t_m": 0.5e-3, "sigma_r_rad": 2e-3, "outliers": outliers}
    recording, _ = carm_kin.simulate("mobile_skewed", "clinical", labels=labels, seed=3, **noise)
    chain = calibrate_chain(recording, "mobile_nonisocentric")
    two_axes = carm_kin.calibrate(recording, sigma_label_rad=0.0, systematic="none")  # as the chain takes them
    off = chain.offset_sensor_pivot_m - two_axes.offset_sensor_pivot_m
    assert (np.abs(off) < 0.1 * two_axes.sigma.offset_sensor_pivot_m).all()
    assert abs(chain.major_radius_m - two_axes.major_radius_m) < 0.1 * two_axes.sigma.major_radius_m
    skew = chain.axis_non_orthogonality_rad, two_axes.axis_non_orthogonality_rad
    assert abs(abs(skew[0]) - abs(skew[1])) < 0.1 * two_axes.sigma.axis_non_orthogonality_rad
    centre = chain.placements[0].torus_center_world_m - two_axes.placements[0].torus_center_world_m
    assert (np.abs(centre) < 0.1 * two_axes.sigma.placements[0].torus_center_world_m).all()
    np.testing.assert_allclose(chain.sigma.offset_sensor_pivot_m, two_axes.sigma.offset_sensor_pivot_m, rtol=0.02)
    assert chain.sigma.major_radius_m == pytest.approx(two_axes.sigma.major_radius_m, rel=0.02)
    assert chain.noise.translation_m == pytest.approx(two_axes.noise.translation_m, rel=0.01)
    assert chain.outliers.indices == two_axes.outliers.indices


def offset_errors(result, truth: str) -> tuple[np.ndarray, float]:
    """Offset and major radius less the truth, m."""
    g = nominal_geometry(chain_of(parsed(truth)))
    return result.offset_sensor_pivot_m - g.offset, result.major_radius_m - abs(g.major_radius)


KNOWN = {
    "labels": {"held": C_JOINTS},
    "no labels": {},
    "neither labels nor sweeps": {"labels": False},
    "labels and readings": {"held": C_JOINTS, "moving": ("angular", "orbital"), "sigma_q": 2e-3},
    "lift known but where it moves": {"held": C_JOINTS, "lifts": LIFTS},
    "lift known throughout": {"held": C_JOINTS, "moving": ("lift",), "lifts": LIFTS},
    "lift unknown throughout": {"held": ("angular", "orbital"), "lifts": LIFTS},
}


@pytest.mark.parametrize("name", KNOWN)
def test_whatever_is_known_of_the_joints(name):
    """Exact without noise, within 5 sigma with noise, outliers found."""
    truth, _, recording, _ = c_arm_recording(1, **{**KNOWN[name], "sigma_q": 0.0}, noise=0.0)
    exact = calibrate_chain(recording, parsed(C_ARM))
    off, R = offset_errors(exact, truth)
    assert max(*np.abs(off), abs(R)) < 1e-7
    truth, _, recording, gross = c_arm_recording(2, **KNOWN[name], outliers=0.2)
    result = calibrate_chain(recording, parsed(C_ARM))
    off, R = offset_errors(result, truth)
    assert (np.abs(off) < 5 * result.sigma.offset_sensor_pivot_m).all()
    assert abs(R) < 5 * result.sigma.major_radius_m
    assert result.outliers.indices == tuple(np.flatnonzero(gross))
    assert result.noise.translation_m == pytest.approx(SIGMA_T, rel=0.2)
    assert "far_from_nominal" not in codes(result) | codes(exact)  # the senses of the axes are the URDF's


@pytest.mark.parametrize("height", ["0.1", "-0.1"])
def test_senses_that_no_label_tells_are_those_of_the_urdf(height):
    """The orbital axis above or below the angular one: the two differ in the sense of one axis."""
    text = C_ARM.replace('xyz="0.8 0.02 0.1"', f'xyz="0.8 0.02 {height}"')
    truth, q = perturbed(text, SHIFT, TURN, 5), random_values(["angular", "orbital"], 80, 5)
    T = noisy(stand(5) @ kinematics(truth, "sensor", q), SIGMA_T, SIGMA_R, 5)
    result = calibrate_chain(recorded(T), parsed(text))
    assert "far_from_nominal" not in codes(result)
    assert result.major_radius_signed_m * float(height) > 0


def test_one_label_a_sweep_is_enough():
    recording = c_arm_recording(3, C_JOINTS)[2]
    first = np.isin(np.arange(len(recording)), [sweep.poses[0] for sweep in recording.sweeps])
    sparse = replace(recording, joints={k: np.where(first, v, np.nan) for k, v in recording.joints.items()})
    results = [calibrate_chain(given, parsed(C_ARM)) for given in (recording, sparse)]
    np.testing.assert_array_equal(*(result.offset_sensor_pivot_m for result in results))


def test_unknown_held_values_of_two_recordings_are_apart():
    """Their sweeps have the same labels and other angles."""
    truth, parts = perturbed(C_ARM, SHIFT, TURN, 4), []
    for k, (alpha, beta) in enumerate([(-1.0, 0.5), (0.7, -0.3)]):
        path = np.radians(np.arange(-60, 61, 5))
        sweeps = swept(*(("orbital", path, {"angular": a}) for a in (alpha, 0.2)), ("angular", path, {"orbital": beta}))
        T = stand(k) @ kinematics(truth, "sensor", sweeps.q)
        parts.append(recorded(T, sweep=sweeps.sweep, moving=sweeps.moving))
    off, R = offset_errors(calibrate_chain(parts, parsed(C_ARM)), truth)
    assert max(*np.abs(off), abs(R)) < 1e-7


def test_held_values_that_nobody_knows_come_out_right():
    """The angles of the result are the true ones but for a common zero."""
    _, _, recording, _ = c_arm_recording(3, noise=0.0)
    swept = c_arm_sweeps()
    result = calibrate_chain(recording, parsed(C_ARM))
    for column, joint in enumerate(("angular", "orbital")):
        off = result.angles_rad[:, column] - swept.q[joint]
        flipped = result.angles_rad[:, column] + swept.q[joint]
        assert min(np.ptp(off), np.ptp(flipped)) < 1e-7


def test_gain_and_zero_of_a_reading():
    truth, base, q = arm(), stand(4), random_values(ARM_JOINTS, 80, 4)
    T = noisy(base @ kinematics(truth, "tool", q), SIGMA_T, SIGMA_R, 4)
    read = q | {"j3": q["j3"] / 1.02, "j4": q["j4"] - 0.03}
    free = FreeJoints(placements=("none",), zeros=("j3", "j4"), gains=("j3", "j4"))
    result = calibrate_chain(recorded(T, joints=read), parsed(arm()), free=free, **ARM_AXES)
    found = {joint.joint: joint for joint in result.chain.joints}
    assert set(found) == {"j3", "j4"}
    for name, gain, zero in (("j3", 0.02, 0.0), ("j4", 0.0, 0.03)):
        assert found[name].estimated == ("zero", "gain")
        assert found[name].gain == pytest.approx(gain, abs=5 * found[name].gain_sigma)
        assert found[name].zero_rad == pytest.approx(zero, abs=5 * found[name].zero_sigma_rad)
        assert 0 < found[name].gain_sigma < 2e-3
        assert 0 < found[name].zero_sigma_rad < 1e-3
        assert found[name].zero_m is None
    assert "gains_not_in_urdf" in codes(result)


# --- several sensors, placements and recordings -------------------------------------------------------------------


BIPLANE_JOINTS = ["f_angular", "f_orbital", "l_angular", "l_orbital"]


def biplane(seed: int, base: np.ndarray, n: int = 60, noise: float = 1.0):
    """The true machine, its joint values, the poses of the frontal sensor and of the lateral one."""
    truth, q = perturbed(BIPLANE, SHIFT, TURN, 1), random_values(BIPLANE_JOINTS, n, seed)
    poses = (base @ kinematics(truth, link, q) for link in ("frontal", "lateral"))
    return truth, q, *(noisy(T, noise * SIGMA_T, noise * SIGMA_R, seed) for T in poses)


def test_two_sensors_on_two_branches_in_one_recording():
    base = stand(1)
    truth, q, frontal, lateral = biplane(1, base, noise=0.0)
    named = np.array(["frontal", "lateral"] * 30)
    T = np.where((named == "frontal")[:, None, None], frontal, lateral)
    urdf = parsed(BIPLANE)
    result = calibrate_chain(recorded(T, joints=q, metadata={"sensor": named}), urdf, sigma_reading_rad=0.0)
    assert [sensor.link for sensor in result.chain.sensors] == ["frontal", "lateral"]
    text = calibrated_urdf(urdf, result.chain).data.decode()
    again = random_values(BIPLANE_JOINTS, 20, 9)
    for sensor in result.chain.sensors:
        g = nominal_geometry(chain_of(parsed(truth), sensor.link))
        np.testing.assert_allclose(sensor.offset_sensor_pivot_m, g.offset, atol=1e-9)
        assert sensor.major_radius_m == pytest.approx(abs(g.major_radius), abs=1e-9)
        found = result.chain.bases[0].T_world_base @ kinematics(text, sensor.link, again)
        np.testing.assert_allclose(found, base @ kinematics(truth, sensor.link, again), atol=1e-9)


def test_several_recordings_share_a_placement_by_its_label():
    """Each recording has one sensor; the label that both have makes their bases one."""
    _, q, frontal, lateral = biplane(2, stand(2))
    label, n = np.full(60, "room"), 60
    parts = [
        recorded(T, joints=q, placement=label, metadata={"sensor": np.full(n, link)})
        for T, link in ((frontal, "frontal"), (lateral, "lateral"))
    ]
    result = calibrate_chain(parts, parsed(BIPLANE))
    assert result.refusal is None
    assert [base.label for base in result.chain.bases] == ["room"]
    assert result.poses == 120
    assert result.noise.translation_m == pytest.approx(SIGMA_T, rel=0.15)


def test_recordings_of_one_machine_at_two_places():
    """Without labels each recording has a base of its own, and the machine follows from both together."""
    parts, bases = [], [stand(11), stand(12)]
    truth = perturbed(arm(), SHIFT, TURN, 3)
    for k, base in enumerate(bases):
        q = random_values(ARM_JOINTS, 60, k)
        T = noisy(base @ kinematics(truth, "tool", q), SIGMA_T, SIGMA_R, k)
        parts.append(recorded(T, joints=q))
    both = calibrate_chain(parts, parsed(arm()), **ARM_AXES)
    alone = calibrate_chain(parts[0], parsed(arm()), **ARM_AXES)
    assert [base.label for base in both.chain.bases] == ["1", "2"]
    assert len(both.placements) == 2
    text = calibrated_urdf(parsed(arm()), both.chain).data.decode()
    again = random_values(ARM_JOINTS, 50, 77)
    for found, base in zip(both.chain.bases, bases, strict=True):
        off = (
            np.linalg.inv(found.T_world_base @ kinematics(text, "tool", again))
            @ base
            @ kinematics(truth, "tool", again)
        )
        assert np.sqrt((off[:, :3, 3] ** 2).mean()) < SIGMA_T
    assert (both.sigma.offset_sensor_pivot_m < alone.sigma.offset_sensor_pivot_m).all()


def test_a_planar_joint_is_calibrated_through_its_one_origin():
    names = ["cart_x", "cart_y", "cart_yaw", "angular", "orbital"]
    truth, base, q = perturbed(PLANAR, SHIFT, TURN, 2), stand(5), random_values(names, 60, 5)
    T = base @ kinematics(truth, "c", q) @ stand(6, 0.3)
    known = {"sensor_link": "c", "sigma_reading_rad": 0.0, "sigma_reading_m": 0.0}
    recording = recorded(T, joints=q, prismatic=frozenset({"cart_x", "cart_y"}))
    result = calibrate_chain(recording, parsed(PLANAR), **known)
    assert {joint.joint for joint in result.chain.joints} <= {"cart_x", "angular", "orbital"}
    text = calibrated_urdf(parsed(PLANAR), result.chain).data.decode()
    found = result.chain.bases[0].T_world_base @ kinematics(text, "sensor", q)
    np.testing.assert_allclose(found, T, atol=1e-9)
    with pytest.raises(InputError, match="cart_y"):
        calibrate_chain(recording, parsed(PLANAR), free=FreeJoints(("cart_y",)), **known)


# --- held-out poses -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("known", [C_JOINTS, ()])
def test_held_out_errors_are_those_of_the_noise(known):
    """Also where no label tells the zeros of the angles, which then are those of the fit to all poses."""
    _, _, recording, _ = c_arm_recording(5, known)
    found = calibrate_chain(recording, parsed(C_ARM), folds=5).cross_validation
    assert [row.refusal for row in found.per_fold] == [None] * 5
    assert found.overall.poses == len(recording)
    assert found.overall.chi2_per_dof == pytest.approx(1, abs=0.25)  # 5 sigma of 500 degrees of freedom, and the fit's


def test_held_out_arm():
    _, _, recording, _ = arm_recording(2)
    found = calibrate_chain(recording, parsed(arm()), **ARM_AXES, sigma_reading_rad=0.0, folds=4).cross_validation
    assert found.overall.chi2_per_dof == pytest.approx(1.05, abs=0.3)
    assert found.overall.translation_rms_m == pytest.approx(np.sqrt(3) * SIGMA_T, rel=0.25)


def test_a_fold_without_which_a_placement_is_gone_is_refused():
    _, _, recording, _ = c_arm_recording(6, C_JOINTS)
    placement = np.where(recording.sweep == "s4", "B", "A")
    moved = recorded(
        poses_of(recording),
        joints=recording.joints,
        sweep=recording.sweep,
        moving=recording.moving,
        placement=placement,
        prismatic=frozenset({"lift"}),
    )
    rows = calibrate_chain(moved, parsed(C_ARM), folds=5).cross_validation.per_fold
    refused = [row for row in rows if "s4" in row.sweeps]
    assert [row.refusal.code for row in refused] == ["unobservable"]
    assert sum(row.refusal is not None for row in rows) < 5
