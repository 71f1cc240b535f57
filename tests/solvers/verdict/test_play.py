"""A machine with play is told from a base or a sensor that was moved."""

import numpy as np
import pytest

from helpers.streamed import stream
from solvers import kinematic
from solvers.verdict.assess import assess
from solvers.verdict.play import WIDTH, taken_up


def test_the_play_is_taken_up_within_its_width_and_begins_in_the_middle():
    there = np.linspace(0.0, 4 * WIDTH, 41)
    state = taken_up(np.concatenate([there, there[::-1]]), np.zeros(82, dtype=int))
    np.testing.assert_allclose(state[[0, 5, 10, 40]], [0.0, 0.5, 1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(state[41:][[0, 10, 20, 40]], [1.0, 0.0, -1.0, -1.0], atol=1e-9)


def test_it_begins_anew_with_every_placement():
    state = taken_up(np.concatenate([np.linspace(0, 1, 20)] * 2), np.repeat([0, 1], 20))
    np.testing.assert_allclose(state[:20], state[20:])
    assert state[20] == 0


@pytest.mark.parametrize("seed", range(6))
def test_play_is_no_move(seed):
    given = stream(seed, backlash_mm=0.5)
    verdict = assess(given, kinematic.solve(given))
    moves = {"base_moved", "sensor_moved", "two_sensors"}
    assert not moves & {note.code for note in verdict.notes}
    assert verdict.refusal is None


def test_a_move_beside_play_is_one():
    given = stream(1, backlash_mm=0.25, bump_mm=3.0)
    verdict = assess(given, kinematic.solve(given))
    assert "base_moved" in {note.code for note in verdict.notes}
    assert verdict.refusal is not None
