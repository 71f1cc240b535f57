"""Smooth random functions against their covariance."""

import numpy as np
import pytest

from solvers.effects.process import Process, grid


@pytest.mark.parametrize("length", [0.5, 1.5])
def test_the_basis_gives_the_covariance(length):
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, size=(20, 2))
    basis = Process.over(grid(np.array([-1.0, -1.0]), np.array([1.0, 1.0]), 9), length).basis(x)
    square = ((x[:, None] - x) ** 2).sum(axis=2)
    np.testing.assert_allclose(basis.T @ basis, np.exp(-0.5 * square / length**2), atol=0.01)


def test_a_centred_one_has_no_mean():
    nodes = grid(np.array([-1.0, 0.0]), np.array([1.0, 2.0]), 9)
    basis = Process.over(nodes, 1.0, centred=True).basis(nodes)
    np.testing.assert_allclose(basis.mean(axis=1), 0, atol=1e-9)
    assert (np.diff((basis**2).mean(axis=1)) < 1e-12).all()  # those of the greatest variance first


def test_a_grid_fills_the_box():
    points = grid(np.array([0.0, 1.0]), np.array([1.0, 3.0]), 3)
    assert sorted(map(tuple, points)) == [(a, b) for a in (0, 0.5, 1) for b in (1, 2, 3)]
