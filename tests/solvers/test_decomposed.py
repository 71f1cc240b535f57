"""The paper's decomposition: exact for any known labels, robust against outliers, clear about what it needs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from helpers.simulated import (
    Machine,
    joined,
    line_angle,
    machine,
    paper,
    problem,
    shuffled,
    small,
    sweeps_deg,
    wandering,
)
from solvers import decomposed
from solvers.decomposed import Options, has_sweeps

TURN = np.arange(0, 360, 20)
PLAIN = Options(iterations=0)


def close(estimate, truth: Machine, tolerance=1e-9):
    np.testing.assert_allclose(estimate.offset, truth.offset, atol=tolerance)
    np.testing.assert_allclose(estimate.center, truth.center, atol=tolerance)
    assert abs(estimate.major_radius) == pytest.approx(abs(truth.R), abs=tolerance)
    assert estimate.minor_radius == pytest.approx(truth.b, abs=tolerance)
    assert line_angle(estimate.torus.orbital_axis, truth.a) < tolerance
    for k in range(len(truth.center)):
        assert line_angle(estimate.angular_axis[k], truth.n[k]) < tolerance


@pytest.mark.parametrize("R", [0.1, 0.0, 0.9])
@pytest.mark.parametrize("iterations", [0, 500])
def test_exact_on_the_papers_protocol(R, iterations):
    truth = machine(1, R)
    estimate = decomposed.solve(problem(truth, paper()), Options(iterations=iterations))
    close(estimate, truth)
    np.testing.assert_allclose(estimate.torus.T_world_torus, truth.T_world_torus, atol=1e-8)
    np.testing.assert_allclose(estimate.torus.T_sensor_carm, truth.T_sensor_carm, atol=1e-8)


@given(
    st.integers(0, 10_000),
    st.sampled_from([0.1, 0.0, 0.9]),
    st.lists(st.floats(-170, 170), min_size=1, max_size=4),
    st.lists(st.floats(-170, 170), min_size=1, max_size=3),
    st.sampled_from([TURN, np.arange(0, 100, 8), np.arange(-30, 60, 10)]),
)
@settings(max_examples=30)
def test_exact_for_sweeps_at_any_angles(seed, R, alphas, betas, path):
    truth = machine(seed, R)
    data = problem(truth, sweeps_deg(alphas, path, betas, path))
    for options in (PLAIN, Options(iterations=20)):
        close(decomposed.solve(shuffled(data, seed), options), truth, 1e-7)


def test_the_labels_set_the_zeros():
    truth = machine(2, 0.1)
    motion = sweeps_deg((-37, 12, 65), TURN, (5, 50, 81), TURN)
    estimate = decomposed.solve(problem(truth, motion))
    np.testing.assert_allclose(estimate.torus.T_world_torus, truth.T_world_torus, atol=1e-9)
    np.testing.assert_allclose(estimate.torus.T_sensor_carm, truth.T_sensor_carm, atol=1e-9)
    close(decomposed.solve(problem(truth, motion.without_labels())), truth)  # and are not needed for the rest


@pytest.mark.parametrize("alphas", [(-37, 12, 65), (20,)])
def test_no_labels_of_alpha(alphas):
    truth = machine(3, 0.1)
    motion = sweeps_deg(alphas, TURN, (5, 50, 81), TURN)
    label = motion.label.copy()
    label[:, 0] = np.nan
    estimate = decomposed.solve(problem(truth, replace(motion, label=label)))
    close(estimate, truth)
    assert not estimate.torus.referenced.any()
    assert estimate.torus.orbital_referenced
    np.testing.assert_allclose(estimate.torus.T_sensor_carm, truth.T_sensor_carm, atol=1e-9)


@pytest.mark.parametrize("R", [0.1, 0.0])
@pytest.mark.parametrize("epsilon", [0.01, -0.02])
def test_epsilon(R, epsilon):
    truth = machine(4, R, epsilon)
    data = problem(truth, small())
    estimate = decomposed.solve(data, Options(fix_non_orthogonality=False, iterations=0))
    close(estimate, truth)
    assert estimate.torus.non_orthogonality == pytest.approx(epsilon, abs=1e-9)
    assert decomposed.solve(data, PLAIN).torus.non_orthogonality == 0


@pytest.mark.parametrize("R", [0.1, 0.0])
@pytest.mark.parametrize("seed", range(8))
def test_two_placements(R, seed):
    # every placement finds the directions of its axes anew, with signs of its own
    truth = machine(seed, R, 0.0, 2)
    motion = joined(small(), sweeps_deg((-40, 30), TURN, (60,), TURN, placement=1))
    for options in (PLAIN, Options(iterations=50)):
        close(decomposed.solve(shuffled(problem(truth, motion)), options), truth)


def test_noise_makes_errors_of_its_own_size():
    # 420 poses of 1 mm and 1 mrad: the offset is an average over lengths below 1 m of mrad-sized errors
    truth = machine(6, 0.1)
    motion = sweeps_deg((-90, -45, 0, 45, 90), TURN[::2], (0, 40, 80), TURN[::2])
    error = [
        np.linalg.norm(decomposed.solve(problem(truth, motion, 1e-3, 1e-3, seed), PLAIN).offset - truth.offset)
        for seed in range(20)
    ]
    assert np.sqrt(np.mean(np.square(error))) < 2e-3


@pytest.mark.parametrize("width", [None, 6e-3])
def test_a_fifth_of_gross_outliers(width):
    # the median of 10 recordings each: the clean error is its own yardstick, "a few times" is three
    truth = machine(7, 0.1)
    turn = np.arange(0, 360, 10)
    motion = sweeps_deg((-90, -45, 0, 45, 90), turn, (0, 40, 80), turn)
    clean, dirty, naive = [], [], []
    for seed in range(10):
        data = problem(truth, motion, 1e-3, 1e-3, seed)
        rng = np.random.default_rng(seed)
        bad = rng.permutation(len(data))[: len(data) // 5]
        p, R = data.p_world_sensor.copy(), data.R_world_sensor.copy()
        direction = rng.normal(size=(len(bad), 3))
        p[bad] += direction / np.linalg.norm(direction, axis=1)[:, None] * rng.uniform(0.05, 0.5, (len(bad), 1))
        R[bad] = Rotation.random(len(bad), random_state=seed).as_matrix()
        broken = replace(data, p_world_sensor=p, R_world_sensor=R)
        options = Options(inlier_width_m=width, seed=seed)
        for errors, given_data, chosen in ((clean, data, options), (dirty, broken, options), (naive, broken, PLAIN)):
            errors.append(np.linalg.norm(decomposed.solve(given_data, chosen).offset - truth.offset))
    assert np.median(dirty) < 3 * np.median(clean)
    assert np.max(dirty) < 6 * np.max(clean)
    assert np.median(naive) > 10 * np.median(clean)  # so the outliers do matter


def test_a_sweep_of_two_poses_is_left_out():
    truth = machine(8, 0.1)
    motion = joined(small(), sweeps_deg((33,), (0, 90), (), ()))
    data = problem(truth, motion)
    p = data.p_world_sensor.copy()
    p[-2:] += 1.0
    for options in (PLAIN, Options(iterations=50)):
        close(decomposed.solve(replace(data, p_world_sensor=p), options), truth)


def test_poses_that_belong_to_no_sweep_are_left_out():
    truth = machine(9, 0.1)
    data = problem(truth, joined(small(), wandering(30)))
    p = data.p_world_sensor.copy()
    p[-30:] += 1.0
    close(decomposed.solve(replace(data, p_world_sensor=p), PLAIN), truth)


def test_has_sweeps():
    truth = machine(10, 0.1, 0.0, 2)

    def told(*motions) -> bool:
        return has_sweeps(problem(truth, joined(*motions)))

    orbital, angular = sweeps_deg((0, 20), TURN, (), ()), sweeps_deg((), (), (0,), TURN)
    assert told(orbital, angular)
    assert told(orbital.without_labels(), angular.without_labels())
    assert not told(orbital)
    assert not told(angular)
    assert not told(wandering(50))
    assert not told(orbital, sweeps_deg((), (), (0,), (0, 90)))
    assert told(orbital, sweeps_deg((), (), (0,), (0, 90, 180)))
    elsewhere = sweeps_deg((0,), TURN, (0,), TURN, placement=1)
    assert told(orbital, angular, elsewhere)
    assert not told(orbital, angular, wandering(10, placement=1))


@pytest.mark.parametrize("motion", [wandering(50), sweeps_deg((0, 20), TURN, (), ())], ids=["free", "orbital only"])
def test_what_is_missing_is_said(motion):
    with pytest.raises(ValueError, match="an angular and an orbital sweep"):
        decomposed.solve(problem(machine(11), motion))
