"""The torus surface from positions alone."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.simulated import joined, line_angle, machine, problem, small, wandering
from solvers import surface
from solvers.problem import Problem


def positions(truth, motion, sigma_t=0.0, seed=0) -> Problem:
    return Problem.of_poses(problem(truth, motion, sigma_t, 0.0, seed).p_world_sensor, None)


SENSORS = {"usual": (0.2, 0.15, 0.7), "t_y = 0": (0.1, 0.0, 0.6), "t_y < 0": (0.0, -0.25, 0.65)}


@pytest.mark.parametrize("R", [1.2, 0.3, 0.1], ids=["ring", "spindle", "deep spindle"])
@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS.keys())
@pytest.mark.parametrize("motion", [small(), wandering(200, 1)], ids=["circles", "free"])
def test_exact_on_exact_data(R, sensor, motion):
    truth = machine(1, R, sensor_in_carm=sensor)
    estimate = surface.solve(positions(truth, motion))
    assert abs(estimate.major_radius) == pytest.approx(R, abs=1e-7)
    assert estimate.minor_radius == pytest.approx(np.hypot(sensor[0], sensor[2]), abs=1e-7)
    np.testing.assert_allclose(estimate.center, truth.center, atol=1e-7)
    assert line_angle(estimate.angular_axis[0], truth.n[0]) < 1e-7
    assert estimate.converged


@pytest.mark.parametrize("motion", [small(), wandering(200, 1)], ids=["circles", "free"])
def test_a_sphere_gives_its_centre_and_no_radius(motion):
    truth = machine(2, 0.0)
    estimate = surface.solve(positions(truth, motion))
    # |R| enters squared, so that rounding of 1e-16 shows in R as 1e-8 and the fit stops well before
    assert abs(estimate.major_radius) < 1e-4
    np.testing.assert_allclose(estimate.center, truth.center, atol=1e-6)


def test_a_sphere_is_said_to_be_one():
    estimate = surface.solve(positions(machine(2, 0.0), wandering(500, 1), 1e-3))
    assert "nearly_sphere" in [note.code for note in estimate.notes]
    assert not any(name.startswith(("major", "minor", "angular")) for name in estimate.covariance.names)
    ring = surface.solve(positions(machine(2, 1.2), wandering(500, 1), 1e-3))
    assert "nearly_sphere" not in [note.code for note in ring.notes]
    assert {"major_radius", "minor_radius", "angular_axis_world[0]_x"} <= set(ring.covariance.names)


@pytest.mark.parametrize("R", [1.2, 0.1, 0.0])
def test_the_offset_is_not_given_and_it_is_said(R):
    estimate = surface.solve(positions(machine(3, R), small()))
    assert estimate.offset is None
    assert estimate.torus is None
    assert "offset_not_determined" in [note.code for note in estimate.notes]
    assert not any(name.startswith(("offset", "orbital")) for name in estimate.covariance.names)


def test_orientations_are_not_looked_at():
    truth, motion = machine(4, 0.1), small()
    data = problem(truth, motion, 1e-3, 0.5)
    estimate, other = surface.solve(data), surface.solve(positions(truth, motion, 1e-3))
    np.testing.assert_array_equal(estimate.center, other.center)
    assert estimate.major_radius == other.major_radius


@pytest.mark.parametrize("R", [1.2, 0.15])
def test_uncertainty_over_many_runs(R):
    # 100 runs: mean square of the normalised errors 1 +- sqrt(2 / 100) = 0.14, 4 of these; the mean of their
    # estimated noise, of some 290 degrees of freedom each, is known to 0.5%
    truth, motion, runs = machine(5, R), wandering(300, 2), 100
    z, sigma = [], []
    for seed in range(runs):
        estimate = surface.solve(positions(truth, motion, 1e-3, seed))
        sign = np.sign(estimate.angular_axis[0] @ truth.n[0])
        error = [abs(estimate.major_radius) - R, estimate.minor_radius - truth.b]
        error += [*(estimate.center[0] - truth.center[0]), *(sign * estimate.angular_axis[0] - truth.n[0])]
        z.append(np.array(error) / estimate.covariance.sigma(*estimate.covariance.names))
        sigma.append(estimate.sigma_t)
    assert (np.abs((np.array(z) ** 2).mean(axis=0) - 1) < 4 * 0.14).all()
    assert np.mean(np.square(sigma)) == pytest.approx(1e-6, rel=0.03)


def test_several_placements_are_refused():
    truth = machine(6, 0.1, placements=2)
    data = problem(truth, joined(small(), small(placement=1)))
    with pytest.raises(ValueError, match="placement"):
        surface.solve(replace(data, R_world_sensor=None))
