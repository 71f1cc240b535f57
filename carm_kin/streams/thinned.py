"""Some of many items, evenly spread, in bounded memory."""

from typing import Generic, TypeVar

T = TypeVar("T")

MOST = 600
"""Items that are kept at most; there are at least half as many once there were so many."""


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
        if len(self.items) > MOST:
            self.items = self.items[::2]
            self._step *= 2
