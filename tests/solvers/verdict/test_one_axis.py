"""One axis that turns: its circle, and how far the positions must leave it to tell of another axis."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solvers.problem import Problem
from solvers.verdict.one_axis import circle_of, one_circle, turns_untold


def two_turns(first_deg: float, second_deg: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) and orientations of a body at 0.6 m from one axis and 0.7 m from another across it."""
    s = np.linspace(0, 1, 200)
    a = np.radians(first_deg) * (s - 0.5)
    b = np.radians(second_deg) * 0.5 * np.sin(14 * s)
    turn = Rotation.from_rotvec(np.outer(b, [1, 0, 0])) * Rotation.from_rotvec(np.outer(a, [0, 1, 0]))
    return Rotation.random(random_state=seed).apply(turn.apply([0.0, 0.1, 0.65])), turn.as_matrix()


def test_the_circle_of_an_arc():
    theta = np.linspace(0, 1.2, 50)
    axis = np.array([0.6, 0.0, 0.8])
    p = Rotation.from_rotvec(np.outer(theta, axis)).apply([0.3, 0.4, 1.0])
    found = circle_of(p, axis)
    at = np.array([0.3, 0.4, 1.0])
    assert found.radius == pytest.approx(np.linalg.norm(np.cross(axis, at)))
    np.testing.assert_allclose(found.centre, axis * (axis @ at), atol=1e-9)
    assert found.off < 1e-9
    assert found.arc == pytest.approx(1.2)


@pytest.mark.parametrize("seed", range(10))
def test_a_second_axis_is_told_by_more_than_five_degrees(seed):
    """By 3 degrees it is not, with whatever noise; by 10 it is."""
    for second, told in ((0.0, False), (3.0, False), (10.0, True)):
        p, R = two_turns(120.0, second, seed)
        assert (one_circle(p) == ()) == told
        assert (turns_untold(Problem.of_poses(p, R)) == ()) == told


def test_positions_at_rest_tell_nothing():
    p = 1.0 + 1e-3 * np.random.default_rng(0).normal(size=(100, 3))
    assert "stand still" in one_circle(p)[0]
