"""A machine with play: the sensor stands elsewhere after a joint has turned back, as after a move.

docs/estimation.md, section 12.
"""

import numpy as np

from solvers.effects.process import play
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.verdict.change import SENSOR, left_of

WIDTH = float(np.radians(0.5))
"""Angle on either side of the middle within which a joint that turns back takes up its play."""
MOST_POSES = 10_000
"""Poses at which the play is followed; of more, evenly picked ones."""


def with_play(rows: Array, angles: Array, problem: Problem) -> Array:
    """The `solvers.verdict.change.rows_of` (6, C, N) with a displacement of the sensor by the `taken_up` play of either
    joint among the nuisance: (6, C + 12, N)."""
    own = [rows[:, SENSOR] * taken_up(angle, problem.placement) for angle in angles]
    return np.concatenate([rows[:, :-1], *own, rows[:, -1:]], axis=1)


def lowered_by_play(rows: Array, angles: Array, problem: Problem) -> float:
    """By how much the play of both joints lowers the weighted sum of squares."""
    return left_of(rows, problem) - left_of(with_play(rows, angles, problem), problem)


def taken_up(angle: Array, placement: np.ndarray) -> Array:
    """(N,) from -1 to 1 at which end of its play a joint lies at the angles (N,), rad, of poses in time. It begins
    every placement in the middle."""
    step = -(-len(angle) // MOST_POSES)
    way, group = np.asarray(angle)[::step] / WIDTH, placement[::step]
    parts = np.split(way, np.flatnonzero(np.diff(group)) + 1)
    return np.repeat(np.concatenate([play(part) for part in parts]), step)[: len(angle)]
