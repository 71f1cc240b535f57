"""Labels of held joints that are readings: their place in the likelihood, their weight, what they do to the offset.

The normal equations are compared with a dense system, the estimate with SciPy's least squares of poses written out
in `carm_kin.testing.truth`.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from helpers.simulated import crlb, joined, machine, problem, sweeps_deg
from solvers import kinematic
from solvers.likelihood.elimination import normal_equations
from solvers.likelihood.linearise import AngleModel, linearise, retract
from solvers.problem import Problem

NOISE = (2e-4, float(np.radians(0.08)))
OFFSET = [f"offset_sensor_pivot_{axis}" for axis in "xyz"]
TURN = np.arange(0, 360, 60)
SMALL = joined(sweeps_deg((-50, 0, 80), TURN, (10, 70), TURN), sweeps_deg((-20, 30), TURN, (40,), TURN, placement=1))
ARC = np.arange(-80, 81, 8)
ODD = sweeps_deg((-61.3, -20.4, 13.7, 44.2, 81.9), ARC, (-33.2, 21.6, 66.7), ARC)
EVEN = sweeps_deg((-61, -20, 14, 44, 82), ARC, (-33, 22, 67), ARC)
TRUTH = machine(7, 0.05, 0.005)
SEEDS = 40


def read(data: Problem, sigma: float, error=lambda label: label) -> Problem:
    """The same with the labels changed by ``error`` and good to ``sigma`` rad."""
    return replace(data, label=error(data.label), sigma_label=np.full(data.held.shape, sigma))


def rounded(data: Problem, step_deg: float) -> Problem:
    step = np.radians(step_deg)
    return read(data, step / np.sqrt(12), lambda label: np.round(label / step) * step)


def off_by(data: Problem, degrees: float, sigma: float, seed: int) -> Problem:
    """Every label off by up to so many degrees, one error a sweep."""
    error = np.radians(degrees) * np.random.default_rng([seed, 3]).uniform(-1, 1, data.held.max() + 1)
    return read(data, sigma, lambda label: label + error[data.held])


@pytest.mark.parametrize("share_used", [1.0, 0.7])
def test_normal_equations_against_the_dense_system(share_used):
    rng = np.random.default_rng(1)
    truth = machine(4, 0.1, 0.02, 2)
    order = rng.permutation(len(SMALL))
    data = off_by(problem(truth, SMALL, 3e-3, 3e-3), 1.0, 0.004, 1).select(order)
    data = replace(data, label=np.where(data.held == 1, np.nan, data.label))  # one sweep without a label
    torus = retract(truth.torus(), 0.002 * rng.normal(size=20))
    model = AngleModel.of(data)
    angles = model.start(torus, data)
    used = rng.random(len(data)) < share_used
    line, sigma = linearise(torus, angles, data), (2e-3, 3e-3)
    at = normal_equations(torus, angles, data, model, sigma, None if used.all() else used)
    J, r, kind = _dense(data, line, angles, used, sigma)
    A = J[:, 20:]
    hat = A @ np.linalg.solve(A.T @ A, A.T)
    left = np.eye(len(r)) - hat
    spread = np.sqrt(np.diagonal(J.T @ J)[:20])
    np.testing.assert_allclose(
        at.H / np.outer(spread, spread), J[:, :20].T @ left @ J[:, :20] / np.outer(spread, spread), atol=1e-9
    )
    np.testing.assert_allclose(at.g / spread, J[:, :20].T @ left @ r / spread, atol=1e-8 * np.linalg.norm(r))
    np.testing.assert_allclose(at.redundancy, [np.diagonal(left)[kind == k].sum() for k in (0, 1)], rtol=1e-9)
    assert at.cost == pytest.approx((r**2).sum(), rel=1e-9)
    x = 1e-3 * rng.normal(size=20)
    after = left @ (r + J[:, :20] @ x)
    found = np.divide(at.squares_after(x), np.square(sigma))
    np.testing.assert_allclose(found, [(after[kind == k] ** 2).sum() for k in (0, 1)], rtol=1e-8)
    labels = (left @ J[:, :20])[kind == 2]
    scale = np.outer(spread, spread)
    np.testing.assert_allclose(at.reading_information / scale, labels.T @ labels / scale, atol=1e-9)


def _dense(data: Problem, line, angles, used, sigma):
    """Rows of poses and labels: an unknown a pose for a moving joint, one a sweep for a held one, a row a label."""
    keys: dict[tuple, int] = {}

    def column(joint: int, i: int) -> int:
        key = (joint, "sweep", data.held[i, joint]) if data.held[i, joint] >= 0 else (joint, "pose", i)
        return keys.setdefault(key, 20 + len(keys))

    entries, r, kind, seen = [], [], [], set()
    for i in np.flatnonzero(used):
        for row in range(6):
            w, p = 1 / sigma[row // 3], 6 * data.placement[i]
            local = dict(zip((*range(p, p + 6), *range(12, 20)), w * line.by_local[row, :, i], strict=True))
            entries.append(local | {column(j, i): w * line.by_angle[row, j, i] for j in (0, 1)})
            r.append(w * line.residual[row, i])
            kind.append(row // 3)
        for j in (0, 1):
            if np.isfinite(data.label[i, j]) and column(j, i) not in seen:
                seen.add(column(j, i))
                entries.append({column(j, i): 1 / data.sigma_label[i, j]})
                r.append((angles[j, i] - data.label[i, j]) / data.sigma_label[i, j])
                kind.append(2)
    J = np.zeros((len(entries), 20 + len(keys)))
    for row, entry in enumerate(entries):
        J[row, list(entry)] = list(entry.values())
    return J, np.array(r), np.array(kind)


def test_the_estimate_is_that_of_least_squares_by_scipy():
    # few poses and labels that count: 0.1 deg against 1 deg of orientation noise
    turn = np.arange(-60, 61, 30)
    motion = sweeps_deg((-50, 0, 60), turn, (-30, 40), turn)
    truth = machine(3, 0.08, 0.01)
    sigma = (1e-3, float(np.radians(1.0)))
    data = read(problem(truth, motion, *sigma, seed=2), float(np.radians(0.1)))
    data = replace(data, sigma_t=sigma[0], sigma_r=sigma[1])
    found = kinematic.solve(data, kinematic.Options(reject_outliers=False, fix_non_orthogonality=False, tolerance=1e-6))
    sweep = np.where(data.held[:, 0] >= 0, 0, 1)
    n, first = np.arange(len(data)), np.unique(data.held.max(axis=1), return_index=True)[1]

    def residuals(x):
        here, angles = truth.moved(x[:14]), np.empty((len(data), 2))
        angles[n, sweep] = x[14:19][data.held.max(axis=1)]
        angles[n, 1 - sweep] = x[19:]
        p, R = here.poses(angles, data.placement)
        turned = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ data.rotations).as_rotvec()
        label = (x[14:19] - data.label[first, sweep[first]]) / np.radians(0.1)
        return np.concatenate([((p - data.p_world_sensor) / sigma[0]).ravel(), (turned / sigma[1]).ravel(), label])

    start = np.concatenate([np.zeros(14), motion.angles[first, sweep[first]], motion.angles[n, 1 - sweep]])
    best = least_squares(residuals, start, xtol=1e-14, ftol=1e-14)
    expected = truth.moved(best.x[:14]).torus()
    sd = found.covariance.sigma(*OFFSET)
    assert (np.abs(found.offset - expected.offset) < 0.01 * sd).all()
    assert np.abs(found.angles[first, sweep[first]] - best.x[14:19]).max() < 0.01 * np.radians(0.1)


def fitted(change):
    """Errors of the offset (SEEDS, 3), m, and whether the 95% intervals hold it."""
    errors, holds = [], []
    for seed in range(SEEDS):
        found = kinematic.solve(change(problem(TRUTH, ODD, *NOISE, seed=seed), seed))
        errors.append(found.offset - TRUTH.torus().offset)
        holds.append(np.abs(errors[-1]) < 1.96 * found.covariance.sigma(*OFFSET))
    return np.array(errors), np.array(holds)


@pytest.fixture(scope="module")
def without_labels():
    return fitted(lambda data, seed: replace(data, label=np.full(data.label.shape, np.nan)))


@pytest.mark.parametrize(
    "change",
    [
        lambda data, seed: rounded(data, 1.0),
        lambda data, seed: rounded(data, 0.1),
        lambda data, seed: off_by(data, 0.5, 3e-9, seed),
        lambda data, seed: off_by(data, 0.1, 5e-4, seed),
    ],
    ids=["rounded to 1 deg", "rounded to 0.1 deg", "off by 0.5 deg, six digits", "off by 0.1 deg, written to 0.1"],
)
def test_labels_do_not_spoil_the_offset(change, without_labels):
    errors, holds = fitted(change)
    rms, expected = (np.sqrt((e**2).sum(axis=1).mean()) for e in (errors, without_labels[0]))
    assert rms < 1.05 * expected
    # 120 components, correlated in threes: a share of 95% has a standard error of at most sqrt(.05 * .95 / 40)
    assert holds.mean() > 0.95 - 2.5 * np.sqrt(0.05 * 0.95 / SEEDS)


def test_exact_whole_degrees_are_as_good_as_the_bound_without_labels():
    bound = np.sqrt(np.trace(crlb(TRUTH, EVEN.without_labels(), *NOISE)[:3, :3]))
    found = kinematic.solve(rounded(problem(TRUTH, EVEN, *NOISE, seed=1), 1.0))
    assert np.linalg.norm(found.covariance.sigma(*OFFSET)) < 1.1 * bound  # the noise is estimated to some percent
    assert not found.notes
    assert found.torus.referenced.all()
    assert found.torus.orbital_referenced


def test_labels_of_many_digits_that_agree_are_as_good_as_exact_ones():
    for seed in range(3):
        data = problem(TRUTH, ODD, *NOISE, seed=seed)
        exact, found = kinematic.solve(data), kinematic.solve(read(data, 3e-9))
        if found.sigma_label[data.label_read | (data.held >= 0)].max() < 1e-8:  # the noise did not contradict them
            assert (np.abs(found.offset - exact.offset) < 0.05 * exact.covariance.sigma(*OFFSET)).all()


def test_labels_that_contradict_the_poses_are_told():
    data = problem(TRUTH, ODD, *NOISE, seed=1)
    (note,) = kinematic.solve(off_by(data, 0.5, 3e-9, 1)).notes
    assert note.code == "labels_disagree"
    assert not kinematic.solve(rounded(data, 0.1)).notes


def test_one_label_that_is_five_degrees_off_is_named_and_its_poses_kept():
    data = rounded(problem(TRUTH, ODD, *NOISE, seed=1), 1.0)
    off = np.where(data.held == 1, np.radians(5), 0.0)
    found = kinematic.solve(replace(data, label=data.label + off))
    (note,) = found.notes
    assert note.code == "wrong_label"
    assert "sweep 2" in note.message
    assert "by 5" in note.message
    assert found.used.all()
    sd = found.covariance.sigma(*OFFSET)
    assert (np.abs(found.offset - TRUTH.torus().offset) < 4 * sd).all()
