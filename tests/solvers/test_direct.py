"""The direct energy: exact, gauge, covariance, and the point locus against the algebraic calibration."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from helpers.simulated import crlb, joined, line_angle, machine, paper, problem, shuffled, small, wandering
from solvers import closed_form, direct, kinematic, pivot
from solvers.direct import Options
from solvers.problem import Problem

FREE_EPSILON = Options(fix_non_orthogonality=False)


def close(estimate, truth, tolerance=1e-8):
    np.testing.assert_allclose(estimate.offset, truth.offset, atol=tolerance)
    np.testing.assert_allclose(estimate.center, truth.center, atol=tolerance)
    assert abs(estimate.major_radius) == pytest.approx(abs(truth.R), abs=tolerance)
    assert line_angle(estimate.torus.orbital_axis, truth.a) < tolerance
    for k in range(len(truth.center)):
        assert line_angle(estimate.angular_axis[k], truth.n[k]) < tolerance


@pytest.mark.parametrize("R", [0.1, 0.0, 0.9])
@pytest.mark.parametrize("start", ["auto", "closed_form", "decomposed"])
def test_exact_on_exact_data(R, start):
    truth = machine(1, R)
    estimate = direct.solve(problem(truth, small()), Options(start=start, shift_start_m=0.02))
    close(estimate, truth)
    np.testing.assert_allclose(estimate.torus.T_world_torus, truth.T_world_torus, atol=1e-8)
    assert estimate.converged


@given(
    st.integers(0, 10_000),
    st.sampled_from([0.1, 0.0, 0.9]),
    st.sampled_from([0.0, np.radians(0.5), np.radians(-2.0)]),
    st.integers(1, 2),
)
@settings(max_examples=12)
def test_exact_on_free_motion_with_epsilon_free(seed, R, epsilon, placements):
    truth = machine(seed, R, epsilon, placements)
    motion = joined(*(wandering(40, seed + k, placement=k) for k in range(placements)))
    estimate = direct.solve(shuffled(problem(truth, motion), seed), FREE_EPSILON)
    close(estimate, truth)
    assert abs(estimate.torus.non_orthogonality) == pytest.approx(abs(epsilon), abs=1e-8)


@pytest.mark.parametrize("R", [0.1, 0.0])
def test_agrees_with_the_other_solvers_within_the_noise(R):
    truth, motion = machine(2, R), small()
    data = problem(truth, motion, 1e-3, 1e-3)
    estimate = direct.solve(data)
    # design: direct within 1.8 times the bound; four of these for the largest of three
    limit = 4 * 1.8 * np.sqrt(np.trace(crlb(truth, motion, 1e-3, 1e-3, epsilon_known=True)[:3, :3]))
    for other in (closed_form.solve(data), kinematic.solve(data, kinematic.Options(fix_non_orthogonality=True))):
        assert np.linalg.norm(estimate.offset - other.offset) < limit
    assert np.linalg.norm(estimate.offset - truth.offset) < limit


def test_the_published_energy_stops_where_it_started_and_says_so():
    truth = machine(3, 0.1)
    data = problem(truth, paper(), 1e-3)
    published = direct.solve(data, Options(gauge="published", shift_start_m=0.05))
    assert np.linalg.norm(published.offset - truth.offset) > 0.020
    # the residuals of 2 * 10,080 normal errors are known to 1 / sqrt(2 * 20,160) = 0.5%
    assert np.sqrt((published.residual**2).mean()) == pytest.approx(1e-3, rel=0.03)
    assert line_angle(published.null_direction_sensor, truth.a) < np.radians(1)
    assert "gauge_undetermined" in [note.code for note in published.notes]
    assert published.unobservable
    # it is the point 50 mm along the axis, on a circle of its own: radius sqrt(R^2 + s^2)
    along = (published.offset - truth.offset) @ truth.a
    assert published.major_radius == pytest.approx(np.hypot(0.1, along), abs=1e-3)

    tangent = direct.solve(data, Options(gauge="tangent", shift_start_m=0.05))
    assert np.linalg.norm(tangent.offset - truth.offset) < 1e-4
    assert tangent.notes == ()
    assert tangent.unobservable == ()


def test_unknown_names_are_refused_with_the_valid_ones():
    data = problem(machine(4), small())
    with pytest.raises(ValueError, match="tangent, published"):
        direct.solve(data, Options(gauge="free"))
    with pytest.raises(ValueError, match=r"auto, closed_form, decomposed"):
        direct.solve(data, Options(start="zero"))
    with pytest.raises(ValueError, match=r"circle.*point"):
        direct.solve(data, Options(locus="sphere"))


def test_orientations_are_needed():
    with pytest.raises(ValueError, match="orientations"):
        direct.solve(Problem.of_poses(np.zeros((10, 3)), None))


def pivoting(
    n: int, placements: int = 1, sigma_t: float = 0.0, seed: int = 0
) -> tuple[Problem, np.ndarray, np.ndarray]:
    """A pointer about fixed points; its tip in the sensor frame; the points."""
    rng = np.random.default_rng([seed, 8])
    R = Rotation.random(n, random_state=seed).as_matrix()
    placement = np.arange(n) % placements
    tip, points = np.array([0.01, -0.02, 0.16]), rng.uniform(-1, 1, (placements, 3))
    p = points[placement] - R @ tip + sigma_t * rng.normal(size=(n, 3))
    blank = Problem.of_poses(p, R)
    return Problem(p, R, placement, blank.held, blank.label), tip, points


@pytest.mark.parametrize("R", [0.1, 0.0])
def test_the_start_does_not_matter(R):
    data = problem(machine(10, R), wandering(300, 3), 1e-3, 1e-3)
    near, far = (direct.solve(data, Options(shift_start_m=s, lever_m=0.7)) for s in (0.0, 0.4))
    deviation = near.covariance.sigma(*(f"offset_sensor_pivot_{k}" for k in "xyz"))
    assert (np.abs(near.offset - far.offset) < 0.01 * deviation).all()


def test_iterations_that_run_out_are_said():
    data = problem(machine(10, 0.1), wandering(300, 3), 1e-3, 1e-3)
    assert not direct.solve(data, Options(shift_start_m=0.4, max_iterations=1)).converged


@pytest.mark.parametrize("placements", [1, 3])
def test_the_point_locus_starts_at_the_algebraic_one_step_calibration(placements):
    data, tip, points = pivoting(200, placements, sigma_t=5e-3)
    rows = np.zeros((200, 3, 3 + 3 * placements))
    rows[:, :, :3] = data.R_world_sensor
    for i, k in enumerate(data.placement):
        rows[i, :, 3 + 3 * k : 6 + 3 * k] = -np.eye(3)
    A, right = rows.reshape(600, -1), -data.p_world_sensor.ravel()
    x = np.linalg.lstsq(A, right, rcond=None)[0]
    t, c = pivot.least_squares(data, np.ones(200, dtype=bool))
    np.testing.assert_allclose(t, x[:3], atol=1e-9)
    np.testing.assert_allclose(c.ravel(), x[3:], atol=1e-9)
    estimate = direct.solve(data, Options(locus="point"))
    # it takes the noise of the orientations, which is 0 here, from the residuals: of 200 poses it is known to
    # sigma_t^2 / sqrt(200) and sqrt(2 / 200), which weighs the equations by 1 +- 0.12; half a sigma is far
    half = 0.5 * estimate.covariance.sigma(*(f"offset_sensor_pivot_{k}" for k in "xyz"))
    assert (np.abs(estimate.offset - x[:3]) < half).all()
    assert estimate.major_radius == 0
    assert estimate.torus is None
    # and of a linear problem with noise of one size the covariance is the textbook's; the sandwich of 200
    # poses knows it to some 15%
    textbook = np.linalg.inv(A.T @ A) * ((A @ x - right) ** 2).sum() / (600 - A.shape[1])
    np.testing.assert_allclose(np.diagonal(estimate.covariance.block("offset")), np.diagonal(textbook)[:3], rtol=0.5)
    assert np.linalg.norm(estimate.offset - tip) < 5e-3
    assert np.linalg.norm(estimate.center - points, axis=1).max() < 5e-3


def test_the_point_locus_is_exact():
    data, tip, points = pivoting(20)
    estimate = direct.solve(data, Options(locus="point"))
    np.testing.assert_allclose(estimate.offset, tip, atol=1e-12)
    np.testing.assert_allclose(estimate.center, points, atol=1e-12)


def energy_by_hand(data: Problem, lever: float, x: np.ndarray, c, n, a, t) -> float:
    """Of c + x[:3], n and a turned by x[3:6] and x[6:9], R + x[9], t + x[10:13], epsilon = 0."""
    n, a = Rotation.from_rotvec(x[3:6]).apply(n), Rotation.from_rotvec(x[6:9]).apply(a)
    y = data.R_world_sensor @ a
    z = np.cross(n, y)
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    e = data.R_world_sensor @ (t + x[10:]) + data.p_world_sensor - c - x[:3] - x[9] * z
    return (e**2).sum() + lever**2 * ((y @ n) ** 2).sum()


@pytest.mark.parametrize("n", [40, 1007, 1008, 1009, 2016, 2017])
def test_stationary_for_any_number_of_poses(n):
    # poses are taken in chunks whose last one is padded: the padding must not pull
    truth = machine(5, 0.1, world_m=3.0)
    data = problem(truth, wandering(n), 1e-3, 1e-3)
    estimate = direct.solve(data, Options(lever_m=0.7))
    assert estimate.residual.shape == (n, 4)
    c, normal, a, t = estimate.center[0], estimate.angular_axis[0], estimate.torus.orbital_axis, estimate.offset
    R, h = estimate.major_radius, 1e-5
    at = np.zeros(13)
    at[9] = R
    here = energy_by_hand(data, 0.7, at, c, normal, a, t)
    assert (estimate.residual**2).sum() == pytest.approx(here, rel=1e-9)
    for direction in np.eye(13):
        plus, minus = (energy_by_hand(data, 0.7, at + s * h * direction, c, normal, a, t) for s in (1, -1))
        curvature = (plus + minus - 2 * here) / h**2
        if curvature * h > 1e-9:  # a rotation of n or a about itself changes nothing
            step = (plus - minus) / (2 * h) / curvature
            deviation = np.sqrt(2 * here / (4 * n) / curvature)
            assert abs(step) < 0.02 * deviation


def test_two_placements_of_odd_sizes_agree_with_each_alone_on_exact_data():
    truth = machine(6, 0.1, 0.0, 2)
    motion = joined(wandering(1009, 1), wandering(37, 2, placement=1))
    close(direct.solve(shuffled(problem(truth, motion))), truth)


@pytest.mark.parametrize(
    ("R", "sigma_t", "sigma_r"), [(0.1, 1e-3, 0.0), (0.1, 0.0, 2e-3), (0.0, 1e-3, 2e-3)], ids=["t", "r", "R = 0, both"]
)
def test_the_sandwich_covariance_over_many_runs(R, sigma_t, sigma_r):
    # Whatever mixture of noises: 150 runs, mean square 1 +- sqrt(2 / 150) = 0.115, share within 1.96 binomial,
    # 0.95 +- 0.018, 4 of these; and the sandwich of 120 poses is known to be low by a few percent, some 5% here.
    truth, motion, runs = machine(7, R), wandering(120, 6), 150
    z = []
    for seed in range(runs):
        estimate = direct.solve(problem(truth, motion, sigma_t, sigma_r, seed))
        sign = np.sign(estimate.torus.orbital_axis @ truth.a)
        sign_n = np.sign(estimate.angular_axis[0] @ truth.n[0])
        error = [
            *(estimate.offset - truth.offset),
            sign * sign_n * estimate.major_radius - truth.R,
            estimate.minor_radius - truth.b,
            *(sign * estimate.torus.orbital_axis - truth.a),
            *(estimate.center[0] - truth.center[0]),
            *(sign_n * estimate.angular_axis[0] - truth.n[0]),
        ]
        names = [n for n in estimate.covariance.names if n != "axis_non_orthogonality"]
        z.append(np.array(error) / estimate.covariance.sigma(*names))
    assert names[:4] == [*(f"offset_sensor_pivot_{k}" for k in "xyz"), "major_radius"]
    z = np.array(z)
    assert (np.abs((z**2).mean(axis=0) - 1.05) < 4 * 0.115 + 0.05).all()
    assert ((np.abs(z) < 1.96).mean(axis=0) > 0.94 - 4 * 0.018).all()


def test_epsilon_free_on_noisy_data():
    truth = machine(8, 0.1, np.radians(0.5))
    estimate = direct.solve(problem(truth, small(), 1e-3, 1e-3), FREE_EPSILON)
    sigma = estimate.covariance.sigma("axis_non_orthogonality")[0]
    assert 0 < sigma < np.radians(0.2)
    assert estimate.torus.non_orthogonality == pytest.approx(np.radians(0.5), abs=5 * sigma)
