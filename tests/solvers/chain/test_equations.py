"""The normal equations of a chain, single values eliminated, against one dense problem with every value in it."""

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
    drawn,
    hand_made,
    observed,
    with_readings,
)
from solvers.chain.equations import factors, normal_equations
from solvers.chain.identifiable import identifiable
from solvers.chain.machine import Machine
from solvers.chain.noise import helmert, redundancy
from solvers.chain.problem import KINDS, ChainProblem, Layout


def mixed(seed: int = 0) -> tuple[Machine, ChainProblem, np.ndarray]:
    """Two bases, two sensors on branches, a turning and a sliding joint read, one constant, one free, one known."""
    machine = changed(hand_made("rprrr", bases=2, paths=((0, 1, 2), (0, 3, 4)), seed=seed), "gains", 0, 0.03)
    n = 16
    base, sensor = np.arange(n) % 2, (np.arange(n) // 2) % 2
    values = drawn(machine, n, seed)
    sweep = np.arange(n) // 4
    values[:, 2] = values[4 * sweep, 2]
    problem = observed(machine, values, (SIGMA_T, SIGMA_R), seed, base, sensor)
    problem = with_readings(with_readings(problem, [0], SIGMA_Q, seed), [1], SIGMA_L, seed + 1)
    label, held = problem.label.copy(), problem.held.copy()
    label[sensor == 0, 2], held[:, 2] = np.nan, sweep
    label[sensor == 1, 4], held[sensor == 1, 4] = np.nan, -1
    for s, path in enumerate(machine.paths):
        aside = np.ix_(sensor == s, ~np.isin(np.arange(5), path))
        label[aside], held[aside], values[aside] = 0.0, 0, 0.0
    return machine, replace(problem, label=label, held=held), values


@pytest.fixture(scope="module")
def case():
    machine, problem, values = mixed()
    J, A, r, kinds, where = dense(machine, problem, values, SIGMA)
    everyone = np.ones(J.shape[1], dtype=bool)
    used = np.ones(len(problem), dtype=bool)
    layout = Layout.of(problem, machine)
    at = normal_equations(machine, values, problem, layout, SIGMA, used, everyone)
    off = np.eye(len(r)) - A @ np.linalg.pinv(A)
    return machine, problem, values, layout, at, J, A, r, kinds, where, off


def close(found, expected, tolerance=1e-6):
    """To a part of the largest."""
    np.testing.assert_allclose(found, expected, atol=tolerance * np.abs(expected).max())


def test_reduced_equations_are_those_of_the_dense_problem(case):
    *_, at, J, _, r, kinds, _, off = case
    U, left = off @ J, off @ r
    close(at.H, J.T @ off @ J)
    close(at.g, J.T @ off @ r)
    for kind in range(KINDS):
        rows = kinds == kind
        close(at.H_by_kind[kind], U[rows].T @ U[rows])
        close(at.g_by_kind[kind], U[rows].T @ left[rows])
        assert at.squares[kind] == pytest.approx((left[rows] ** 2).sum(), rel=1e-6)
    assert at.cost == pytest.approx(left @ left, rel=1e-6)


def active_of(case):
    machine, problem, values, layout = case[:4]
    used, wanted = np.ones(len(problem), dtype=bool), np.ones(layout.size, dtype=bool)
    rows, length = factors(machine, values, problem, layout, SIGMA, used, wanted)
    return identifiable(rows, length, [np.arange(layout.size)]).active, rows


def test_factors_hold_the_same_information(case):
    at, rows = case[4], active_of(case)[1]
    close(rows.T @ rows, at.H, 1e-9)


def test_rank_is_that_of_the_dense_problem(case):
    J, off = case[5], case[10]
    scaled = off @ J / np.maximum(np.linalg.norm(J, axis=0), 1e-12)
    assert active_of(case)[0].sum() == np.linalg.matrix_rank(scaled, tol=1e-5)  # differences are good to 1e-8


def test_steps_of_all_unknowns_are_those_of_the_dense_problem(case):
    problem, values, layout, at, J, A, r, _, where, _ = case[1:]
    active = active_of(case)[0]
    expected = np.linalg.lstsq(np.concatenate([J[:, active], A], axis=1), -r, rcond=1e-12)[0]
    inner = np.ix_(active, active)
    step = np.zeros(layout.size)
    step[active] = -np.linalg.solve(at.H[inner], at.g[active])
    close(step[active], expected[: active.sum()], 1e-4)
    found = at.value_step(step, values.shape)
    close([found[n, j] for n, j in where], expected[active.sum() :], 1e-4)
    constants = layout.constant_step(problem, step)
    assert (constants[problem.constant < 0] == 0).all()
    for k in range(layout.constants):
        assert (constants[problem.constant == k] == step[layout.constant(k)]).all()


def test_squares_after_a_step(case):
    layout, at, J, _, r, kinds, _, off = case[3:]
    rng = np.random.default_rng(0)
    step = 1e-4 * rng.normal(size=layout.size)
    left = off @ (r + J @ step)
    found = at.squares_after(step)
    for kind in range(KINDS):
        assert found[kind] == pytest.approx((left[kinds == kind] ** 2).sum(), rel=1e-5)


def test_redundancy_and_helmerts_matrix(case):
    *_, at, J, A, r, kinds, _, off = case
    for a in range(KINDS):
        for b in range(KINDS):
            expected = np.trace(off[kinds == a][:, kinds == b] @ off[kinds == b][:, kinds == a])
            assert at.counts[a, b] == pytest.approx(expected, abs=1e-6)
    active = active_of(case)[0]
    whole = np.concatenate([J[:, active], A], axis=1)
    M = np.eye(len(r)) - whole @ np.linalg.pinv(whole)
    C = np.zeros_like(at.H)
    C[np.ix_(active, active)] = np.linalg.inv(at.H[np.ix_(active, active)])
    found, left = helmert(at, C), redundancy(at, C)
    for a in range(KINDS):
        assert left[a] == pytest.approx(np.trace(M[kinds == a][:, kinds == a]), abs=1e-5)
        for b in range(KINDS):
            expected = np.trace(M[kinds == a][:, kinds == b] @ M[kinds == b][:, kinds == a])
            assert found[a, b] == pytest.approx(expected, abs=1e-5)


def test_unused_poses_have_no_say(case):
    machine, problem, values, layout = case[:4]
    used = np.arange(len(problem)) % 3 > 0
    wanted = np.ones(layout.size, dtype=bool)
    at = normal_equations(machine, values, problem, layout, SIGMA, used, wanted)
    part = problem.select(np.flatnonzero(used))
    alone = normal_equations(machine, values[used], part, layout, SIGMA, np.ones(len(part), dtype=bool), wanted)
    close(at.H, alone.H, 1e-12)
    close(at.counts, alone.counts, 1e-12)
    assert (at.distance2 > 0).all()


def test_what_is_not_wanted_is_left_out(case):
    machine, problem, values, layout, at = case[:5]
    wanted = np.random.default_rng(1).random(layout.size) < 0.5
    some = normal_equations(machine, values, problem, layout, SIGMA, np.ones(len(problem), dtype=bool), wanted)
    both = np.outer(wanted, wanted)
    np.testing.assert_allclose(some.H, np.where(both, at.H, 0.0), rtol=1e-12)
    np.testing.assert_allclose(some.g, np.where(wanted, at.g, 0.0), rtol=1e-12)
