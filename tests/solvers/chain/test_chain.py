"""Maximum likelihood of a whole machine: exact on exact poses, robust, and blind to frames and order."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.machines import (
    SIGMA_Q,
    SIGMA_R,
    SIGMA_T,
    changed,
    disturbed,
    drawn,
    everything,
    free,
    hand_made,
    observed,
    predicts,
    with_readings,
    without,
)
from helpers.simulated import frame, rigid
from solvers.chain.chain import Options, solve_chain
from solvers.se3 import inverse


@given(st.integers(0, 10_000), st.sampled_from(["rr", "prr", "rrr", "rprr"]))
@settings(max_examples=20)
def test_exact_on_exact_poses(seed, kinds):
    truth = hand_made(kinds, seed=seed)
    values = drawn(truth, 30, seed)
    start = disturbed(truth, seed)
    found = solve_chain(observed(truth, values), start, values, everything(truth))
    assert found.converged
    predicts(found, truth, 1e-9)


def test_two_sensors_on_two_branches_and_two_bases():
    truth = hand_made("rrrr", bases=2, paths=((0, 1, 2), (0, 3)), seed=3)
    values, n = drawn(truth, 60), np.arange(60)
    problem = observed(truth, values, base=n % 2, sensor=(n // 2) % 2)
    found = solve_chain(problem, disturbed(truth, 1), values, everything(truth))
    assert found.converged
    assert found.active.sum() == 4 * 4 + 6 + 6 + 6  # joints, the end of each branch, one base more
    predicts(found, truth, 1e-9)


def test_unknown_values_held_and_free():
    """One joint is constant and unknown in each of five sweeps, another unknown at every pose."""
    truth = hand_made("rrr", seed=5)
    sweep = np.arange(60) // 12
    values = drawn(truth, 60)
    values[:, 0] = values[12 * sweep, 0]
    problem = without(without(observed(truth, values), 0, sweep), 2)
    begin = values + np.where(np.isfinite(problem.label), 0.0, 0.05)
    found = solve_chain(problem, disturbed(truth, 2), begin, everything(truth))
    assert found.converged
    assert np.abs(found.residual).max() < 1e-9
    for k in range(5):
        assert np.ptp(found.values[sweep == k, 0]) < 1e-12
    turned = found.values[:, [0, 2]] - values[:, [0, 2]]
    assert np.ptp(turned, axis=0).max() < 1e-9  # all but a common zero, which nothing tells


def test_gains_and_zeros_are_found():
    truth = hand_made("rprr", seed=6)
    for j, (zero, gain) in enumerate([(0.01, 0.01), (0.002, -0.02), (-0.015, 0.005), (0.02, 0.0)]):
        truth = changed(changed(truth, "offsets", j, zero), "gains", j, gain)
    values = drawn(truth, 60)
    nominal = replace(truth, offsets=np.zeros(4), gains=np.zeros(4))
    found = solve_chain(observed(truth, values), nominal, values, free(truth, (), range(4), range(4)))
    np.testing.assert_allclose(found.machine.gains, truth.gains, atol=1e-9)
    predicts(found, truth, 1e-9)
    inner = found.active[[found.layout.offset(j) for j in range(4)]]
    np.testing.assert_allclose(found.machine.offsets[inner], truth.offsets[inner], atol=1e-9)


def test_outliers_get_no_weight():
    truth = hand_made("rrr", seed=7)
    values = drawn(truth, 100)
    problem = observed(truth, values, (SIGMA_T, SIGMA_R))
    T = problem.T_world_sensor.copy()
    gross = np.arange(100) % 5 == 0
    T[gross] = T[gross] @ np.stack([rigid(np.full(6, 0.1 * (k + 1))) for k in range(gross.sum())])
    spoilt = replace(problem, T_world_sensor=T)
    believed = np.ones(100, dtype=bool)
    believed[::10] = False
    found = solve_chain(spoilt, truth, values, everything(truth), used=~gross | ~believed)
    assert found.used.tolist() == (~gross).tolist()
    alone = problem.select(np.flatnonzero(~gross))
    clean = solve_chain(alone, truth, values[~gross], everything(truth))
    predicts(found, clean.machine, 2e-5)  # both stop within 0.01 sigma
    assert found.sigma[:2] == pytest.approx(clean.sigma[:2], rel=1e-2)


@given(st.integers(0, 1000))
@settings(max_examples=10)
def test_world_sensor_and_order_do_not_matter(seed):
    rng = np.random.default_rng(seed)
    truth = hand_made("rrr", seed=8)
    values = drawn(truth, 40)
    problem = with_readings(observed(truth, values, (SIGMA_T, SIGMA_R)), [0, 1, 2], SIGMA_Q)
    start = disturbed(truth, 3)
    options = Options(tolerance=1e-4, sigma_tolerance=1e-6)
    first = solve_chain(problem, start, problem.label, everything(truth), options)
    W, S, order = frame(rng, 2.0), frame(rng, 0.0), rng.permutation(40)  # a shifted sensor has another noise
    other = replace(problem, T_world_sensor=W @ problem.T_world_sensor @ S).select(order)
    moved = replace(start, T_world_base=W @ start.T_world_base, T_last_sensor=start.T_last_sensor @ S)
    second = solve_chain(other, moved, other.label, everything(truth), options)
    np.testing.assert_allclose(second.sigma[:3], first.sigma[:3], rtol=1e-4)
    near = replace(
        second.machine,
        T_world_base=inverse(W) @ second.machine.T_world_base,
        T_last_sensor=second.machine.T_last_sensor @ inverse(S),
    )
    predicts(first, near, 1e-6)
