"""The runout of an axis, against wanders in closed form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solvers.problem import Problem
from solvers.verdict.one_axis import one_axis_in_words
from solvers.verdict.runout import runout

THETA = np.linspace(0, 2 * np.pi, 720, endpoint=False)
X = np.eye(3)


def path(x, y, z):
    return np.stack([np.broadcast_to(part, THETA.shape) for part in (x, y, z)], axis=1).astype(float)


def leaning(x, y):
    direction = path(x, y, 1.0)
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


def test_an_ellipse_of_the_second_order():
    """Two orders of 0.3 and 0.1 mm in opposite senses make an ellipse of the axes 0.8 and 0.4 mm; an eccentric point
    and the place of the line are none of it, along the axis the first order is."""
    a, b, eccentric = 3e-4, 1e-4, 5e-3
    x = 0.2 + eccentric * np.cos(THETA) + a * np.cos(2 * THETA) + b * np.cos(2 * THETA)
    y = -0.1 + eccentric * np.sin(THETA) + a * np.sin(2 * THETA) - b * np.sin(2 * THETA)
    along = 0.7 + 2e-4 * np.sin(THETA)
    found = runout(THETA, path(x, y, along), leaning(1e-3 * np.cos(2 * THETA), 0.0), X[2])
    assert found.radial.size == pytest.approx(2 * (a + b), rel=1e-4)
    assert found.axial.size == pytest.approx(4e-4, rel=1e-4)
    assert found.wobble.size == pytest.approx(2e-3, rel=1e-4)
    assert found.radial.told
    assert found.axial.told
    assert found.wobble.told


def test_a_perfect_axis_has_none_within_the_noise():
    """Of 200 recordings of noise, at most a few in a thousand are told; the ± is what noise makes of one difference."""
    told, sizes = 0, []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        point = 1e-4 * rng.normal(size=(720, 3))
        found = runout(THETA, point, leaning(*(1e-3 * rng.normal(size=(2, 720)))), X[2])
        told += found.radial.told + found.axial.told + found.wobble.told
        sizes.append(found.radial.size / found.radial.sigma)
    assert told <= 3
    assert 1 < np.mean(sizes) < 4


def test_the_sigma_is_that_of_repetition():
    """Scatter of 300 repetitions, 4% uncertain: bound at 5 of these."""
    a, sigma, sizes, stated = 1e-3, 1e-4, [], []
    for seed in range(300):
        noise = sigma * np.random.default_rng(seed).normal(size=(720, 3))
        found = runout(THETA, path(0.0, 0.0, a * np.cos(THETA)) + noise, leaning(0.0, 0.0), X[2])
        sizes.append(found.axial.size)
        stated.append(found.axial.sigma)
    assert np.std(sizes) == pytest.approx(np.mean(stated), rel=0.2)
    assert np.mean(sizes) == pytest.approx(2 * a, rel=0.01)


def test_an_arc_has_what_lies_on_it():
    """Over 90 degrees the first order along the axis walks from 0 to its amplitude."""
    quarter = slice(0, 180)
    point = path(0.0, 0.0, 5e-4 * np.sin(THETA))[quarter]
    found = runout(THETA[quarter], point, leaning(0.0, 0.0)[quarter], X[2])
    assert found.axial.size == pytest.approx(5e-4, rel=1e-3)
    assert runout(THETA[:9], point[:9], leaning(0.0, 0.0)[:9], X[2]) is None


@pytest.mark.parametrize("seed", range(3))
def test_it_is_told_of_the_axis_that_turned(seed):
    """A gantry whose bearing lifts by 0.5 mm along its axis twice a turn, 1 mm peak to peak, seen anywhere."""
    rng = np.random.default_rng(seed)
    frame, mount = (Rotation.random(random_state=seed + k) for k in (0, 50))
    turn = Rotation.from_rotvec(THETA[:, None] * X[2])
    p = turn.apply([0.6, 0.1, 0.2]) + path(0.0, 0.0, 5e-4 * np.cos(2 * THETA))
    p = frame.apply(p) + [1.0, 2.0, 0.5] + 5e-5 * rng.normal(size=p.shape)
    R = (frame * turn * mount * Rotation.from_rotvec(2e-4 * rng.normal(size=p.shape))).as_matrix()
    (words,) = one_axis_in_words(Problem.of_poses(p, R))
    axial = words.split("axial runout ")[1].split(" ± ")[0]
    assert float(axial) == pytest.approx(1.0, abs=0.06)
    assert "deg within the noise (peak to peak over the turn)" in words
