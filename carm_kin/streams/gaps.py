"""What is missing in a sequence that should grow by even steps, such as the stamps or numbers of messages."""

from collections import deque
from statistics import median

STEPS = 64
"""The usual step is the median of so many."""
LEAST = 8
"""Steps that must be known before one is called too long."""
LATE = 0.75
"""By how much of a usual step one may be late."""


class Gaps:
    """Counts the missing members of one sequence."""

    def __init__(self) -> None:
        self.missing = 0
        self._steps: deque[float] = deque(maxlen=STEPS)
        self._last: float | None = None

    def add(self, value: float) -> None:
        """The next member; one that is not greater than the one before tells nothing."""
        last, self._last = self._last, value
        if last is None or value <= last:
            return
        step = value - last
        if len(self._steps) >= LEAST:
            steps = step / median(self._steps)
            self.missing += round(steps) - 1 if steps > 1 + LATE else 0
        self._steps.append(step)

    def restart(self) -> None:
        """What lies between the last member and the next one is not counted."""
        self._last = None
