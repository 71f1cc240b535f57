"""Bases and mounts in closed form, on poses made by SciPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from helpers.simulated import frame, rigid
from solvers.chain.robot_world import robot_world
from solvers.estimate import Note


def data(seed, n=60, bases=1, sensors=1, sigma=0.0):
    """Bases X, mounts Y, kinematics F, T = X F Y with noise, and which of each every pose belongs to."""
    rng = np.random.default_rng(seed)
    X, Y = (np.stack([frame(rng, 1.0) for _ in range(k)]) for k in (bases, sensors))
    F = np.stack([frame(rng, 0.5) for _ in range(n)])
    p, s = rng.integers(bases, size=n), rng.integers(sensors, size=n)
    T = X[p] @ F @ Y[s]
    T[:, :3, 3] += sigma * rng.normal(size=(n, 3))
    T[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(sigma * rng.normal(size=(n, 3))).as_matrix()
    return X, Y, F, T, p, s


def solve(T, F, p, s, X, Y):
    return robot_world(T, F, p, s, len(X), len(Y))


@given(st.integers(0, 10_000), st.integers(1, 3), st.integers(1, 3))
@settings(max_examples=25)
def test_exact(seed, bases, sensors):
    X, Y, F, T, p, s = data(seed, 60, bases, sensors)
    found = solve(T, F, p, s, X, Y)
    np.testing.assert_allclose(found.T_world_base, X, atol=1e-9)
    np.testing.assert_allclose(found.T_last_sensor, Y, atol=1e-9)
    assert found.agrees.all()


@pytest.mark.parametrize("share", [0.1, 0.2, 0.3, 0.4])
def test_outliers_are_left_out(share):
    X, Y, F, T, p, s = data(4, 200, 2, 2, sigma=1e-4)
    rng = np.random.default_rng(5)
    gross = rng.permutation(200)[: round(200 * share)]
    for i in gross:
        T[i] = T[i] @ rigid(np.concatenate([rng.uniform(-0.5, 0.5, 3), rng.uniform(-2, 2, 3)]))
    found = solve(T, F, p, s, X, Y)
    assert not found.agrees[gross].any()
    assert found.agrees.sum() > 0.95 * (200 - len(gross))
    np.testing.assert_allclose(found.T_world_base, X, atol=1e-3)
    np.testing.assert_allclose(found.T_last_sensor, Y, atol=1e-3)


def test_a_base_seen_by_one_sensor_only_follows_from_the_others():
    """Base 1 is seen by sensor 1 alone, which base 0 links to sensor 0; base 1 turns about one axis."""
    X, Y, F, _, p, s = data(6, 60, 2, 2)
    s = np.where(p == 1, 1, s)
    F[p == 1] = F[0] @ np.stack([rigid(np.array([0, 0, 0, 0, 0, a])) for a in np.linspace(0, 1, (p == 1).sum())])
    found = solve(X[p] @ F @ Y[s], F, p, s, X, Y)
    np.testing.assert_allclose(found.T_world_base, X, atol=1e-9)
    np.testing.assert_allclose(found.T_last_sensor, Y, atol=1e-9)


def test_one_axis_is_refused():
    X, Y, F, _, p, s = data(7)
    F = F[0] @ np.stack([rigid(np.array([0, 0, 0.1 * a, 0, 0, a])) for a in np.linspace(-2, 2, 60)])
    found = solve(X[p] @ F @ Y[s], F, p, s, X, Y)
    assert isinstance(found, Note)
    assert found.code == "one_axis_only"


def test_two_machines_that_nothing_links_are_refused():
    X, Y, F, _, p, _ = data(8, 60, 2, 2)
    found = solve(X[p] @ F @ Y[p], F, p, p, X, Y)
    assert isinstance(found, Note)
    assert found.code == "unobservable"


def test_a_base_without_poses_is_refused():
    X, Y, F, T, p, s = data(9, 60, 2, 1)
    here = p == 0
    assert isinstance(solve(T[here], F[here], p[here], s[here], X, Y), Note)
