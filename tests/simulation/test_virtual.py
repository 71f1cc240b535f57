"""A robot that turns a C about virtual axes: its poses in closed form, its postures, and what it cannot do."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.errors import InputError
from carm_kin.machine.chain import chain_of
from carm_kin.machine.urdf import parse_urdf, read_urdf
from carm_kin.simulation.virtual import virtual_motions
from helpers.command import fails
from helpers.family import FILES, link_pose, rigid

ROBOT = FILES["robot_held"]


@pytest.fixture(scope="module")
def motions():
    urdf = read_urdf("robot_held")
    return virtual_motions(urdf, chain_of(urdf))[0]


def changed(*pairs: tuple[str, str]):
    text = ROBOT.read_text(encoding="utf-8")
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return parse_urdf(text.encode(), ROBOT)


def test_the_recording_is_that_of_a_c_that_turns_about_the_pivot():
    """Rx(alpha) Ry(beta) about the link `isocenter`, written with SciPy; the labels give the held angle."""
    recording, truth = carm_kin.simulate("robot_held", "virtual", seed=1)
    home = link_pose(ROBOT, "isocenter", {})
    T_world_base = truth.placements[0].T_world_torus @ np.linalg.inv(home)
    T_pivot_sensor = np.linalg.inv(home) @ link_pose(ROBOT, "sensor", {})
    assert [sweep.moving for sweep in recording.sweeps] == ["orbital"] * 5 + ["angular"] * 3
    held = [np.degrees(list(sweep.held.values())).tolist() for sweep in recording.sweeps]
    np.testing.assert_allclose(np.ravel(held), [-60, -30, 0, 30, 60, -22.5, 0, 22.5])
    for sweep, (value,) in zip(recording.sweeps, held, strict=True):
        most = 45 if sweep.moving == "orbital" else 60
        for pose, moved in zip(sweep.poses, range(-most, most + 1), strict=True):
            alpha, beta = (value, moved) if sweep.moving == "orbital" else (moved, value)
            turn = Rotation.from_euler("XY", [alpha, beta], degrees=True)
            T = T_world_base @ home @ rigid(turn) @ T_pivot_sensor
            np.testing.assert_allclose(recording.p_world_sensor[pose], T[:3, 3], atol=1e-8)
            np.testing.assert_allclose(recording.R_world_sensor[pose], T[:3, :3], atol=1e-8)


def test_the_truth_is_an_isocentric_machine():
    _, truth = carm_kin.simulate("robot_held", "virtual", seed=1)
    T_pivot_sensor = np.linalg.inv(link_pose(ROBOT, "isocenter", {})) @ link_pose(ROBOT, "sensor", {})
    assert (truth.major_radius_m, truth.axis_non_orthogonality_rad) == (0, 0)
    np.testing.assert_allclose(truth.T_sensor_carm, np.linalg.inv(T_pivot_sensor), atol=1e-12)
    assert truth.minor_radius_m == pytest.approx(np.hypot(0.07, 0.7))


def test_it_calibrates_like_any_other_c_arm():
    """Nine numbers, none of which exceeds 4.5 standard deviations but once in 10,000 programs."""
    recording, truth = carm_kin.simulate("robot_held", "virtual", sigma_t_m=3e-4, sigma_r_rad=1e-3, seed=2)
    result = carm_kin.calibrate(recording)
    for part in ("offset_sensor_pivot_m", "major_radius_m", "minor_radius_m", "axis_non_orthogonality_rad"):
        error = np.abs(getattr(result, part) - getattr(truth, part))
        assert np.all(error < 4.5 * getattr(result.sigma, part)), part
    sigma = result.sigma.placements[0].torus_center_world_m
    center = truth.placements[0].torus_center_world_m
    assert np.all(np.abs(result.placements[0].torus_center_world_m - center) < 4.5 * sigma)
    assert np.max(result.sigma.offset_sensor_pivot_m) < 1e-4


def test_the_robot_moves_smoothly_within_its_limits(motions):
    chain = chain_of(read_urdf("robot_held"))
    for motion in motions:
        assert np.abs(np.diff(motion.q, axis=0)).max() < np.radians(3)
        assert np.all((motion.q >= chain.lower) & (motion.q <= chain.upper))
    assert np.ptp(np.concatenate([motion.q for motion in motions]), axis=0).min() > np.radians(20)


@pytest.mark.parametrize(
    "limit, joint", [((1.1344640137963142, 0.35), "joint_2"), ((-1.2217304763960306, -0.01), "joint_2")]
)
def test_a_joint_at_its_limit_is_named_with_the_angles(limit, joint):
    old, new = limit
    key = "upper" if old > 0 else "lower"
    urdf = changed((f'{key}="{old}"', f'{key}="{new}"'))
    with pytest.raises(InputError, match=rf"angular -?\d+\.0 deg, orbital -?\d+\.0 deg needs joint '{joint}' beyond"):
        carm_kin.simulate(urdf, "virtual")


def test_a_posture_out_of_reach_is_named():
    urdf = changed(('<origin xyz="0.085 -0.69 0"', '<origin xyz="0.085 -2.69 0"'))
    with pytest.raises(InputError, match=r"at angular .* deg, orbital .* deg is out of reach; place the link"):
        carm_kin.simulate(urdf, "virtual")


def test_what_has_no_pivot_is_refused(tmp_path, capsys):
    message = fails(capsys, "simulate", "mobile_skewed", "--protocol", "virtual", "-o", tmp_path / "rec.csv")
    assert re.search(r"mobile_skewed\.urdf: protocol 'virtual' needs a link 'isocenter' on the C", message)
    ends = '<parent link="{}"/>\n    <child link="isocenter"/>'
    urdf = changed((ends.format("c_arm"), ends.format("link_5")))
    with pytest.raises(InputError, match="the link 'isocenter' is not fixed to the part that carries 'sensor'"):
        carm_kin.simulate(urdf, "virtual")


def test_a_chain_with_too_few_joints_is_out_of_reach():
    text = ROBOT.read_text(encoding="utf-8")
    text = re.sub(r'name="joint_([34])" type="revolute"', r'name="joint_\1" type="fixed"', text)
    with pytest.raises(InputError, match="out of reach"):
        carm_kin.simulate(parse_urdf(text.encode(), ROBOT), "virtual")
