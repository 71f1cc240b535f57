"""What is being done, with times, for whoever listens: the logger ``carm_kin``, level INFO."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LOG = logging.getLogger("carm_kin")


@contextmanager
def step(what: str) -> Iterator[Callable[[str], None]]:
    """Log what was done and how long it took, with the words that the value was called with; not what failed."""
    words: list[str] = []
    start = time.perf_counter()
    yield words.append
    seconds = time.perf_counter() - start
    LOG.info("%s (%.2f s)", ": ".join((what, *words)), seconds)
