"""Maximum likelihood: exact on exact data, stationary, efficient, and honest about its uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from helpers.simulated import (
    Machine,
    Motion,
    crlb,
    joined,
    line_angle,
    machine,
    machine_of,
    paper,
    pose_jacobians,
    problem,
    shuffled,
    small,
    sweeps_deg,
    wandering,
)
from solvers import kinematic
from solvers.kinematic import Options
from solvers.likelihood.covariance import active_unknowns
from solvers.problem import Problem

SIGMA_T, SIGMA_R = 1e-3, 2e-3
FREE, FIXED = Options(fix_non_orthogonality=False), Options(fix_non_orthogonality=True)
TURN = np.arange(0, 360, 30)


def close(estimate, truth: Machine, tolerance=1e-9):
    np.testing.assert_allclose(estimate.offset, truth.offset, atol=tolerance)
    np.testing.assert_allclose(estimate.center, truth.center, atol=tolerance)
    assert abs(estimate.major_radius) == pytest.approx(abs(truth.R), abs=tolerance)
    assert estimate.minor_radius == pytest.approx(truth.b, abs=tolerance)
    assert line_angle(estimate.torus.orbital_axis, truth.a) < tolerance
    for k in range(len(truth.center)):
        assert line_angle(estimate.angular_axis[k], truth.n[k]) < tolerance


@pytest.mark.parametrize("R", [0.1, 0.0, 0.9])
def test_exact_on_the_papers_protocol(R):
    truth = machine(1, R, 0.01)
    estimate = kinematic.solve(problem(truth, paper()))
    close(estimate, truth)  # 1e-6 mm
    np.testing.assert_allclose(estimate.torus.T_world_torus, truth.T_world_torus, atol=1e-9)
    np.testing.assert_allclose(estimate.torus.T_sensor_carm, truth.T_sensor_carm, atol=1e-9)
    assert estimate.torus.non_orthogonality == pytest.approx(0.01, abs=1e-9)
    assert estimate.converged


@given(
    st.integers(0, 10_000),
    st.sampled_from([0.1, 0.0, 0.9]),
    st.sampled_from([0.0, np.radians(0.5), np.radians(-2.0)]),
    st.integers(1, 2),
)
@settings(max_examples=15)
def test_exact_on_free_motion(seed, R, epsilon, placements):
    truth = machine(seed, R, epsilon, placements)
    motion = joined(*(wandering(40, seed + k, placement=k) for k in range(placements)))
    estimate = kinematic.solve(shuffled(problem(truth, motion), seed), FREE)
    close(estimate, truth)
    assert abs(estimate.torus.non_orthogonality) == pytest.approx(abs(epsilon), abs=1e-9)


def with_readings(motion: Motion, sigma: float, seed: int = 0) -> Motion:
    """Every moving joint has a reading with noise."""
    noisy = motion.angles + sigma * np.random.default_rng([seed, 4]).normal(size=motion.angles.shape)
    return replace(motion, label=np.where(motion.held < 0, noisy, motion.label))


def two_placements() -> Motion:
    return joined(sweeps_deg((-90, 0), TURN, (20,), TURN), sweeps_deg((-40, 30), TURN, (60,), TURN, placement=1))


CASES: dict[str, tuple[Machine, Motion, Options]] = {
    "labels": (machine(11, 0.1), small(), FIXED),
    "free": (machine(12, 0.1), small().free(), FIXED),
    "R = 0": (machine(13, 0.0, 0.005), small(), FREE),
    "R = 0, free": (machine(14, 0.0), wandering(60, 3), FIXED),
    "ring": (machine(15, 1.2, 0.005), wandering(60, 4), FREE),
    "two placements": (machine(16, 0.1, 0.01, 2), two_placements(), FREE),
    "unknown held angles": (machine(17, 0.1, 0.01), small().without_labels(), FREE),
    "readings": (machine(18, 0.1, 0.01), small(), FREE),
    "readings alone": (machine(19, 0.1), wandering(60, 5), FIXED),
    "two placements, unknown held angles": (machine(20, 0.1, 0.01, 2), two_placements().without_labels(), FREE),
}
READING = {"readings": np.radians(0.1), "readings alone": np.radians(0.3)}


def drawn(name: str, seed: int) -> tuple[Problem, Options]:
    """One recording of a case with noise of its own."""
    truth, motion, options = CASES[name]
    if name in READING:
        motion = with_readings(motion, READING[name], seed)
    data = problem(truth, motion, SIGMA_T, SIGMA_R, seed)
    return replace(data, sigma_reading=READING.get(name, data.sigma_reading)), options


def cost_by_hand(m: Machine, angles: np.ndarray, data: Problem, sigma_t: float, sigma_r: float) -> np.ndarray:
    """Weighted residuals of all poses, and of the readings, in one vector."""
    p, R = m.poses(angles, data.placement)
    turn = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ data.R_world_sensor).as_rotvec()
    reading = (data.held < 0) & np.isfinite(data.label)
    off = np.angle(np.exp(1j * (angles - data.label)))[reading] / data.sigma_reading
    return np.concatenate([(data.p_world_sensor - p).ravel() / sigma_t, turn.ravel() / sigma_r, off])


def angle_unknowns(data: Problem) -> list[np.ndarray]:
    """Masks (N, 2), one for each unknown angle: of one pose, or of one sweep."""
    masks = []
    for joint in (0, 1):
        moving = data.held[:, joint] < 0
        unlabelled = ~moving & np.isnan(data.label[:, joint])
        groups = [np.arange(len(data)) == i for i in np.flatnonzero(moving)]
        groups += [(data.held[:, joint] == h) & unlabelled for h in np.unique(data.held[unlabelled, joint])]
        for group in groups:
            mask = np.zeros((len(data), 2))
            mask[group, joint] = 1
            masks.append(mask)
    return masks


def active(truth: Machine, options: Options, estimate) -> np.ndarray:
    """Directions of the machine that the data determine."""
    P = len(truth.center)
    keep = np.eye(6 * P + 8)
    drop = [6 * p + 3 for p in range(P) if not estimate.torus.referenced[p]]
    drop += [] if estimate.torus.orbital_referenced else [6 * P + 6]
    drop += [6 * P + 1] if options.fix_non_orthogonality else []
    return np.delete(keep, drop, axis=0)


@pytest.mark.parametrize("name", CASES)
def test_the_answer_is_stationary(name):
    data, options = drawn(name, 0)
    estimate = kinematic.solve(data, replace(options, tolerance=1e-6))
    assert estimate.converged
    m = machine_of(estimate.torus)
    sigma = estimate.sigma_t, estimate.sigma_r
    h = 1e-6
    directions = [
        (
            cost_by_hand(m.moved(h * e), estimate.angles, data, *sigma),
            cost_by_hand(m.moved(-h * e), estimate.angles, data, *sigma),
        )
        for e in active(m, options, estimate)
    ]
    directions += [
        (
            cost_by_hand(m, estimate.angles + h * mask, data, *sigma),
            cost_by_hand(m, estimate.angles - h * mask, data, *sigma),
        )
        for mask in angle_unknowns(data)
    ]
    gradient = np.array([(plus @ plus - minus @ minus) / (4 * h) for plus, minus in directions])
    curvature = np.array([((plus - minus) ** 2).sum() / (4 * h * h) for plus, minus in directions])
    # the step that each unknown alone would still take, in standard deviations of it alone
    assert np.abs(gradient / np.sqrt(curvature)).max() < 1e-3


@pytest.mark.parametrize("name", CASES)
def test_the_same_minimum_as_least_squares_of_scipy(name):
    data, options = drawn(name, 1)
    data = replace(data, sigma_t=SIGMA_T, sigma_r=SIGMA_R)
    estimate = kinematic.solve(data, replace(options, tolerance=1e-7))
    start = kinematic.solve(data, replace(options, max_iterations=1))
    assert np.linalg.norm(start.offset - estimate.offset) > 0
    m, angles = machine_of(start.torus), start.angles
    keep, masks = active(m, options, start), angle_unknowns(data)
    split = len(keep)

    def residual(x):
        turned = angles + np.tensordot(x[split:], masks, axes=1)
        return cost_by_hand(m.moved(keep.T @ x[:split]), turned, data, SIGMA_T, SIGMA_R)

    fit = least_squares(residual, np.zeros(split + len(masks)), x_scale="jac", xtol=1e-12, ftol=1e-14, gtol=1e-12)
    other = m.moved(keep.T @ fit.x[:split])
    mine = cost_by_hand(machine_of(estimate.torus), estimate.angles, data, SIGMA_T, SIGMA_R)
    assert (mine**2).sum() == pytest.approx(2 * fit.cost, rel=1e-9)
    deviation = np.sqrt(np.diagonal(crlb(m, CASES[name][1], SIGMA_T, SIGMA_R)))
    for found, tolerance in ((estimate, 1e-3), (kinematic.solve(data, options), 1e-2)):
        difference = np.abs(machine_of(found.torus).reported() - other.reported())
        assert (difference <= tolerance * deviation + 1e-12).all()


RUNS = 200
QUICK = ("labels", "R = 0, free", "two placements", "unknown held angles", "readings")


def study_of_the_rest() -> list:
    return [pytest.param(name, marks=() if name in QUICK else pytest.mark.study) for name in CASES]


def normalised_errors(name: str, estimates: list) -> dict[str, np.ndarray]:
    """(runs,) or (runs, 3) errors of every reported quantity over its standard deviation; directions and
    signs that are a convention are those of the truth first."""
    truth = CASES[name][0]
    errors: dict[str, list] = {}

    def add(key, error, *names):
        deviation = estimate.covariance.sigma(*names)
        if (deviation > 0).all():
            errors.setdefault(key, []).append(np.atleast_1d(error) / deviation)

    for estimate in estimates:
        sign_n, sign_a = np.sign(estimate.angular_axis[0] @ truth.n[0]), np.sign(estimate.torus.orbital_axis @ truth.a)
        sign = sign_n * sign_a
        add("offset", estimate.offset - truth.offset, *xyz("offset_sensor_pivot"))
        add("major", sign * estimate.major_radius - truth.R, "major_radius")
        add("minor", estimate.minor_radius - truth.b, "minor_radius")
        add("epsilon", sign * estimate.torus.non_orthogonality - truth.epsilon, "axis_non_orthogonality")
        add("orbital", sign_a * estimate.torus.orbital_axis - truth.a, *xyz("orbital_axis_sensor"))
        for k in range(len(truth.center)):
            add(f"center {k}", estimate.center[k] - truth.center[k], *xyz(f"torus_center_world[{k}]"))
            add(f"angular {k}", sign_n * estimate.angular_axis[k] - truth.n[k], *xyz(f"angular_axis_world[{k}]"))
    return {key: np.array(value) for key, value in errors.items()}


def xyz(name: str) -> list[str]:
    return [f"{name}_{axis}" for axis in "xyz"]


@pytest.mark.parametrize("name", study_of_the_rest())
def test_uncertainty_and_noise_over_many_runs(name):
    """One test for all that the runs show, since they are what takes the time; it names all that is wrong."""
    truth, motion, options = CASES[name]
    estimates = [kinematic.solve(*drawn(name, seed)) for seed in range(100, 100 + RUNS)]
    errors = normalised_errors(name, estimates)
    assert ("epsilon" in errors) == (not options.fix_non_orthogonality)
    wrong = {}
    stuck = sum(not x.converged for x in estimates)
    if stuck:
        wrong["runs that did not converge"] = stuck
    for key, z in errors.items():
        square, mean, covered = (z**2).mean(axis=0), z.mean(axis=0), (np.abs(z) < 1.96).mean(axis=0)
        # 200 normal errors: their mean square is 1 +- sqrt(2 / 200) = 0.1, their mean 0 +- 1 / sqrt(200) = 0.071,
        # the share within 1.96 is binomial, 0.95 +- 0.0154; some 100 are looked at: 4.5 of these
        if (np.abs(square - 1) > 0.45).any():
            wrong[f"mean square of {key}"] = square
        if (np.abs(mean) > 4.5 * 0.071).any():
            wrong[f"mean of {key}"] = mean
        if (covered < 0.95 - 4.5 * 0.0154).any():
            wrong[f"coverage of {key}"] = covered
    # the mean of chi-square with 3 degrees of freedom over 200 runs is 3 +- sqrt(6 / 200) = 0.173; 4 of these
    offsets = [x.offset - truth.offset for x in estimates]
    chi2 = [e @ np.linalg.solve(x.covariance.block("offset"), e) for e, x in zip(offsets, estimates, strict=True)]
    if abs(np.mean(chi2) - 3) > 4 * 0.173:
        wrong["chi-square of the offset"] = np.mean(chi2)
    # A run has at least 100 degrees of freedom of each kind, so the mean of 200 estimated variances is known
    # to sqrt(2 / (100 * 200)) = 1%; 4 of these. To count residuals without what the fit takes of them would
    # be 10% to 40% off.
    for kind, sigma in (("sigma_t", SIGMA_T), ("sigma_r", SIGMA_R)):
        ratio = np.mean([getattr(x, kind) ** 2 for x in estimates]) / sigma**2
        if abs(ratio - 1) > 0.04:
            wrong[f"variance ratio of {kind}"] = ratio
    if name not in READING:  # the bound of the tests has no readings
        bound = crlb(truth, motion, SIGMA_T, SIGMA_R, epsilon_known=bool(options.fix_non_orthogonality))
        told = np.mean([np.sqrt(np.diagonal(x.covariance.matrix)) for x in estimates], axis=0)
        # a run knows its noise to 5%, the mean of the runs to 0.4%; that of the geometry is of second order
        if not np.allclose(told, np.sqrt(np.diagonal(bound)), rtol=0.03, atol=1e-9):
            wrong["told over brute-force standard deviation"] = told / np.sqrt(np.diagonal(bound))
    assert not wrong


def test_given_noise_is_taken_as_it_is():
    data = replace(drawn("labels", 0)[0], sigma_t=3e-3, sigma_r=4e-3)  # above the true noise: nothing is an outlier
    estimate = kinematic.solve(data, FIXED)
    assert (estimate.sigma_t, estimate.sigma_r) == (3e-3, 4e-3)
    expected = crlb(*CASES["labels"][:2], 3e-3, 4e-3, epsilon_known=True)
    np.testing.assert_allclose(np.diagonal(estimate.covariance.matrix)[:3], np.diagonal(expected)[:3], rtol=0.02)


def test_epsilon_is_fixed_and_it_is_said_where_the_motion_does_not_determine_it():
    truth = machine(21, 0.1, np.radians(0.4))
    shy = problem(truth, wandering(60, 1, arc_deg=25), SIGMA_T, SIGMA_R)
    estimate = kinematic.solve(shy)
    assert estimate.torus.non_orthogonality == 0
    assert [note.code for note in estimate.notes] == ["non_orthogonality_fixed"]
    sigma = np.sqrt(crlb(truth, wandering(60, 1, arc_deg=25), SIGMA_T, SIGMA_R)[5, 5])
    assert sigma > np.radians(0.5)  # so the test is one
    told = float(estimate.notes[0].message.split(" deg")[0].split()[-1])
    assert told == pytest.approx(np.degrees(sigma), rel=0.5)  # at another geometry, the fitted one
    assert kinematic.solve(shy, FREE).torus.non_orthogonality != 0
    assert kinematic.solve(shy, FREE).notes == ()


def test_epsilon_is_estimated_where_the_motion_determines_it():
    truth = machine(22, 0.1, np.radians(0.4))
    data = problem(truth, small(), SIGMA_T, SIGMA_R)
    auto, free, fixed = kinematic.solve(data), kinematic.solve(data, FREE), kinematic.solve(data, FIXED)
    assert auto.notes == ()
    assert auto.torus.non_orthogonality == free.torus.non_orthogonality
    assert auto.torus.non_orthogonality == pytest.approx(
        np.radians(0.4), abs=5 * auto.covariance.sigma("axis_non_orthogonality")[0]
    )
    assert fixed.torus.non_orthogonality == 0
    assert fixed.covariance.sigma("axis_non_orthogonality")[0] == 0


def test_iterations_that_run_out_are_said():
    data, options = drawn("free", 0)
    assert not kinematic.solve(data, replace(options, max_iterations=1)).converged


@pytest.mark.parametrize("fixed", [True, False])
def test_what_no_label_gives_is_no_unknown(fixed):
    motion = joined(sweeps_deg((-90, 0), TURN, (), ()), wandering(10, placement=1))  # no beta, one alpha
    active = active_unknowns(problem(machine(24, 0.1, 0.01, 2), motion), fix_non_orthogonality=fixed)
    # [v, w] of two tori with the zero of alpha fourth, R, epsilon, [v, w] of the mount with that of beta fifth
    expected = [1] * 6 + [1, 1, 1, 0, 1, 1] + [1, 0 if fixed else 1] + [1, 1, 1, 1, 0, 1]
    assert active.astype(int).tolist() == expected


def test_labels_of_held_angles_are_exact_and_unknown_ones_are_one_a_sweep():
    data, _ = drawn("labels", 0)
    estimate = kinematic.solve(data, FIXED)
    known = np.isfinite(data.label)
    np.testing.assert_array_equal(estimate.angles[known], data.label[known])
    data, _ = drawn("unknown held angles", 0)
    estimate = kinematic.solve(data, FREE)
    for number in range(5):
        here = data.held == number
        assert np.ptp(estimate.angles[here]) < 1e-12


def test_efficient_with_rotation_noise_and_with_position_noise():
    # 60 runs know the root mean square of a 3-vector to 1 / sqrt(2 * 60 * 2) = 6%: 3 of these above the design's 1.1
    truth, motion = machine(23, 0.1), small()
    for sigma_t, sigma_r in ((1e-3, 1e-5), (1e-5, 2e-3)):
        bound = np.sqrt(np.trace(crlb(truth, motion, sigma_t, sigma_r, epsilon_known=True)[:3, :3]))
        error = [
            kinematic.solve(problem(truth, motion, sigma_t, sigma_r, seed), FIXED).offset - truth.offset
            for seed in range(60)
        ]
        ratio = np.sqrt((np.square(error)).sum(axis=1).mean()) / bound
        assert 0.8 < ratio < 1.1 * 1.18


@pytest.mark.study
@pytest.mark.parametrize("R", [0.1, 1e-3, 0.0, 0.9])
@pytest.mark.parametrize(("sigma_t", "sigma_r"), [(1e-3, 0.0), (5e-3, 0.0), (0.0, np.radians(0.3))])
def test_study_of_the_papers_protocol(R, sigma_t, sigma_r):
    """The design's 1.1 times the bound over random geometries; 40 runs know the ratio to 8%: three of these."""
    motion = paper()
    labelled = np.isfinite(motion.label)
    ratio = []
    for seed in range(40):
        truth = machine(1000 + seed, R)
        floor = (max(sigma_t, 1e-6), max(sigma_r, 1e-6))
        bound = _bound_of_many_poses(truth, motion, labelled, *floor)
        estimate = kinematic.solve(problem(truth, motion, sigma_t, sigma_r, seed), FIXED)
        ratio.append(np.linalg.norm(estimate.offset - truth.offset) / bound)
    assert np.sqrt(np.mean(np.square(ratio))) < 1.1 * 1.24


def _bound_of_many_poses(truth, motion, labelled, sigma_t, sigma_r) -> float:
    """The bound of the offset, the angle of each pose projected out of its own six rows."""
    weight = np.repeat([1 / sigma_t, 1 / sigma_r], 3)[:, None]
    J_machine, J_angle = (J * weight for J in pose_jacobians(truth, motion))
    A = np.where(labelled[:, None, :], 0.0, J_angle)
    J = np.delete(J_machine, 7, axis=2)
    free = J - A @ np.linalg.pinv(A) @ J
    H = np.einsum("nri,nrj->ij", free, free)
    return float(np.sqrt(np.trace(np.linalg.inv(H)[7:10, 7:10])))


@pytest.mark.parametrize("seed", range(4))  # fewer than half of the labels of a joint contradict
def test_a_stretch_whose_labels_contradict_the_others_does_not_hide_in_a_large_noise(seed):
    # a tracker that freezes but jitters: a fifth of the poses stand still, with the labels of other sweeps
    truth = machine(seed)
    motion = sweeps_deg((-60, -30, 0, 30, 60), range(-70, 71, 2), (-40, 0, 40), range(-60, 61, 2))
    sound = problem(truth, motion, 1e-3, 1e-3, seed)
    n = len(sound)
    first = int(np.random.default_rng(seed).integers(1, 0.4 * n))
    frozen = np.arange(n)[first : first + n // 5]
    p, R = sound.p_world_sensor.copy(), sound.rotations.copy()
    p[frozen] = p[first - 1] + 2e-5 * np.random.default_rng(seed).normal(size=(len(frozen), 3))
    R[frozen] = R[first - 1]
    estimate = kinematic.solve(replace(sound, p_world_sensor=p, R_world_sensor=R))
    contradicts = (np.abs(sound.label[frozen] - motion.angles[first - 1]) > np.radians(1)).any(axis=1)
    assert contradicts.any()
    assert not estimate.used[frozen[contradicts]].any()
    assert estimate.sigma_t < 1.2e-3
    assert np.linalg.norm(estimate.offset - truth.offset) < 5e-4  # its sigma is about 0.1 mm
