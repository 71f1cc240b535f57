"""Whether a chain's estimate can be trusted: why it is refused, and what there is to say of it."""

from dataclasses import replace

import numpy as np

from carm_kin.calibration.chain.model import ChainModel
from carm_kin.calibration.chain.numbers import DIRECTIONS, joint_changes
from carm_kin.calibration.chain.told import at_rest
from carm_kin.machine.urdf import listing
from carm_kin.results.chain_result import JointChange
from solvers.chain.chain import ChainEstimate
from solvers.chain.problem import ChainProblem
from solvers.estimate import Covariance, Note
from solvers.problem import Problem
from solvers.verdict.left_out import LeftOut, left_out
from solvers.verdict.limits import Limits, uncertain
from solvers.verdict.mixed_units import mixed_units
from solvers.verdict.residuals import correlated, correlation

WEAK_M, WEAK_RAD = 5e-3, float(np.radians(0.5))
"""A joint's number that is estimated to no better than this (one sigma) is warned of."""
OTHER_RAD = float(np.radians(30.0))
"""A joint's origin that would have to turn by more than this is no calibration of the same machine."""
FAR_M, FAR_RAD = 0.05, float(np.radians(5.0))
"""A joint's origin that changes by more than this is warned of."""
KINDS_IN_WORDS = ("positions", "orientations", "angle readings", "length readings")
MOSTLY = 0.5
"""Share above which the prior, or what was not free, counts as the greater part."""
COMPONENT = 0.3
"""Component of a unit vector from which on it counts as a part of the direction."""
MOST_ALIKE = 0.99
"""Correlation of neighbouring residuals beyond which they count as this much alike."""
LEFT_OUT_PROBABILITY = 1e-6
"""Probability of saying of sound numbers of the URDF that they should have been free."""


def units_mixed(problem: ChainProblem) -> Note | None:
    """A refusal where the positions of one sensor in one placement come in two units."""
    T = problem.T_world_sensor
    for poses in (np.flatnonzero(problem.sensor == s) for s in np.unique(problem.sensor)):
        placement = np.unique(problem.placement[poses], return_inverse=True)[1].ravel()
        part = Problem.of_poses(T[poses, :3, 3], T[poses, :3, :3])
        if note := mixed_units(replace(part, placement=placement)):
            return note
    return None


def unfreed(
    model: ChainModel, problem: ChainProblem, estimate: ChainEstimate, limits: Limits = Limits()
) -> LeftOut | None:
    """What the URDF's numbers that were not estimated would explain, by joint; None where noise alone explains it."""
    layout, moving = estimate.layout, np.flatnonzero(~at_rest(problem, estimate.values, limits))
    groups = {f"the origin of {model.names[j]}": layout.placement(j) for j in moving}
    groups |= {f"the zero of {model.names[j]}": np.array([layout.offset(j)]) for j in moving}
    groups |= {f"the gain of {model.names[j]}": np.array([layout.gain(j)]) for j in moving}
    alike = correlation(_neighbours(problem, estimate.used), estimate.residual[estimate.used].T)
    found = left_out(problem, estimate, groups, min(alike, MOST_ALIKE))
    return found if found and found.probability < LEFT_OUT_PROBABILITY else None


def refusal(
    model: ChainModel,
    problem: ChainProblem,
    estimate: ChainEstimate,
    covariance: Covariance,
    left: LeftOut | None,
    limits: Limits,
) -> Note | None:
    """Why the estimate is not given."""
    return (
        _systematic(left)
        or _misfit(problem, estimate, limits)
        or _other_machine(joint_changes(model, estimate))
        or _too_many_rejected(estimate, limits)
        or _not_converged(estimate)
        or uncertain(covariance, limits)
    )


def _misfit(problem: ChainProblem, estimate: ChainEstimate, limits: Limits) -> Note | None:
    sigma_t, sigma_r, angle, length = (float(s) for s in estimate.sigma)
    if sigma_t > limits.max_sigma_t_m or sigma_r > limits.max_sigma_r_rad:
        words = (
            f"no machine with the joints of this URDF explains these poses: the residuals amount to a noise of "
            f"{sigma_t * 1e3:.1f} mm and {np.degrees(sigma_r):.2f} deg; does a joint move that the recording does not "
            "mention, was the base moved, or is a unit, a sign or a joint's name wrong?"
        )
        return Note("misfit", words)
    lengths = problem.read & problem.prismatic
    readings = {
        f"{np.degrees(angle):.1f} deg": (problem.read & ~lengths).any() and angle > limits.max_sigma_r_rad,
        f"{length * 1e3:.1f} mm": lengths.any() and length > limits.max_sigma_t_m,
    }
    for size in (size for size, wrong in readings.items() if wrong):
        words = f"the joint readings contradict the poses by {size} (one sigma): is a sign, a unit or a name wrong?"
        return Note("misfit", words)
    if estimate.chi2_per_dof > limits.max_chi2_per_dof:
        words = f"residuals exceed the given noise: chi-square per degree of freedom {estimate.chi2_per_dof:.1f}"
        return Note("misfit", words)
    return None


def _other_machine(changes: tuple[JointChange, ...]) -> Note | None:
    turns = {change.joint: float(np.linalg.norm(change.turn_rad)) for change in changes}
    joint = max(turns, key=lambda name: turns[name], default="")
    if not joint or turns[joint] < OTHER_RAD:
        return None
    words = (
        f"the origin of {joint} would have to turn by {np.degrees(turns[joint]):.0f} deg: do its readings count the "
        "other way, or is it the URDF of another machine?"
    )
    return Note("misfit", words)


def _systematic(left: LeftOut | None) -> Note | None:
    if left is None or left.share < MOSTLY:
        return None
    return Note("misfit", f"{_left_out_words(left)}: free what is wrong (--free, --zeros, --gains)")


def _left_out_words(left: LeftOut) -> str:
    return (
        f"numbers of the URDF that were not free explain {left.share:.0%} of the squared residuals of "
        f"{KINDS_IN_WORDS[left.kind]}, most of all {left.most}"
    )


def _too_many_rejected(estimate: ChainEstimate, limits: Limits) -> Note | None:
    share = 1 - estimate.used.mean()
    if share <= limits.max_rejected_share:
        return None
    return Note("too_many_outliers", f"{share:.0%} of the poses agree with no machine that explains the others")


def _not_converged(estimate: ChainEstimate) -> Note | None:
    if estimate.converged:
        return None
    return Note("not_converged", f"the solver stopped after {estimate.iterations} steps without converging")


def notes(
    model: ChainModel, problem: ChainProblem, estimate: ChainEstimate, left: LeftOut | None, limits: Limits
) -> list[Note]:
    """What there is to say of an estimate."""
    found = []
    share = 1 - estimate.used.mean()
    if share > limits.silent_rejected_share:
        words = f"{share:.0%} of the poses do not agree with the others and were not used"
        found.append(Note("many_rejected", words))
    if left and left.share < MOSTLY:
        words = f"{_left_out_words(left)}; the stated uncertainty does not cover this"
        found.append(Note("more_to_free", words))
    if note := correlated(estimate.correlation, int(estimate.used.sum())):
        found.append(note)
    found += _notes_on_joints(joint_changes(model, estimate))
    if by_prior := _by_prior(model, estimate):
        words = f"the poses tell less than the prior of {', '.join(by_prior)}: these numbers stay near the nominal ones"
        found.append(Note("held_by_prior", words))
    if estimate.machine.gains.any():
        words = "a URDF has no gain of a joint: the calibrated file leaves them out"
        found.append(Note("gains_not_in_urdf", words))
    return found


def _neighbours(problem: ChainProblem, used: np.ndarray) -> np.ndarray:
    """(M - 1,) which of the M used poses were taken right after each other, with the same joints moving."""
    poses = np.flatnonzero(used)
    key = np.concatenate([problem.placement[:, None], problem.sensor[:, None], problem.held], axis=1)[poses]
    return (np.diff(poses) == 1) & (np.diff(key, axis=0) == 0).all(axis=1)


def _notes_on_joints(changes: tuple[JointChange, ...]) -> list[Note]:
    """Of joints that are badly determined, or far from the URDF's."""
    found = []
    weak = [c.joint for c in changes if c.shift_sigma_m.max() > WEAK_M or c.turn_sigma_rad.max() > WEAK_RAD]
    if weak:
        words = f"the poses hardly determine the origin of {listing(weak)}: give a prior, or free fewer joints"
        found.append(Note("weak_joints", words))
    far = [c.joint for c in changes if np.linalg.norm(c.shift_m) > FAR_M or np.linalg.norm(c.turn_rad) > FAR_RAD]
    if far:
        words = f"the origin of {listing(far)} is far from the URDF's: is it the URDF of this machine?"
        found.append(Note("far_from_nominal", words))
    return found


def _by_prior(model: ChainModel, estimate: ChainEstimate) -> list[str]:
    """The joints' numbers in the directions of which the prior says more than the poses, each as ``joint (x, rz)``.

    With every number in units of its prior's sigma the covariance has eigenvalues up to 1: the prior's share.
    """
    known = np.flatnonzero(estimate.active & (estimate.precision > 0))
    scale = np.sqrt(estimate.precision[known])
    shares, directions = np.linalg.eigh(estimate.white[np.ix_(known, known)] * np.outer(scale, scale))
    told = np.zeros(len(estimate.active), dtype=bool)
    told[known] = (np.abs(directions[:, shares > MOSTLY]) > COMPONENT).any(axis=1)
    layout, found = estimate.layout, []
    for j, name in enumerate(model.names):
        own = [*layout.placement(j), layout.offset(j)]
        parts = [part for part, i in zip((*DIRECTIONS, "zero"), own, strict=True) if told[i]]
        found += [f"{name} ({', '.join(parts)})"] if parts else []
    return found
