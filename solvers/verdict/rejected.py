"""Whether the poses that agree are the sound ones: where the others stand, and what the agreeing ones did."""

import numpy as np

from solvers.estimate import Note
from solvers.problem import Problem

MOST_IN_BLOCKS = 0.2
"""Largest share of all poses that may be rejected in long stretches."""
CHANCE = 0.01
"""Probability that poses rejected at random make a stretch that counts as long."""
LEAST_STRETCH = 6
LEAST_SPAN_M = 0.005
"""Positions that span less while the sensor turns stand still."""
TURNED = 0.1
"""Range of an entry of the rotation matrices from which on the sensor counts as turning."""


def doubtful(problem: Problem, used: np.ndarray) -> Note | None:
    """A refusal where the poses not ``used`` (N,) are more than outliers among sound poses."""
    return _at_rest(problem, used) or _in_blocks(used)


def _at_rest(problem: Problem, used: np.ndarray) -> Note | None:
    """A tracker that holds the position while the orientation goes on is explained exactly by a sensor at the pivot."""
    R, share = problem.R_world_sensor, 1 - used.mean()
    if R is None or share <= MOST_IN_BLOCKS or not used.any():
        return None
    span = np.ptp(problem.p_world_sensor[used], axis=0).max()
    if span >= LEAST_SPAN_M or np.ptp(R[used], axis=0).max() <= TURNED:
        return None
    poses = np.flatnonzero(used)
    return Note(
        "position_at_rest",
        f"the {len(poses)} poses that agree, from pose {poses[0]} to {poses[-1]}, stand within {span * 1e3:.2g} mm "
        f"while the sensor turns, and the other {share:.0%} do not fit them: the tracker seems to have held the "
        "position there, or written it in another unit; take these poses out",
    )


def _in_blocks(used: np.ndarray) -> Note | None:
    """Outliers are scattered; a long stretch of them is a machine, a tool or a unit of its own."""
    share = 1 - used.mean()
    if share <= MOST_IN_BLOCKS or share == 1:
        return None
    edges = np.flatnonzero(np.diff(np.concatenate([[True], used, [True]]).astype(int)))
    starts, ends = edges[::2], edges[1::2]
    # of N poses rejected at random, N (1 - s) s^k stretches of k or more are expected
    longest = np.log(len(used) * (1 - share) / CHANCE) / -np.log(share)
    long = ends - starts >= max(longest, LEAST_STRETCH)
    within = int((ends - starts)[long].sum())
    if within <= MOST_IN_BLOCKS * len(used):
        return None
    spans = ", ".join(f"{a} to {b - 1}" for a, b in list(zip(starts[long], ends[long], strict=True))[:3])
    more = f" and {long.sum() - 3} more stretches" if long.sum() > 3 else ""
    return Note(
        "misfit",
        f"{within / len(used):.0%} of the poses disagree with the others in long stretches (poses {spans}{more}): "
        "another tool, another place of the base or of the sensor; take them out, or give each place of the base a "
        "'placement'",
    )
