"""Noise, covariance, priors and left-out numbers of the chain solver, against Monte Carlo and dense truth."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.machines import (
    SIGMA,
    SIGMA_L,
    SIGMA_Q,
    SIGMA_R,
    SIGMA_T,
    changed,
    dense,
    disturbed,
    drawn,
    everything,
    free,
    hand_made,
    observed,
    with_readings,
)
from solvers.chain.chain import Options, solve_chain
from solvers.chain.equations import normal_equations
from solvers.chain.machine import Machine
from solvers.chain.noise import next_sigma
from solvers.chain.problem import ANGLES, POSITIONS, ChainProblem, Layout
from solvers.se3 import inverse, log_se3
from solvers.verdict.left_out import left_out


def with_noise(seed: int) -> tuple[Machine, ChainProblem]:
    """A prismatic and two turning joints read with noise, one turning joint known, 60 poses."""
    truth = hand_made("rprr", seed=9)
    problem = observed(truth, drawn(truth, 60, 9), (SIGMA_T, SIGMA_R), seed)
    return truth, with_readings(with_readings(problem, [0, 3], SIGMA_Q, seed), [1], SIGMA_L, seed + 10_000)


@pytest.fixture(scope="module")
def many():
    """60 recordings with noise of their own, all noises estimated."""
    runs = [
        (truth, solve_chain(problem, truth, problem.label, everything(truth)))
        for truth, problem in map(with_noise, range(60))
    ]
    assert all(found.converged for _, found in runs)
    return runs


def test_noise_is_estimated_without_bias(many):
    ratio = np.array([found.sigma**2 / SIGMA**2 for _, found in many])
    error = ratio.std(axis=0) / np.sqrt(len(ratio))
    assert (np.abs(ratio.mean(axis=0) - 1) < 4 * error).all()  # 4 standard errors, 4 kinds: 1 in 4000
    assert (ratio.std(axis=0) < 0.8).all()  # so that the bound says something


def departures(truth: Machine, found) -> np.ndarray:
    """(D,) right perturbations from the truth."""
    layout, e = found.layout, np.zeros(found.layout.size)
    for kind, own in (("T_world_base", layout.base), ("placements", layout.placement), ("T_last_sensor", layout.mount)):
        pairs = zip(getattr(truth, kind), getattr(found.machine, kind), strict=True)
        for k, (before, after) in enumerate(pairs):
            e[own(k)] = log_se3(inverse(before) @ after)
    return e


def test_covariance_is_that_of_the_errors(many):
    """The mean of the normalised squares, which is F-like: its excess over chi-square is 2 / dof, 1%."""
    squares = []
    for truth, found in many:
        active = np.flatnonzero(found.active)
        e, C = departures(truth, found)[active], found.covariance[np.ix_(active, active)]
        scale = np.sqrt(np.diagonal(C))
        squares.append(e / scale @ np.linalg.solve(C / np.outer(scale, scale), e / scale))
    k = len(active)
    assert k == 4 * 3 + 2 + 6
    assert np.mean(squares) == pytest.approx(1.01 * k, abs=4 * np.sqrt(2 * k / len(squares)) + 0.03 * k)


def test_chi2_of_given_noise():
    found = []
    for seed in range(40):
        truth, problem = with_noise(seed)
        given_noise = replace(problem, sigma=tuple(SIGMA))
        found.append(solve_chain(given_noise, truth, problem.label, everything(truth)).chi2_per_dof)
    dof = 60 * 6 - 20  # every unknown value has a reading, so that the machine alone takes some
    assert np.mean(found) == pytest.approx(1, abs=4 * np.sqrt(2 / (dof * len(found))))
    assert np.std(found) == pytest.approx(np.sqrt(2 / dof), rel=0.5)  # 40 runs: 11% one sigma


def test_chi2_of_half_the_noise_is_four():
    truth, problem = with_noise(0)
    found = solve_chain(
        replace(problem, sigma=tuple(SIGMA / 2)),
        truth,
        problem.label,
        everything(truth),
        Options(reject_outliers=False),
    )
    assert found.chi2_per_dof == pytest.approx(4, rel=0.35)  # 4 sigma of 340 degrees of freedom


def test_estimated_noise_makes_chi2_one(many):
    assert [found.chi2_per_dof for _, found in many] == pytest.approx([1] * len(many), abs=0.02)


def test_exact_readings_are_told_from_noisy_ones():
    """The noise of readings without any goes to zero; that of the poses is as if they were known."""
    truth = with_noise(3)[0]
    exact = observed(truth, drawn(truth, 60, 9), (SIGMA_T, SIGMA_R), 3)
    read = with_readings(exact, [0, 1, 2, 3], 0.0)
    found = solve_chain(read, truth, read.label, everything(truth))
    known = solve_chain(exact, truth, exact.label, everything(truth))
    assert found.converged
    assert found.sigma[ANGLES] < SIGMA_R / 3
    assert found.sigma[:2] == pytest.approx(known.sigma[:2], rel=0.1)
    declared = solve_chain(replace(read, sigma=(None, None, 0.0, 0.0)), truth, read.label, everything(truth))
    np.testing.assert_allclose(declared.machine.placements, known.machine.placements, atol=1e-9)


def test_prior_is_the_dense_maximum_a_posteriori():
    """One Gauss-Newton problem of poses and prior together, at small departures."""
    truth = hand_made("rrr", seed=11)
    values = drawn(truth, 25)
    nominal = disturbed(truth, 4, 1e-3, 1e-3)
    nominal = replace(nominal, T_world_base=truth.T_world_base, T_last_sensor=truth.T_last_sensor)
    problem = replace(observed(truth, values, (SIGMA_T, SIGMA_R)), sigma=tuple(SIGMA))
    options = Options(prior_t=2e-4, prior_r=3e-4, tolerance=1e-6)
    found = solve_chain(problem, nominal, values, everything(truth), options)
    layout, active = found.layout, np.flatnonzero(found.active)
    J, _, r, *_ = dense(found.machine, problem, values, SIGMA)
    e = departures(nominal, found)
    P = np.zeros(layout.size)
    for j in range(3):
        P[layout.placement(j)] = np.repeat([2e-4**-2.0, 3e-4**-2.0], 3)
    H = J.T @ J + np.diag(P)
    gradient = (J.T @ r + P * e)[active]
    C = np.linalg.inv(H[np.ix_(active, active)])
    assert gradient @ C @ gradient < 1e-3**2 * len(active)  # stationary to a thousandth of a sigma
    scale = np.sqrt(np.diagonal(C))
    np.testing.assert_allclose(
        found.covariance[np.ix_(active, active)] / np.outer(scale, scale), C / np.outer(scale, scale), atol=1e-4
    )
    own = slice(layout.placement(0)[0], layout.offset(0))
    np.testing.assert_allclose(found.precision[own], P[own])


def test_a_direction_that_the_poses_hardly_tell_stays_nominal_with_a_prior():
    """Two joints almost parallel that hardly turn: without a prior they run away, with one they do not."""
    truth = hand_made("rrr", seed=12)
    values = drawn(truth, 40) * [1, 0.01, 1]
    nominal = changed(truth, "placements", 1, np.array([0, 0, 0, 1e-4, -1e-4, 1e-4]))
    problem = observed(truth, values, (SIGMA_T, SIGMA_R))
    wild = solve_chain(problem, nominal, values, everything(truth))
    tame = solve_chain(problem, nominal, values, everything(truth), Options(prior_t=1e-3, prior_r=1e-3))
    own = tame.layout.placement(1)
    far = np.linalg.norm(log_se3(inverse(nominal.placements[1]) @ wild.machine.placements[1]))
    near = np.linalg.norm(log_se3(inverse(nominal.placements[1]) @ tame.machine.placements[1]))
    assert far > 10 * near
    assert (tame.covariance[own, own] * tame.precision[own]).max() > 0.4  # 1 / 2 where two share a direction
    assert tame.precision[tame.layout.base(0)].max() == 0
    assert (wild.precision == 0).all()


def groups_of(found) -> dict[str, np.ndarray]:
    return {f"origin {j}": found.layout.placement(j) for j in range(found.layout.joints)}


def test_score_test_is_uniform_without_anything_to_find():
    """Its probability over 80 recordings: mean 1/2, and a twentieth below 0.05."""
    truth = hand_made("rrr", seed=13)
    values, found = drawn(truth, 50, 13), []
    for seed in range(80):
        problem = observed(truth, values, (SIGMA_T, SIGMA_R), seed)
        estimate = solve_chain(problem, truth, values, free(truth), Options(reject_outliers=False))
        found.append(left_out(problem, estimate, groups_of(estimate)).probability)
    assert np.mean(found) == pytest.approx(0.5, abs=4 * np.sqrt(1 / 12 / 80))
    assert np.mean(np.array(found) < 0.05) < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 80)


def test_score_test_of_noise_that_is_not_independent():
    """Each pose repeated nine times: many false alarms without the correlation, none with it."""
    truth = hand_made("rrr", seed=15)
    values, alarms = np.repeat(drawn(truth, 50, 15), 10, axis=0), []
    for seed in range(20):
        T = observed(truth, values[::10], (SIGMA_T, SIGMA_R), seed).T_world_sensor
        problem = replace(observed(truth, values), T_world_sensor=np.repeat(T, 10, axis=0))
        estimate = solve_chain(problem, truth, values, free(truth), Options(reject_outliers=False))
        both = [left_out(problem, estimate, groups_of(estimate), r).probability for r in (0.0, 0.9)]
        alarms.append([p < 1e-6 for p in both])
    without, with_it = np.mean(alarms, axis=0)
    assert without > 0.3
    assert with_it == 0


def test_score_test_names_the_wrong_joint():
    truth = hand_made("rrr", seed=14)
    values = drawn(truth, 60)
    nominal = changed(truth, "placements", 1, np.array([2e-3, -1e-3, 1e-3, 0, 0, 0]))
    problem = observed(truth, values, (SIGMA_T, SIGMA_R))
    wrong = solve_chain(problem, nominal, values, free(truth), Options(reject_outliers=False))
    found = left_out(problem, wrong, groups_of(wrong))
    assert found.most == "origin 1"
    assert found.kind == POSITIONS
    assert found.probability < 1e-12
    right = solve_chain(problem, nominal, values, everything(truth), Options(reject_outliers=False))
    ratio = (right.sigma[POSITIONS] / wrong.sigma[POSITIONS]) ** 2
    assert found.share == pytest.approx(1 - ratio, abs=0.05)
    assert left_out(problem, right, groups_of(right)) is None


def test_next_sigma_keeps_what_is_given():
    truth, problem = with_noise(1)
    problem = replace(problem, sigma=(None, 3e-3, None, 5e-3))
    layout = Layout.of(problem, truth)
    used, wanted = np.ones(len(problem), dtype=bool), np.zeros(layout.size, dtype=bool)
    wanted[layout.always()] = True
    at = normal_equations(truth, problem.label, problem, layout, SIGMA, used, wanted)
    nothing = np.zeros(layout.size)
    found = next_sigma(problem, at, nothing, np.zeros_like(at.H))
    assert found[[1, 3]].tolist() == [3e-3, 5e-3]
    assert found[0] != SIGMA_T
