"""A recording: the poses of the tracked sensor, and what is known of the joints while they were taken."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from carm_kin.errors import InputError
from solvers.estimate import Note
from solvers.problem import ANGULAR, ORBITAL, Problem
from solvers.se3 import Array

ROTATION_TOLERANCE = 1e-3
"""Largest entry of ``R Rᵀ - I`` that is taken for rounding."""
LABEL_TOLERANCE_RAD = float(np.radians(1e-6))
"""How far the labels of a held joint may differ within a sweep."""
LABEL_TOLERANCE_M = 1e-9
"""The same for a prismatic joint."""
OPTIONAL_COLUMNS = ("time_s", "sweep", "moving", "placement")
"""What a recording may say of each pose, next to the joints' values."""

_PER_POSE = ("p_world_sensor", "R_world_sensor", *OPTIONAL_COLUMNS, "pose_number")
_ONE_A_SWEEP = {
    "moving": "one joint moves in a sweep; leave 'moving' empty in the whole sweep where several do",
    "placement": "a sweep has one base placement; give the sweeps of another placement labels of their own",
}


class PoseError(InputError):
    """Bad data at one pose. A reader that knows where the pose stands in its file says so instead."""

    def __init__(self, problem: str, pose: int, column: str):
        super().__init__(problem, file=f"pose {pose}", column=column)
        self.problem = problem
        self.pose = pose
        self.column = column

    def __reduce__(self) -> tuple:
        return type(self), (self.problem, self.pose, self.column)


@dataclass(frozen=True)
class Source:
    """The file that a recording was read from."""

    path: str
    """The path as it was given."""
    sha256: str
    """Hexadecimal digest of the file's bytes."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """Poses taken while one joint moved and every other one was held."""

    label: str
    moving: str
    """The joint that moves; "" = unknown or several."""
    placement: str
    """Label of the base placement."""
    poses: np.ndarray
    """(M,) indices into the recording."""
    held: Mapping[str, float]
    """The known labels of the joints that are held, rad or m; empty where `moving` is unknown."""


@dataclass(frozen=True, eq=False)
class Recording:
    """N poses of the sensor in the tracker's frame, in metres and radians. Nothing is ever modified.

    Text is kept without the white space around it. Raises InputError where an array has the wrong
    shape, holds what is not finite or no rotation, or where the labels of a sweep contradict each other.
    """

    p_world_sensor: Array
    """(N, 3) sensor positions, m."""
    R_world_sensor: Array | None = None
    """(N, 3, 3) sensor orientations, or None where only positions were recorded."""
    time_s: Array | None = None
    """(N,) times, s."""
    sweep: np.ndarray | None = None
    """(N,) str, the label of each pose's sweep; "" = none."""
    moving: np.ndarray | None = None
    """(N,) str, the joint that moves; "" = unknown or several."""
    placement: np.ndarray | None = None
    """(N,) str, the label of the base placement; None = one placement, labelled ""."""
    joints: Mapping[str, Array] = field(default_factory=dict)
    """Joint name -> (N,) values, rad, or m for the `prismatic` ones; NaN = unknown."""
    prismatic: frozenset[str] = frozenset()
    """The names in `joints` whose values are lengths."""
    metadata: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Column name -> (N,) str: what the file says beyond this."""
    missing: int = 0
    """How many frames without a pose were left out."""
    pose_number: np.ndarray = field(default_factory=lambda: np.arange(0))
    """(N,) number of each pose in the file, from 0, missing frames counted; default 0..N-1."""
    source: Source | None = None

    def __post_init__(self) -> None:
        n = len(self.p_world_sensor)
        checked = {
            "p_world_sensor": _numeric("p_world_sensor", self.p_world_sensor, (n, 3)),
            "joints": {j: _numeric(f"q_{j}", v, (n,), unknown=True) for j, v in self.joints.items()},
            "metadata": {name: _text(name, values, n) for name, values in self.metadata.items()},
            "pose_number": np.asarray(self.pose_number if len(self.pose_number) else np.arange(n), dtype=int),
        }
        if self.R_world_sensor is not None:
            checked["R_world_sensor"] = _rotations(self.R_world_sensor, n)
        if self.time_s is not None:
            checked["time_s"] = _numeric("time_s", self.time_s, (n,))
        for name in ("sweep", "moving", "placement"):
            if getattr(self, name) is not None:
                checked[name] = _text(name, getattr(self, name), n)
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        self._check_numbers()
        self._check_sweeps()

    def __len__(self) -> int:
        return len(self.p_world_sensor)

    def select(self, index: np.ndarray | slice) -> "Recording":
        """The recording of some of the poses, by index, mask or slice.

        They keep their `pose_number`; the missing frames are left behind.
        """
        chosen = {name: getattr(self, name)[index] for name in _PER_POSE if getattr(self, name) is not None}
        for name in ("joints", "metadata"):
            chosen[name] = {key: values[index] for key, values in getattr(self, name).items()}
        return replace(self, missing=0, **chosen)

    @property
    def placements(self) -> tuple[str, ...]:
        """The labels of the base placements, in order of first appearance."""
        return ("",) if self.placement is None else tuple(_numbered(self.placement)[0])

    @cached_property
    def sweep_number(self) -> np.ndarray:
        """(N,) the index in `sweeps` of each pose's sweep, -1 where it has none."""
        number = np.full(len(self), -1)
        if self.sweep is not None:
            member = np.flatnonzero(self.sweep != "")
            number[member] = _numbered(self.sweep[member])[1]
        return number

    @cached_property
    def sweeps(self) -> list[Sweep]:
        """The sweeps, in order of first appearance; their poses need not be contiguous."""
        if self.sweep is None or not self._first.size:
            return []
        order = np.argsort(self.sweep_number, kind="stable")[np.count_nonzero(self.sweep_number < 0) :]
        poses = np.split(order, np.flatnonzero(np.diff(self.sweep_number[order])) + 1)
        sweeps = []
        for number, first in enumerate(self._first):
            moving = "" if self.moving is None else str(self.moving[first])
            placement = "" if self.placement is None else str(self.placement[first])
            labels = {j: float(v[number]) for j, v in self.sweep_labels.items() if np.isfinite(v[number])}
            held = {joint: label for joint, label in labels.items() if moving not in ("", joint)}
            sweeps.append(Sweep(str(self.sweep[first]), moving, placement, poses[number], held))
        return sweeps

    @cached_property
    def sweep_labels(self) -> Mapping[str, Array]:
        """Joint name -> (S,) the first known value in every sweep, NaN where there is none."""
        labels = {}
        for joint, values in self.joints.items():
            labels[joint] = np.full(len(self._first), np.nan)
            known = np.flatnonzero(np.isfinite(values) & (self.sweep_number >= 0))
            number, first = np.unique(self.sweep_number[known], return_index=True)
            labels[joint][number] = values[known[first]]
        return labels

    @property
    def warnings(self) -> tuple[Note, ...]:
        """What is allowed but looks like a mistake."""
        return tuple(_warnings(self))

    @cached_property
    def _first(self) -> np.ndarray:
        """(S,) the first pose of every sweep."""
        member = np.flatnonzero(self.sweep_number >= 0)
        return member[np.unique(self.sweep_number[member], return_index=True)[1]]

    def _check_numbers(self) -> None:
        if not self.prismatic <= self.joints.keys():
            raise InputError(f"prismatic names joints without values: {sorted(self.prismatic - self.joints.keys())}")
        if self.pose_number.shape != (len(self),):
            raise InputError(f"pose_number has the shape {self.pose_number.shape}; {(len(self),)} is needed")
        ordered = np.all(np.diff(self.pose_number, prepend=-1) > 0)
        frames = len(self) + self.missing
        if self.missing and not (ordered and np.all(self.pose_number < frames)):
            raise InputError(f"pose_number must increase and stay below the number of frames, {frames}")

    def _check_sweeps(self) -> None:
        """Raise PoseError at the first pose that contradicts its sweep."""
        if not self._first.size:
            return
        for column, hint in _ONE_A_SWEEP.items():
            if (values := getattr(self, column)) is not None:
                expected = values[self._first][self.sweep_number]
                self._check_constant(column, values, expected, values != expected, hint)
        if self.moving is None:
            return
        for joint, labels in self.sweep_labels.items():
            values, expected = self.joints[joint], labels[self.sweep_number]
            tolerance, scale, unit = LABEL_TOLERANCE_RAD, 180 / np.pi, "deg"
            if joint in self.prismatic:
                tolerance, scale, unit = LABEL_TOLERANCE_M, 1e3, "mm"
            wrong = (self.moving != "") & (self.moving != joint) & (np.abs(values - expected) > tolerance)
            hint = f"within a sweep only the joint named in 'moving' changes its value ({unit})"
            self._check_constant(f"q_{joint}", values * scale, expected * scale, wrong, hint)

    def _check_constant(
        self, column: str, values: np.ndarray, expected: np.ndarray, wrong: np.ndarray, hint: str
    ) -> None:
        poses = np.flatnonzero(wrong & (self.sweep_number >= 0))
        if self.sweep is not None and poses.size:
            pose = int(poses[0])
            here, before = (v if isinstance(v, str) else f"{v:.9g}" for v in (values[pose], expected[pose]))
            raise PoseError(f"sweep '{self.sweep[pose]}' has '{here}' here and '{before}' before; {hint}", pose, column)


def to_problem(recording: Recording, angular: str = "angular", orbital: str = "orbital") -> Problem:
    """The problem that the two-axis solvers take; `angular` and `orbital` name the joints of the two axes.

    A joint is held through a sweep in which the other one moves, at the sweep's label where that is known.
    Both are free where the sweep or its moving joint is unknown. Raises InputError where a third joint moves.
    """
    file = recording.source.path if recording.source else None
    held, label = np.full((len(recording), 2), -1), np.full((len(recording), 2), np.nan)
    for column, (joint, other) in {ANGULAR: (angular, orbital), ORBITAL: (orbital, angular)}.items():
        if joint in recording.prismatic:
            raise InputError(f"joint '{joint}' turns: its values are angles, not lengths", file=file)
        if recording.moving is not None:
            held[:, column] = np.where(recording.moving == other, recording.sweep_number, -1)
        if joint in recording.joints:
            label[:, column] = recording.joints[joint]
            poses = np.flatnonzero(held[:, column] >= 0)
            label[poses, column] = recording.sweep_labels[joint][held[poses, column]]
    for moving in () if recording.moving is None else _numbered(recording.moving)[0]:
        if moving not in ("", angular, orbital):
            close = difflib.get_close_matches(moving, (angular, orbital), 1)
            meant = f"did you mean '{close[0]}'? Otherwise " if close else ""
            raise InputError(
                f"pose {np.argmax(recording.moving == moving)} moves '{moving}', which is neither '{angular}' nor "
                f"'{orbital}': {meant}these poses need the chain's calibration, with --urdf",
                file=file,
                column="moving",
            )
    one = np.zeros(len(recording), dtype=int)
    placement = one if recording.placement is None else _numbered(recording.placement)[1]
    return Problem(recording.p_world_sensor, recording.R_world_sensor, placement, held, label)


def _warnings(recording: Recording) -> Iterable[Note]:
    n = len(recording)
    if recording.missing:
        text = f"{recording.missing} of {n + recording.missing} frames have no pose and were left out"
        yield Note("missing_frames", text)
    same = np.all(np.diff(recording.p_world_sensor, axis=0) == 0, axis=1)
    if recording.R_world_sensor is not None:
        same &= np.all(np.diff(recording.R_world_sensor, axis=0) == 0, axis=(1, 2))
    if same.any():
        yield Note("duplicated_poses", f"{np.count_nonzero(same)} of {n} poses are identical to the pose before them")
    if recording.time_s is not None and np.any(back := np.diff(recording.time_s) <= 0):
        pose = recording.pose_number[np.argmax(back) + 1]
        yield Note(
            "time_not_increasing", f"time_s does not increase {np.count_nonzero(back)} times, first at pose {pose}"
        )
    if single := [f"'{sweep.label}'" for sweep in recording.sweeps if len(sweep.poses) == 1]:
        more = f" and {len(single) - 5} more" if len(single) > 5 else ""
        yield Note("sweep_of_one_pose", f"{len(single)} sweeps have one pose only: {', '.join(single[:5])}{more}")
    if recording.moving is not None:
        loose = np.count_nonzero((recording.moving != "") & (recording.sweep_number < 0))
        if loose:
            yield Note(
                "moving_without_sweep", f"{loose} poses name a moving joint but no sweep: every joint is taken as free"
            )
    for name in recording.metadata:
        if close := difflib.get_close_matches(name.lower(), OPTIONAL_COLUMNS, 1, 0.8):
            yield Note("misspelt_column", f"column '{name}' is kept as metadata; did you mean '{close[0]}'?")


def _numbered(labels: np.ndarray) -> tuple[list[str], np.ndarray]:
    """The distinct labels in order of first appearance, and the (N,) number of each pose's label."""
    distinct = list(dict.fromkeys(labels))
    numbers = dict(zip(distinct, range(len(distinct)), strict=True))
    return distinct, np.fromiter(map(numbers.__getitem__, labels), int, len(labels))


def _numeric(name: str, values: object, shape: tuple[int, ...], unknown: bool = False) -> Array:
    """Float array of the given shape; finite, or NaN where `unknown` allows it."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is not an array of numbers: {error}") from None
    if array.shape != shape:
        raise InputError(f"{name} has the shape {array.shape}; {shape} is needed")
    bad = np.isinf(array) if unknown else ~np.isfinite(array)
    if bad.any():
        pose = int(np.argwhere(bad)[0, 0])
        raise PoseError("the value is empty or not finite", pose, name)
    return array


def _rotations(values: object, n: int) -> Array:
    R = _numeric("R_world_sensor", values, (n, 3, 3))
    error = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))
    if np.any(bad := error > ROTATION_TOLERANCE):
        pose = int(np.argmax(bad))
        problem = (
            f"not a rotation: R Rᵀ differs from the identity by {error[pose]:.2g} (at most {ROTATION_TOLERANCE:g})"
        )
        raise PoseError(problem, pose, "R_world_sensor")
    if np.any(bad := np.einsum("ni,ni->n", np.cross(R[:, 0], R[:, 1]), R[:, 2]) < 0):
        problem = "a reflection, not a rotation: the frames must be right-handed"
        raise PoseError(problem, int(np.argmax(bad)), "R_world_sensor")
    return R


def _text(name: str, values: Iterable[object], n: int) -> np.ndarray:
    """(N,) object array of str; fixed-width arrays would take N times the longest text."""
    text = [str(value).strip() for value in values]
    if len(text) != n:
        raise InputError(f"{name} has {len(text)} entries for {n} poses")
    array = np.empty(n, dtype=object)
    array[:] = text
    return array
