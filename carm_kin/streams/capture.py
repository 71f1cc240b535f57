"""A capture: reception in one thread, the calibration so far in another, keys and the view in this one."""

import contextlib
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from math import inf
from threading import Event

from carm_kin.streams.estimate import Current, current
from carm_kin.streams.keys import Keys
from carm_kin.streams.live import Live, Snapshot
from carm_kin.streams.operator import Operator
from carm_kin.streams.reception import Reception

UPDATE_S = 1.0
"""The calibration is updated so often, and"""
DUTY = 0.25
"""takes at most this share of the time."""
KEYS_S = 0.1
"""How long keys are waited for before the view is drawn again."""
SWITCH_S = 2e-4
"""How long reception may have to wait for the interpreter while the calibration runs; Python's default is 5 ms."""
CONFIRMED = 2
"""The goal counts as met after so many updates in a row."""


@dataclass(frozen=True)
class Ends:
    """When a capture ends by itself."""

    duration_s: float = inf
    poses: int | None = None
    sigma_m: float | None = None
    """Once the offset is known so well in every direction."""


@dataclass(frozen=True, eq=False)
class Scene:
    """All that a view shows."""

    live: Snapshot
    current: Current | None
    """None before the first update."""
    connected: bool
    lost: Counter[str]
    """What the client left out, by reason."""
    prompt: str


class Updates:
    """The calibration so far, computed in another thread, one at a time."""

    def __init__(self, live: Live, pool: ThreadPoolExecutor, goal_m: float | None) -> None:
        self.latest: Current | None = None
        self.failure: BaseException | None = None
        """What ended the updates; a capture goes on without them."""
        self.met = False
        """Whether the goal was met, `CONFIRMED` times in a row."""
        self._live = live
        self._pool = pool
        self._goal_m = goal_m
        self._in_a_row = 0
        self._running: Future[Current] | None = None
        self._began = -inf
        self._due = -inf

    def look(self) -> None:
        """Take what is ready, and begin what is due."""
        now = time.monotonic()
        if self._running is not None and self._running.done():
            self.failure, running, self._running = self._running.exception(), self._running, None
            if self.failure is not None:
                self._due = inf
                self._live.tell(f"the calibration failed ({self.failure}); the capture goes on")
                return
            self.latest = running.result()
            self._due = max(self._began + UPDATE_S, now + (now - self._began) * (1 / DUTY - 1))
            sigma = self.latest.worst_sigma_m
            met = self._goal_m is not None and sigma is not None and sigma <= self._goal_m
            self._in_a_row = self._in_a_row + 1 if met else 0
            self.met = self._in_a_row >= CONFIRMED
        if self._running is None and now >= self._due:
            poses, of = self._live.some()
            if poses:
                self._began, self._running = now, self._pool.submit(current, poses, of)


STOPPED, GOAL, ENDED = "stopped", "goal met", "ended"
"""Why a capture ended: by the operator, by `Ends.sigma_m`, or by another one of `Ends`."""


@contextlib.contextmanager
def _prompt_threads() -> Iterator[None]:
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def capture(reception: Reception, ends: Ends, keys: Keys, show: Callable[[Scene], None]) -> str:
    """Capture until the operator (an interrupt, Ctrl-C, included) or one of `ends` stops it; returns which.

    Everything that arrived is in the file. Raises InputError where it cannot be written; what a calibration raised is
    raised at the end.
    """
    live, client = reception.live, reception.client
    stop, operator = Event(), Operator(live)
    until = time.monotonic() + ends.duration_s
    with _prompt_threads(), ThreadPoolExecutor(2) as pool:
        updates = Updates(live, pool, ends.sigma_m)
        running = pool.submit(reception.run, stop, ends.poses)

        def scene() -> Scene:
            return Scene(live.snapshot(), updates.latest, client.connected, client.counts.copy(), operator.prompt)

        try:
            while not (stop.is_set() or operator.stopped or updates.met or time.monotonic() >= until):
                operator.press(keys.read(min(KEYS_S, max(until - time.monotonic(), 0.0))))
                updates.look()
                show(scene())
        except KeyboardInterrupt:
            operator.stopped = True
        finally:
            stop.set()
        running.result()
    show(scene())
    if updates.failure is not None:
        raise updates.failure
    return STOPPED if operator.stopped else GOAL if updates.met else ENDED
