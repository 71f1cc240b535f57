"""How poses and labels are commonly misread, and how they would read otherwise."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from solvers.estimate import Note
from solvers.problem import ANGULAR, Problem
from solvers.se3 import Array, quat_wxyz_from_rotation, rotation_from_quat_wxyz
from solvers.torus import Torus

NAMES = ("angular", "orbital")
STEADY_RAD = float(np.radians(4.0))
"""A joint whose angle has a median deviation above this was not held."""
AGREE_RAD = float(np.radians(2.0))
"""Labels of held joints agree with the poses within this."""


def misreadings(problem: Problem) -> Iterator[tuple[Note, Problem]]:
    """Every way of reading the same poses otherwise, each with the note that names it."""
    R = problem.rotations
    quat = quat_wxyz_from_rotation(R)
    for order, read, roll in (("qx,qy,qz,qw", "qw,qx,qy,qz", 1), ("qw,qx,qy,qz", "qx,qy,qz,qw", -1)):
        message = f"the quaternions seem to stand in the order {order} and to have been read as {read}"
        corrected = rotation_from_quat_wxyz(np.roll(quat, roll, axis=-1))
        yield Note("quaternion_order", message), replace(problem, R_world_sensor=corrected)
    note = Note(
        "transposed_rotation",
        "the rotations seem to be transposed (of the world in the sensor) while the positions are not; "
        "transpose the matrices, or conjugate the quaternions",
    )
    yield note, replace(problem, R_world_sensor=np.swapaxes(R, 1, 2))
    for axis, name in enumerate("xyz"):
        note = Note(
            "left_handed_frame",
            f"the positions seem to stand in a left-handed frame and the orientations in a right-handed one, or the "
            f"other way: with {name} negated they agree",
        )
        yield note, replace(problem, p_world_sensor=problem.p_world_sensor * np.where(np.arange(3) == axis, -1.0, 1.0))


def conflicting_sweeps(problem: Problem, torus: Torus) -> Iterator[tuple[Note, np.ndarray]]:
    """Sweeps whose labels contradict the angles that ``torus`` gives without labels: a note and the poses (M,).

    The first suggestion takes all that contradict the majority together; where two labels stand against each
    other, each of the two is a suggestion of its own. Nothing is suggested where most sweeps are wrong.
    """
    angles = torus.angles(problem)
    sweeps = [(joint, poses) for joint in (0, 1) for poses in problem.sweeps(joint)]
    middle = np.array([_middle(angles[poses, joint]) for joint, poses in sweeps]).reshape(-1, 2)
    moved = middle[:, 1] > STEADY_RAD
    minority, tied = np.zeros(len(sweeps), dtype=bool), []
    for group in _labelled_groups(problem, sweeps, ~moved):
        label = np.array([problem.label[sweeps[k][1][0], sweeps[k][0]] for k in group])
        agrees = _consensus(middle[group, 0], label)
        if len(group) == 2 and not agrees.all():
            tied += [group[[0]], group[[1]]]
        else:
            minority[group[~agrees]] = True
    wrong = np.flatnonzero(moved | minority)
    if len(wrong) > 0.5 * len(sweeps):
        return
    for group in [wrong] if wrong.size else tied:
        words = "; ".join(_wrong(problem, sweeps[k][0], sweeps[k][1], bool(moved[k])) for k in group[:5])
        yield Note("wrong_label", words), np.concatenate([sweeps[k][1] for k in group])


def _wrong(problem: Problem, joint: int, poses: np.ndarray, moved: bool) -> str:
    name, where = NAMES[joint], _where(problem, joint, poses)
    if moved:
        return f"{where} holds the {name} joint by its label, but there that joint moves; is its 'moving' right?"
    label = np.degrees(problem.label[poses[0], joint])
    return f"{where} has the {name} joint at {label:.4g} deg by its label, which the other sweeps contradict"


def _where(problem: Problem, joint: int, poses: np.ndarray) -> str:
    """A sweep by its number in order of appearance, from 1, and its poses, from 0."""
    return f"sweep {problem.held[poses[0], joint] + 1} (poses {poses.min()} to {poses.max()})"


def _middle(angle: Array) -> tuple[float, float]:
    """Median of the angles (M,) on the circle, and the median deviation from it, rad."""
    mean = np.angle(np.exp(1j * angle).mean())
    middle = mean + np.median(_wrapped(angle - mean))
    return float(middle), float(np.median(np.abs(_wrapped(angle - middle))))


def _wrapped(angle: Array) -> Array:
    return np.angle(np.exp(1j * angle))


def _labelled_groups(
    problem: Problem, sweeps: list[tuple[int, np.ndarray]], steady: np.ndarray
) -> Iterator[np.ndarray]:
    """Numbers of the sweeps whose labels have one zero in common: of alpha in a placement, of beta in all."""
    first = np.array([poses[0] for _, poses in sweeps], dtype=int)
    joint = np.array([joint for joint, _ in sweeps], dtype=int)
    known = steady & np.isfinite(problem.label[first, joint])
    zero = np.where(joint == ANGULAR, problem.placement[first], -1)
    for z in np.unique(zero[known]):
        yield np.flatnonzero(known & (zero == z))


def _consensus(angle: Array, label: Array) -> np.ndarray:
    """(K,) which labels agree with the angles up to one zero and one sense, in the largest number."""
    best = np.zeros(len(angle), dtype=bool)
    for sense in (1, -1):
        zero = angle - sense * label
        agrees = np.abs(_wrapped(zero[:, None] - zero)) <= AGREE_RAD
        row = agrees[np.argmax(agrees.sum(axis=1))]
        best = row if row.sum() > best.sum() else best
    return best


def reversed_sweeps(problem: Problem, torus: Torus) -> Iterator[tuple[Note, int, list[np.ndarray]]]:
    """Sweeps whose readings turn against the other sweeps' readings: a note, the moving joint, their poses.

    Where as many turn one way as the other, either half is a suggestion.
    """
    angles = torus.angles(problem)
    for held in (0, 1):
        moving = 1 - held
        sweeps = [poses for poses in problem.sweeps(held) if np.isfinite(problem.label[poses, moving]).all()]
        if not sweeps:
            continue
        sense = np.array([_sense(angles[poses, moving], problem.label[poses, moving]) for poses in sweeps])
        for side in sorted((1, -1), key=lambda s: (sense == s).sum()):
            poses = [p for p, s in zip(sweeps, sense, strict=True) if s == side]
            if not poses or len(poses) > len(sweeps) / 2:
                continue
            where = ", ".join(_where(problem, held, p) for p in poses[:5])
            message = f"the readings of the {NAMES[moving]} joint run against the motion (time reversed?) in {where}"
            yield Note("reversed_sweep", message), moving, poses


def _sense(angle: Array, reading: Array) -> int:
    """+1 or -1: whether the readings turn with or against the angles."""
    with_, against = (abs(np.exp(1j * (reading - s * angle)).sum()) for s in (1, -1))
    return 1 if with_ >= against else -1
