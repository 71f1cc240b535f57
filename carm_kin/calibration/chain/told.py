"""What the motion of a chain tells: joints that hardly moved, and sensors that turned about one axis.

The notion is that of `solvers.told`: docs/estimation.md, "What is told".
"""

from dataclasses import replace

import numpy as np

from solvers.chain.chain import ChainEstimate, Free
from solvers.chain.problem import ANGLES, LENGTHS, ORIENTATIONS, POSITIONS, ChainProblem
from solvers.estimate import Note
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.told import noise_of_readings, noise_of_turns
from solvers.verdict.limits import Limits, least_arc
from solvers.verdict.one_axis import swept, turns_untold

MIN_TRAVEL_M = 0.010
"""A slide that travels by less is play or sag, whatever the noise."""


def untold(problem: ChainProblem) -> Note | None:
    """A refusal where no sensor turns about two directions in any placement: nothing tells the base and the mount."""
    pair = np.stack([problem.placement, problem.sensor], axis=1)
    found: tuple[str, ...] = ()
    for one in np.unique(pair, axis=0):
        T = problem.T_world_sensor[(pair == one).all(axis=1)]
        poses = Problem.of_poses(T[:, :3, 3], T[:, :3, :3])
        sentences = turns_untold(replace(poses, sigma_r=problem.sigma[ORIENTATIONS]))
        if not sentences:
            return None
        found = max(found, sentences, key=len)
    return Note("one_axis_only", "; ".join(found))


def at_rest(problem: ChainProblem, values: Array, limits: Limits = Limits()) -> np.ndarray:
    """(J,) joints that stand still, or of which the ``values`` (N, J) span less than noise, wobble and sag can fake:
    nothing is told of their numbers, which stay nominal.

    The least arc of a joint is that of the greater of the noises of the poses and of its own readings.
    """
    stretch = np.unique(np.stack([problem.placement, problem.sensor], axis=1), axis=0, return_inverse=True)[1].ravel()
    R = problem.T_world_sensor[:, :3, :3]
    pose = noise_of_turns(R, stretch, problem.sigma[ORIENTATIONS]).sigma
    given = problem.sigma[ANGLES]
    found = problem.still.copy()
    for j, slides in enumerate(problem.prismatic):
        if slides:
            found[j] |= np.ptp(values[:, j]) < _least_travel(problem)
            continue
        noise = noise_of_readings(np.where(problem.read[:, j], problem.label[:, j], np.nan), stretch, given)
        read = problem.read[:, j].any()
        found[j] |= swept(values[:, j]) < least_arc(max(pose, noise) if read else pose, limits)
    return found


def left_at_rest(estimate: ChainEstimate, free: Free) -> np.ndarray:
    """(J,) joints that were set ``free`` and had no part in the fit, since they were at rest."""
    layout, touched = estimate.layout, estimate.active.copy()
    touched[[one.unknown for one in estimate.dependent]] = True
    wanted = free.placements | free.offsets | free.gains
    own = [[*layout.placement(j), layout.offset(j), layout.gain(j)] for j in range(layout.joints)]
    return wanted & ~touched[np.array(own, dtype=int).reshape(layout.joints, -1)].any(axis=1)


def _least_travel(problem: ChainProblem) -> float:
    """Range, m, that the values of a slide have to span, of the noises that are given."""
    noise = max(problem.sigma[POSITIONS] or 0.0, problem.sigma[LENGTHS] or 0.0)
    return max(MIN_TRAVEL_M, Limits.min_arc_sigmas * noise)
