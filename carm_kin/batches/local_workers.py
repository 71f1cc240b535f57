"""Worker processes on this machine."""

import os
import signal
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from threading import Thread

from carm_kin.batches.pool import WorkersLostError
from carm_kin.errors import InputError


@dataclass(frozen=True)
class LocalWorkers:
    """``count`` processes of their own, started afresh and not forked."""

    count: int

    lost = (BrokenExecutor,)
    """A dead worker breaks its executor: every job that was submitted is lost with it."""

    def __post_init__(self) -> None:
        if self.count < 1:
            raise InputError(f"at least one worker is needed, not {self.count}")

    @property
    def window(self) -> int:
        """A job to do and one to go on with for each."""
        return 2 * self.count

    @contextmanager
    def executor(self, window: int) -> Iterator[ProcessPoolExecutor]:
        """A pool whose workers end when it is left, and when this process dies, in whatever way."""
        context = get_context("spawn")
        leash, held = context.Pipe(duplex=False)
        size = min(self.count, window)
        pool = ProcessPoolExecutor(size, context, _on_leash, (leash,))
        try:
            _start(pool, size)
            yield pool
            pool.shutdown()
        finally:
            held.close()
            pool.shutdown(cancel_futures=True)
            leash.close()

    def check(self) -> None:
        """Nothing to do: a dead worker breaks its pool."""


def _start(pool: ProcessPoolExecutor, size: int) -> None:
    """Let every worker start, and raise WorkersLostError where they do not live to do the simplest job."""
    first, *_ = [pool.submit(os.getpid) for _ in range(size)]
    if isinstance(first.exception(), BrokenExecutor):
        raise WorkersLostError("worker processes do not start; a script must be guarded: if __name__ == '__main__'")


def _on_leash(leash: Connection) -> None:
    """In a worker: leave Ctrl-C to the parent, and end when the other end of the leash is let go."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with, args=(leash,), daemon=True).start()


def _end_with(leash: Connection) -> None:
    wait([leash])
    os.kill(os.getpid(), signal.SIGTERM)
