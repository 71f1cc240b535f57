"""The state of a capture, which one thread fills and another one shows."""

import threading
import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import acos
from statistics import median
from typing import Generic, TypeVar

import numpy as np

from carm_kin.streams.frames import Frame
from carm_kin.streams.marks import Marks
from carm_kin.streams.tracking import Observation
from solvers.se3 import Array

RATE_S = 3.0
"""The rate is that of the frames of so many seconds."""
STALL_S = 1.0
"""Without a pose for so long, the capture has stalled."""
MAX_TOOLS = 40
"""Names of tools that are remembered."""
MAX_FAULTS, OTHER = 20, "other reasons"
"""Reasons of frames without a pose that are counted by name."""
EVENTS = 4
"""Last events that are shown."""
USUAL_STEPS = 64
"""The usual step of a sequence is the median of so many."""
KNOWN_STEPS = 8
"""Steps that must be known before one is called too long."""
LATE_STEPS = 0.75
"""By how much of a usual step one may be late."""
MOST_THINNED = 600
"""Items that `Thinned` keeps at most; there are at least half as many once there were so many."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose that is on the disk, and its marks."""

    T: Array
    """(4, 4), m."""
    marks: Marks


@dataclass(frozen=True)
class Snapshot:
    """What there is to show at one moment."""

    seconds: float
    """Since the capture began."""
    frames: int
    poses: int
    repeated: int
    """Poses identical to the one before them."""
    missing: int
    """Frames that the server's numbers or stamps say were not sent."""
    faults: Counter[str]
    """Frames without a pose, by reason."""
    rate_hz: float
    visible: float
    """Share of the last frames with a pose."""
    since_pose_s: float
    marks: Marks
    sweep_poses: int
    turned_rad: float
    """Largest angle between the first orientation and a later one."""
    tools: tuple[str, ...]
    events: tuple[str, ...]
    last: Array | None
    """(4, 4), m: the last pose that did not repeat the one before."""

    @property
    def stalled(self) -> bool:
        """Whether no pose has arrived for too long."""
        return self.since_pose_s > STALL_S


class Live:
    """The state; every method may be called from any thread."""

    def __init__(self, marks: Marks) -> None:
        self.marks = marks
        """Of the poses that arrive next."""
        self.fresh_events: deque[str] = deque(maxlen=100)
        """Events that nobody has taken."""
        self._lock = threading.Lock()
        self._start = self._last_pose = time.monotonic()
        self._frames = self._good = self._repeated = self._sweep_poses = 0
        self._faults: Counter[str] = Counter()
        self._gaps = Gaps()
        self._recent: deque[tuple[float, bool]] = deque()
        self._kept: Thinned[Pose] = Thinned()
        self._sweep = (0, False)
        self._turned = 0.0
        self._first: Array | None = None
        self._before: Array | None = None
        self._tools: dict[str, None] = {}
        self._events: deque[str] = deque(maxlen=EVENTS)

    @property
    def poses(self) -> int:
        """How many poses have been stored."""
        return self._good

    @property
    def tools(self) -> tuple[str, ...]:
        """The tools that the server has sent."""
        return tuple(self._tools)

    def tell(self, event: str) -> None:
        """Something happened that a person should know."""
        with self._lock:
            self._events.append(f"{time.monotonic() - self._start:.0f} s: {event}")
            self.fresh_events.append(event)

    def saw(self, observation: Observation, captured: bool) -> None:
        """A tool was in a message; of the captured one, what is missing before it is counted."""
        with self._lock:
            if len(self._tools) < MAX_TOOLS:
                self._tools[observation.tool] = None
            if captured and (observation.number or observation.stamp_s is not None):
                self._gaps.add(float(observation.number or observation.stamp_s or 0.0))

    def reconnected(self) -> None:
        """What the server did not send while there was no connection is not counted as missing."""
        with self._lock:
            self._gaps.restart()

    def add(self, frames: Sequence[Frame], marks: Marks) -> None:
        """Frames that are on the disk."""
        now = time.monotonic()
        with self._lock:
            if self._sweep != (marks.sweep, marks.within):
                self._sweep, self._sweep_poses = (marks.sweep, marks.within), 0
            for frame in frames:
                self._frames += 1
                self._recent.append((now, frame.T is not None))
                if frame.T is None:
                    known = frame.fault in self._faults or len(self._faults) < MAX_FAULTS
                    self._faults[frame.fault if known else OTHER] += 1
                else:
                    self._last_pose = now
                    self._add_pose(frame.T, marks)
            self._forget(now)

    def some(self) -> tuple[list[Pose], int]:
        """Poses spread evenly over all that do not repeat the one before, and the number of these."""
        with self._lock:
            return list(self._kept.items), self._kept.count

    def snapshot(self) -> Snapshot:
        """What there is to show."""
        now = time.monotonic()
        with self._lock:
            self._forget(now)
            recent = list(self._recent)
            return Snapshot(
                seconds=now - self._start,
                frames=self._frames,
                poses=self._good,
                repeated=self._repeated,
                missing=self._gaps.missing,
                faults=self._faults.copy(),
                rate_hz=len(recent) / max(min(now - self._start, RATE_S), 1e-3),
                visible=sum(good for _, good in recent) / max(len(recent), 1),
                since_pose_s=now - self._last_pose,
                marks=self.marks,
                sweep_poses=self._sweep_poses,
                turned_rad=self._turned,
                tools=self.tools,
                events=tuple(self._events),
                last=self._before,
            )

    def _add_pose(self, T: Array, marks: Marks) -> None:
        self._good += 1
        self._sweep_poses += 1
        if self._before is not None and np.array_equal(T, self._before):
            self._repeated += 1
            return
        self._first = T if self._first is None else self._first
        self._before = T
        cosine = (float((self._first[:3, :3] * T[:3, :3]).sum()) - 1) / 2
        self._turned = max(self._turned, acos(min(max(cosine, -1.0), 1.0)))
        self._kept.add(Pose(T, marks))

    def _forget(self, now: float) -> None:
        while self._recent and self._recent[0][0] < now - RATE_S:
            self._recent.popleft()


class Gaps:
    """Counts the missing members of one sequence."""

    def __init__(self) -> None:
        self.missing = 0
        self._steps: deque[float] = deque(maxlen=USUAL_STEPS)
        self._last: float | None = None

    def add(self, value: float) -> None:
        """The next member; one that is not greater than the one before tells nothing."""
        last, self._last = self._last, value
        if last is None or value <= last:
            return
        step = value - last
        if len(self._steps) >= KNOWN_STEPS:
            steps = step / median(self._steps)
            self.missing += round(steps) - 1 if steps > 1 + LATE_STEPS else 0
        self._steps.append(step)

    def restart(self) -> None:
        """What lies between the last member and the next one is not counted."""
        self._last = None


T = TypeVar("T")


class Thinned(Generic[T]):
    """Every k-th item, k doubling whenever there are too many."""

    def __init__(self) -> None:
        self.items: list[T] = []
        self.count = 0
        """Items that were added."""
        self._step = 1

    def add(self, item: T) -> None:
        """Keep it, if it is its turn."""
        if self.count % self._step == 0:
            self.items.append(item)
        self.count += 1
        if len(self.items) > MOST_THINNED:
            self.items = self.items[::2]
            self._step *= 2
