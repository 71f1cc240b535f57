"""The chain's poses, angles, symmetries and zeros against rotations about two lines in space."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.simulated import Machine, joined, machine, problem, small, sweeps_deg, wandering
from solvers.problem import Problem
from solvers.torus import Axes, surface_point

SIGNS = [(1, 1), (1, -1), (-1, 1), (-1, -1)]


def axes_of(truth: Machine, angular: int = 1, orbital: int = 1) -> Axes:
    """The two lines of the truth with the direction of each as told."""
    sign = angular * orbital
    return Axes(truth.center, angular * truth.n, sign * truth.R, sign * truth.epsilon, truth.offset, orbital * truth.a)


def cosines_and_sines(angle):
    return np.stack([np.cos(angle), np.sin(angle)])


def poses_agree(axes: Axes, data: Problem, tolerance: float = 1e-12):
    torus = axes.torus(data)
    T = torus.poses(torus.angles(data), data.placement)
    np.testing.assert_allclose(T[:, :3, 3], data.p_world_sensor, atol=tolerance)
    np.testing.assert_allclose(T[:, :3, :3], data.R_world_sensor, atol=tolerance)
    return torus


def same_as_truth(torus, truth: Machine, tolerance: float = 1e-12):
    np.testing.assert_allclose(torus.T_world_torus, truth.T_world_torus, atol=tolerance)
    np.testing.assert_allclose(torus.T_sensor_carm, truth.T_sensor_carm, atol=tolerance)
    assert torus.major_radius == pytest.approx(truth.R, abs=tolerance)
    assert torus.non_orthogonality == pytest.approx(truth.epsilon, abs=tolerance)
    assert torus.referenced.all()
    assert torus.orbital_referenced


def test_a_pose_by_hand():
    # torus frame = world; alpha = 90 deg turns z into -y; the sensor stands 0.7 m along the carm's z
    sensor_in_carm = np.eye(4)
    sensor_in_carm[2, 3] = 0.7
    torus = Machine(np.eye(4)[None], 0.1, 0.0, np.linalg.inv(sensor_in_carm)).torus()
    quarter = np.pi / 2
    T = torus.poses(np.array([[0, 0], [quarter, 0], [0, quarter], [quarter, quarter]]), np.zeros(4, dtype=int))
    np.testing.assert_allclose(T[:, :3, 3], [[0, 0, 0.8], [0, -0.8, 0], [0.7, 0, 0.1], [0.7, -0.1, 0]], atol=1e-15)
    np.testing.assert_allclose(T[3, :3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-15)


def test_non_orthogonality_opens_the_angle_between_the_axes():
    truth = machine(1, epsilon=0.01)
    axis = truth.torus().poses(np.zeros((1, 2)), np.zeros(1, dtype=int))[0, :3, :3] @ truth.a
    assert np.arccos(axis @ truth.n[0]) == pytest.approx(np.pi / 2 + 0.01, abs=1e-12)


@given(st.integers(0, 1000), st.sampled_from([0.1, -0.1, 0.0, 1e-3, 0.9]), st.sampled_from([0.0, 0.01, -0.3]))
@settings(max_examples=30)
def test_poses_are_rotations_about_two_lines(seed, R, epsilon):
    truth = machine(seed, R, epsilon, placements=2)
    motion = joined(wandering(10, seed), wandering(10, seed + 1, placement=1))
    p, orientation = truth.poses(motion.angles, motion.placement)
    T = truth.torus().poses(motion.angles, motion.placement)
    np.testing.assert_allclose(T[:, :3, 3], p, atol=1e-13)
    np.testing.assert_allclose(T[:, :3, :3], orientation, atol=1e-13)
    np.testing.assert_array_equal(T[:, 3], np.tile([0, 0, 0, 1], (20, 1)))


@given(st.integers(0, 1000), st.sampled_from([0.1, -0.1, 0.0]), st.sampled_from([0.0, 0.01, -0.3]))
@settings(max_examples=30)
def test_angles_come_back_from_the_orientations(seed, R, epsilon):
    truth = machine(seed, R, epsilon, placements=2)
    motion = joined(wandering(10, seed), wandering(10, seed + 1, placement=1))
    found = truth.torus().angles(problem(truth, motion))
    np.testing.assert_allclose(cosines_and_sines(found), cosines_and_sines(motion.angles), atol=1e-12)


def test_the_properties_of_a_torus_are_what_the_poses_show():
    truth = machine(2, 0.1, 0.02, placements=2)
    torus = truth.torus()
    turn = np.linspace(0, 2 * np.pi, 5)[:-1]
    for k in range(2):
        p, R = truth.poses(np.column_stack([np.full(4, 0.3), turn]), k)
        pivot = p + R @ torus.offset
        np.testing.assert_allclose(pivot, np.tile(pivot[0], (4, 1)), atol=1e-13)  # an orbital sweep leaves it still
        assert np.linalg.norm(pivot[0] - torus.center[k]) == pytest.approx(0.1, abs=1e-13)
        assert (pivot[0] - torus.center[k]) @ torus.angular_axis[k] == pytest.approx(0, abs=1e-13)
        np.testing.assert_allclose(R @ torus.orbital_axis, np.tile(R[0] @ torus.orbital_axis, (4, 1)), atol=1e-13)
        orbit = p - p.mean(axis=0)  # four quarters: the mean is the orbit's centre
        np.testing.assert_allclose(np.linalg.norm(orbit, axis=1), torus.minor_radius, atol=1e-13)


@pytest.mark.parametrize("signs", SIGNS)
@pytest.mark.parametrize("R", [0.1, -0.1, 0.0])
def test_the_four_directions_of_the_axes_are_one_machine(signs, R):
    truth = machine(3, R, 0.02, placements=2)
    motion = joined(wandering(10), wandering(10, 1, placement=1))
    torus = poses_agree(axes_of(truth).turned(*signs), problem(truth, motion))
    assert torus.major_radius == pytest.approx(abs(R), abs=1e-15)
    assert not torus.referenced.any()
    assert not torus.orbital_referenced
    if R:
        assert torus.non_orthogonality == pytest.approx(np.sign(R) * 0.02, abs=1e-15)


@pytest.mark.parametrize("signs", SIGNS)
def test_turning_twice_is_no_turn(signs):
    axes = axes_of(machine(4, 0.1, 0.02))
    twice = axes.turned(*signs).turned(*signs)
    for name in ("center", "angular_axis", "major_radius", "non_orthogonality", "offset", "orbital_axis"):
        np.testing.assert_array_equal(getattr(twice, name), getattr(axes, name))


def test_without_labels_the_first_pose_stands_at_zero_and_the_directions_are_one_choice():
    truth = machine(5, 0.1, 0.02)
    data = problem(truth, wandering(15))
    tori = [poses_agree(axes_of(truth, *signs), data) for signs in SIGNS]
    for torus in tori:
        np.testing.assert_allclose(torus.angles(data)[0], 0, atol=1e-12)
        np.testing.assert_allclose(torus.T_world_torus, tori[0].T_world_torus, atol=1e-12)
        np.testing.assert_allclose(torus.T_sensor_carm, tori[0].T_sensor_carm, atol=1e-12)


@given(
    st.integers(0, 1000),
    st.sampled_from(SIGNS),
    st.sampled_from([0.1, -0.1, 0.0]),
    st.lists(st.floats(-175, 175), min_size=3, max_size=4, unique_by=lambda x: round(x / 20)),
    st.lists(st.floats(-175, 175), min_size=3, max_size=4, unique_by=lambda x: round(x / 20)),
)
@settings(max_examples=60)
def test_labels_at_any_angles_give_zeros_and_directions(seed, signs, R, alphas, betas):
    path = np.arange(0, 100, 25)
    if not (distinct(alphas) and distinct(betas)):
        return
    truth = machine(seed, R, 0.02)
    data = problem(truth, sweeps_deg(alphas, path, betas, path))
    same_as_truth(axes_of(truth, *signs).torus(data), truth)


def distinct(angles_deg) -> bool:
    """Whether no mirror image of the labels, turned by any angle, gives nearly the same labels."""
    x = np.exp(1j * np.radians(angles_deg))
    return abs((x**2).sum()) < 0.99 * len(x)


@pytest.mark.parametrize("signs", SIGNS)
@pytest.mark.parametrize("R", [0.1, -0.1])
def test_labels_of_two_placements_agree_on_the_directions(signs, R):
    truth = machine(6, R, 0.02, placements=2)
    path = np.arange(0, 100, 25)
    motion = joined(sweeps_deg((-60, 0, 40), path, (10, 80), path), sweeps_deg((20,), path, (10,), path, placement=1))
    same_as_truth(axes_of(truth, *signs).torus(problem(truth, motion)), truth)


@pytest.mark.parametrize("signs", SIGNS)
@pytest.mark.parametrize("joint", [0, 1])
def test_labels_of_one_joint_fix_it_and_leave_the_other_to_the_convention(signs, joint):
    truth = machine(7, 0.1, 0.02)
    motion = sweeps_deg((-60, 0, 40), np.arange(0, 100, 25), (10, 50, 80), np.arange(0, 100, 25))
    label = motion.label.copy()
    label[:, 1 - joint] = np.nan
    data = problem(truth, replace(motion, label=label))
    torus = poses_agree(axes_of(truth, *signs), data)
    assert torus.referenced.all() == (joint == 0)
    assert torus.orbital_referenced == (joint == 1)
    assert torus.major_radius == pytest.approx(0.1, abs=1e-12)
    np.testing.assert_allclose(torus.angular_axis, truth.n, atol=1e-12)
    np.testing.assert_allclose(torus.orbital_axis, truth.a, atol=1e-12)
    found = torus.angles(data)
    np.testing.assert_allclose(
        cosines_and_sines(found[:, joint]), cosines_and_sines(motion.angles[:, joint]), atol=1e-9
    )
    assert found[0, 1 - joint] == pytest.approx(0, abs=1e-12)


def test_a_placement_without_labels_is_not_called_referenced():
    truth = machine(8, 0.1, placements=2)
    motion = joined(small(), wandering(10, placement=1))
    torus = poses_agree(axes_of(truth), problem(truth, motion))
    assert torus.referenced.tolist() == [True, False]
    assert torus.orbital_referenced


@pytest.mark.parametrize(
    ("R", "alphas", "betas"),
    [
        (0.1, (30,), (40,)),
        (0.1, (0,), (0,)),
        (0.1, (-90, 90), ()),
        (0.0, (30,), (0, 30, 80)),
        (0.0, (-90, 90), (0, 30, 80)),
    ],
)
def test_what_labels_leave_open_is_not_called_referenced(R, alphas, betas):
    # One angle, or two that are half a turn apart, suit the reversed axis with another zero as well. Where
    # the other joint tells its direction, R >= 0 tells this one's; at R = 0 nothing does.
    path = np.arange(0, 360, 30)
    for seed in range(6):
        truth = machine(seed, R)
        data = problem(truth, sweeps_deg(alphas, path, betas, path))
        torus = axes_of(truth, *SIGNS[seed % 4]).torus(data)
        right = np.allclose(torus.T_world_torus, truth.T_world_torus, atol=1e-6)
        assert right or not torus.referenced.all(), f"seed {seed}: a guess is called referenced"


@pytest.mark.parametrize("signs", SIGNS)
@pytest.mark.parametrize("alphas", [(30,), (-90, 90)])
def test_the_other_joint_and_the_radius_tell_the_direction_that_labels_leave_open(signs, alphas):
    truth = machine(9, 0.1, 0.02)
    path = np.arange(0, 360, 30)
    data = problem(truth, sweeps_deg(alphas, path, (0, 30, 80), path))
    same_as_truth(axes_of(truth, *signs).torus(data), truth)


@given(st.integers(0, 1000), st.sampled_from([0.1, 0.0, 0.5, 0.9, -0.1]), st.floats(-3, 3))
@settings(max_examples=30)
def test_surface_points_are_where_the_sensor_goes(seed, R, gamma):
    # b = 0.7: a spindle torus for R < b (u changes its sign, where Eq. 5 of the paper breaks down), a ring above
    b, t_y = 0.7, 0.2
    sensor = (b * np.sin(gamma), t_y, b * np.cos(gamma))
    truth = replace(machine(seed, R, sensor_in_carm=sensor), T_world_torus=np.eye(4)[None])
    angles = wandering(40, seed).angles
    crossing = np.arccos(-R / b) - gamma if abs(R) < b else 0.0
    angles = np.concatenate([angles, [[0.3, crossing], [0.3, crossing + 1e-9]]])
    np.testing.assert_allclose(surface_point(angles, R, b, gamma, t_y), truth.poses(angles)[0], atol=1e-13)
