"""The Cramér-Rao bound against the curvature of the expected log-likelihood, and against Monte Carlo."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from helpers.simulated import Machine, Motion, joined, machine, problem, sweeps_deg
from solvers import kinematic
from solvers.likelihood.bound import cramer_rao

SIGMA_T, SIGMA_R = 1e-3, 2e-3
FULL = np.arange(0, 360, 45)


def few(placement: int = 0) -> Motion:
    """Two orbital sweeps and one angular of eight poses each."""
    return sweeps_deg((-60, 40), FULL, (20,), FULL, placement)


def dense_covariance(truth: Machine, motion: Motion, epsilon_known: bool) -> np.ndarray:
    """Covariance of `Machine.reported` from the Hessian of the expected negative log-likelihood.

    F(theta) = sum |p - p(theta)|^2 / (2 sigma_t^2) + |log(R(theta)T R)|^2 / (2 sigma_r^2) at the noise-free
    poses: the expectation over the noise adds a constant, and terms of the order of sigma_r^2. Second
    central differences over every unknown, each angle that the recording does not give being one of them.
    """
    p0, R0 = truth.poses(motion.angles, motion.placement)
    basis = _angle_directions(motion)
    size = 6 * len(truth.T_world_torus) + 8
    scale = np.concatenate([np.full(size, 1e-4), np.full(len(basis), 1e-4)])

    def energy(step: np.ndarray) -> float:
        moved = truth.moved(step[:size])
        p, R = moved.poses(motion.angles + np.tensordot(step[size:], basis, 1), motion.placement)
        turn = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ R0).as_rotvec()
        return float(((p - p0) ** 2).sum() / SIGMA_T**2 + (turn**2).sum() / SIGMA_R**2) / 2

    unknowns = [k for k in range(len(scale)) if not (epsilon_known and k == size - 7)]
    H = _second_differences(energy, scale, unknowns)
    norm = np.sqrt(np.diagonal(H))
    C = np.linalg.pinv(H / np.outer(norm, norm), rcond=1e-6, hermitian=True) / np.outer(norm, norm)
    own = [k for k in unknowns if k < size]
    h = 1e-6 * np.eye(len(scale))[own, :size]
    J = np.stack([(truth.moved(x).reported() - truth.moved(-x).reported()) / 2e-6 for x in h], axis=1)
    return J @ C[: len(own), : len(own)] @ J.T


def _angle_directions(motion: Motion) -> np.ndarray:
    """(K, N, 2): what each unknown angle adds; one a pose where the joint moves, one a sweep where it is held."""
    directions = []
    for joint in (0, 1):
        held, known = motion.held[:, joint], np.isfinite(motion.label[:, joint])
        groups = [np.array([i]) for i in np.flatnonzero(held < 0)]
        groups += [np.flatnonzero(held == number) for number in np.unique(held[(held >= 0) & ~known])]
        for group in groups:
            direction = np.zeros((len(motion), 2))
            direction[group, joint] = 1
            directions.append(direction)
    return np.stack(directions)


def _second_differences(energy, scale: np.ndarray, unknowns: list[int]) -> np.ndarray:
    """F(0) = 0 is the minimum and F is even to leading order, so H_ij needs F at h_i, h_j and h_i +- h_j."""
    steps = np.diag(scale)[unknowns]
    own = np.array([energy(s) + energy(-s) for s in steps])
    H = np.diag(own / np.diagonal(steps[:, unknowns]) ** 2)
    for i in range(len(steps)):
        for j in range(i):
            plus = energy(steps[i] + steps[j]) + energy(-steps[i] - steps[j])
            H[i, j] = H[j, i] = (plus - own[i] - own[j]) / (2 * scale[unknowns[i]] * scale[unknowns[j]])
    return H


CASES = {
    "labels": (machine(1, 0.1, 0.01), few(), False),
    "labels, epsilon known": (machine(2, 0.1), few(), True),
    "sweeps without labels": (machine(3, 0.15, -0.01), few().without_labels(), False),
    "R = 0": (machine(4, 0.0, 0.01), few(), False),
}


@pytest.mark.parametrize("case", CASES)
def test_is_the_curvature_of_the_expected_log_likelihood(case):
    truth, motion, epsilon_known = CASES[case]
    _agrees(truth, motion, epsilon_known)


@pytest.mark.study
@pytest.mark.parametrize("free", [False, True])
def test_is_the_curvature_with_two_placements(free):
    motion = joined(few(0), few(1))
    _agrees(machine(5, 0.1, 0.01, placements=2), motion.free() if free else motion, False)


def _agrees(truth: Machine, motion: Motion, epsilon_known: bool) -> None:
    """Scaled by the standard deviations; the differences are good to the square of a step of 1e-4 times the
    third and fourth derivatives of poses whose lever is below 1 m, amplified by the condition of the problem."""
    bound = cramer_rao(truth.torus(), motion.angles, problem(truth, motion), SIGMA_T, SIGMA_R, epsilon_known).matrix
    expected = dense_covariance(truth, motion, epsilon_known)
    sigma = np.sqrt(np.maximum(np.diagonal(expected), 1e-20))
    np.testing.assert_allclose(bound / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-3)


def test_is_reached_by_maximum_likelihood():
    """With the noise known and far below all curvature, the estimate is linear in the noise, so its errors
    have the bound as their covariance."""
    runs, truth, motion = 150, machine(6, 0.1, 0.005), sweeps_deg((-60, 0, 60), FULL, (0, 70), FULL)
    _reached(runs, truth, motion, SIGMA_T / 10, SIGMA_R / 10)


@pytest.mark.study
@pytest.mark.parametrize("R", [0.0, 0.1, 0.9])
def test_is_reached_at_every_radius(R):
    _reached(1500, machine(7, R, 0.005), sweeps_deg((-60, 0, 60), FULL, (0, 70), FULL), SIGMA_T, SIGMA_R)


def _reached(runs: int, truth: Machine, motion: Motion, sigma_t: float, sigma_r: float) -> None:
    bound = cramer_rao(truth.torus(), motion.angles, problem(truth, motion), sigma_t, sigma_r)
    options = kinematic.Options(fix_non_orthogonality=False, reject_outliers=False)
    errors = []
    for seed in range(runs):
        estimate = kinematic.solve(problem(truth, motion, sigma_t, sigma_r, seed), options)
        scalars = [estimate.major_radius - truth.R, estimate.torus.non_orthogonality - truth.epsilon]
        errors.append(np.concatenate([estimate.offset - truth.offset, scalars, estimate.center[0] - truth.center[0]]))
    names = [f"offset_sensor_pivot_{k}" for k in "xyz"] + ["major_radius", "axis_non_orthogonality"]
    names += [f"torus_center_world[0]_{k}" for k in "xyz"]
    C = bound.select([bound.names.index(name) for name in names]).matrix
    errors = np.array(errors)
    # the sum over the runs of each squared error in units of the bound is chi-square with one degree of
    # freedom a run; eight quantities, so that 1e-5 on both sides fails in less than two seeds of 10,000
    low, high = chi2.ppf([1e-5, 1 - 1e-5], runs)
    squares = (errors**2).sum(axis=0) / np.diagonal(C)
    assert (squares > low).all()
    assert (squares < high).all()
    # the same for the offset as a vector, correlations included: three degrees of freedom a run
    together = np.einsum("ri,ij,rj->", errors[:, :3], np.linalg.inv(C[:3, :3]), errors[:, :3])
    low, high = chi2.ppf([1e-5, 1 - 1e-5], 3 * runs)
    assert low < together < high


def test_scales_with_the_noise_and_the_poses():
    truth, motion = machine(8, 0.1, 0.01), few()
    once = cramer_rao(truth.torus(), motion.angles, problem(truth, motion), SIGMA_T, SIGMA_R).matrix
    louder = cramer_rao(truth.torus(), motion.angles, problem(truth, motion), 3 * SIGMA_T, 3 * SIGMA_R).matrix
    np.testing.assert_allclose(louder, 9 * once, rtol=1e-6, atol=1e-9 * np.abs(once).max())
    twice = joined(motion, motion)
    halved = cramer_rao(truth.torus(), twice.angles, problem(truth, twice), SIGMA_T, SIGMA_R).matrix
    np.testing.assert_allclose(halved, once / 2, rtol=1e-6, atol=1e-9 * np.abs(once).max())
