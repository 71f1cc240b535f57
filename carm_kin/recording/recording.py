"""A recording: the poses of the tracked sensor, and what is known of the joints while they were taken."""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.checks import (
    LABEL_TOLERANCE_M,
    LABEL_TOLERANCE_RAD,
    OPTIONAL_COLUMNS,
    ROTATION_TOLERANCE,
    WANDER_M,
    WANDER_RAD,
    WANDER_STEPS,
    PoseError,
    first_known,
    label_unit,
    mean_known,
    numbered,
    numeric,
    repeated,
    rotations,
    text,
    transforms,
)
from carm_kin.recording.figure import recording_figure
from carm_kin.recording.intake import Intake
from carm_kin.recording.written import written_step
from solvers.estimate import Note
from solvers.se3 import Array, transform

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

__all__ = [
    "LABEL_TOLERANCE_M",
    "LABEL_TOLERANCE_RAD",
    "OPTIONAL_COLUMNS",
    "ROTATION_TOLERANCE",
    "PoseError",
    "Recording",
    "Source",
    "Sweep",
]

_PER_POSE = ("p_world_sensor", "R_world_sensor", *OPTIONAL_COLUMNS, "pose_number", "variance")
_ONE_A_SWEEP = {
    "moving": "one joint moves in a sweep; leave 'moving' empty in the whole sweep where several do",
    "placement": "a sweep has one base placement; give the sweeps of another placement labels of their own",
}


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
    variance: Array | None = None
    """(N, 2) of a pose that is a mean of frames: the variance of the mean an axis, m² and rad², as the frames show it;
    None where poses are single frames."""
    intakes: tuple[Intake, ...] = ()
    """What became of the frames of its file or files."""
    notes: tuple[Note, ...] = ()
    """What its reader found odd."""

    def __post_init__(self) -> None:
        n = len(self.p_world_sensor)
        checked = {
            "p_world_sensor": numeric("p_world_sensor", self.p_world_sensor, (n, 3)),
            "joints": {j: numeric(f"q_{j}", v, (n,), unknown=True) for j, v in self.joints.items()},
            "metadata": {name: text(name, values, n) for name, values in self.metadata.items()},
            "pose_number": np.asarray(self.pose_number if len(self.pose_number) else np.arange(n), dtype=int),
        }
        if self.R_world_sensor is not None:
            checked["R_world_sensor"] = rotations(self.R_world_sensor, n)
        if self.time_s is not None:
            checked["time_s"] = numeric("time_s", self.time_s, (n,))
        if self.variance is not None:
            checked["variance"] = numeric("variance", self.variance, (n, 2))
        for name in ("sweep", "moving", "placement"):
            if getattr(self, name) is not None:
                checked[name] = text(name, getattr(self, name), n)
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        self._check_numbers()
        self._check_sweeps()

    @staticmethod
    def from_poses(
        T_world_sensor: "ArrayLike",
        *,
        time_s: "ArrayLike | None" = None,
        sweep: Sequence[object] | np.ndarray | None = None,
        moving: Sequence[str] | np.ndarray | None = None,
        placement: Sequence[object] | np.ndarray | None = None,
        joints: Mapping[str, "ArrayLike"] | None = None,
        prismatic: Iterable[str] = (),
    ) -> "Recording":
        """A recording of poses (N, 4, 4), m, of the sensor in the tracker's frame; the rest is as in the class.

        Raises InputError for poses that are no rigid motions, and as the class does.
        """
        T = transforms("T_world_sensor", T_world_sensor)
        known = {"time_s": time_s, "sweep": sweep, "moving": moving, "placement": placement, "joints": joints or {}}
        return Recording(T[:, :3, 3], T[:, :3, :3], prismatic=frozenset(prismatic), **known)  # pyright: ignore

    def __len__(self) -> int:
        return len(self.p_world_sensor)

    def __repr__(self) -> str:
        """One line."""
        what = "poses" if self.R_world_sensor is not None else "positions"
        parts = [f"Recording of {len(self)} {what}"]
        parts += [f"{len(self.sweeps)} sweeps"] if self.sweeps else []
        parts += [f"{len(self.placements)} placements"] if len(self.placements) > 1 else []
        parts += [f"joints {', '.join(self.joints)}"] if self.joints else []
        parts += [f"from {self.source.path}"] if self.source else []
        return "; ".join(parts)

    def figure(self) -> "Figure":
        """The positions in space by sweep, and the turn since the first pose over time.

        Raises MissingDependencyError without matplotlib.
        """
        return recording_figure(self)

    def select(self, index: np.ndarray | slice) -> "Recording":
        """The recording of some of the poses, by index, mask or slice.

        They keep their `pose_number`; the missing frames are left behind.
        """
        chosen = {name: getattr(self, name)[index] for name in _PER_POSE if getattr(self, name) is not None}
        for name in ("joints", "metadata"):
            chosen[name] = {key: values[index] for key, values in getattr(self, name).items()}
        return replace(self, missing=0, **chosen)

    @property
    def T_world_sensor(self) -> Array:
        """(N, 4, 4) the poses, m. Raises InputError where only positions were recorded."""
        if self.R_world_sensor is None:
            file = self.source.path if self.source else None
            raise InputError("the recording has no orientations (qw, qx, qy, qz)", file=file)
        return transform(self.R_world_sensor, self.p_world_sensor)

    @property
    def placements(self) -> tuple[str, ...]:
        """The labels of the base placements, in order of first appearance."""
        return ("",) if self.placement is None else tuple(numbered(self.placement)[0])

    @cached_property
    def placement_number(self) -> np.ndarray:
        """(N,) the index in `placements` of each pose's placement."""
        return np.zeros(len(self), dtype=int) if self.placement is None else numbered(self.placement)[1]

    @cached_property
    def sweep_number(self) -> np.ndarray:
        """(N,) the index in `sweeps` of each pose's sweep, -1 where it has none."""
        number = np.full(len(self), -1)
        if self.sweep is not None:
            member = np.flatnonzero(self.sweep != "")
            number[member] = numbered(self.sweep[member])[1]
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
        """Joint name -> (S,) the mean of the known values in every sweep, rad or m, NaN where there is none."""
        return {j: mean_known(values, self.sweep_number, len(self._first))[0] for j, values in self.joints.items()}

    @cached_property
    def sweep_label_sigma(self) -> Mapping[str, Array]:
        """Joint name -> (S,) standard deviation of `sweep_labels` of a held joint, rad or m: that of rounding to the
        last digit written, step / sqrt(12), and what the values wander by within the sweep."""
        found = {}
        for joint, values in self.joints.items():
            wander = mean_known(values, self.sweep_number, len(self._first))[1]
            found[joint] = np.hypot(self.label_step(joint) / np.sqrt(12), wander)
        return found

    def label_step(self, joint: str) -> float:
        """The step of the last digit of a joint's values, rad or m, as `written_step` tells it; NaN without values."""
        return written_step(self.joints[joint], joint in self.prismatic)

    @property
    def warnings(self) -> tuple[Note, ...]:
        """What is allowed but looks like a mistake."""
        return (*self.notes, *_warnings_of(self))

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
        for joint, values in self.joints.items():
            expected = first_known(values, self.sweep_number, len(self._first))[self.sweep_number]
            _, scale, unit = label_unit(joint in self.prismatic)
            wander = WANDER_M if joint in self.prismatic else WANDER_RAD
            tolerance = np.fmax(wander, WANDER_STEPS * self.label_step(joint))
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


def _warnings_of(recording: Recording) -> Iterable[Note]:
    """What is allowed but looks like a mistake."""
    n, missing = len(recording), recording.missing
    if missing:
        why = "; ".join(filter(None, (intake.in_words() for intake in recording.intakes)))
        message = f"{missing} of {n + missing} frames were left out"
        yield Note("missing_frames", f"{message}: {why}" if why else message)
    if same := np.count_nonzero(repeated(recording.p_world_sensor, recording.R_world_sensor)):
        yield Note("duplicated_poses", f"{same} of {n} poses are identical to the pose before them")
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
    yield from _other_joints_moved(recording)


def _other_joints_moved(recording: Recording) -> Iterable[Note]:
    """A note for each joint that is neither of the two axes and yet changes within a placement.

    The axes are among the joints named in `moving`; where fewer than two are, any angle may be the other one.
    """
    moving = set() if recording.moving is None else {*recording.moving} - {""}
    one_axis = len(moving - recording.prismatic) < 2
    placement = recording.placement_number
    for joint, values in recording.joints.items():
        if joint in moving or (one_axis and joint not in recording.prismatic):
            continue
        tolerance, scale, unit = label_unit(joint in recording.prismatic)
        before = first_known(values, placement, len(recording.placements))[placement]
        if np.any(moved := np.abs(values - before) > tolerance):
            pose = np.argmax(moved)
            yield Note(
                "other_joint_moved",
                f"joint '{joint}' has {values[pose] * scale:.9g} {unit} at pose {recording.pose_number[pose]} and "
                f"{before[pose] * scale:.9g} {unit} before in the same placement; "
                "each of its positions needs a 'placement' of its own",
            )
