"""Many independent jobs on worker processes, such that a job which kills its worker takes no other with it.

Where a worker dies, every job that it may have been working on is lost and none is to blame yet. The lost ones are
submitted again when the rest is done, one at a time: the job whose worker then dies once more is the one that kills,
and ends with `WorkerKilledError`.
"""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from contextlib import AbstractContextManager, closing, suppress
from dataclasses import dataclass, replace
from functools import cache
from queue import Empty, SimpleQueue
from threading import Lock
from typing import Any, Protocol

from carm_kin.errors import CarmKinError

POLL_S = 1.0
"""How often idle waiting asks whether the workers are still there."""
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Read by the mathematical libraries that a worker has not loaded yet."""

_ONE_AT_A_TIME = Lock()
"""CasADi does not allow two threads; a worker of a cluster may have several."""


class WorkerKilledError(CarmKinError):
    """A job's worker process died under it."""

    def __init__(self, message: str = "its worker process died, twice: a crash, or the memory was not enough"):
        super().__init__(message)


class WorkersLostError(CarmKinError):
    """There is nobody left to work; what has an outcome is unharmed."""


@dataclass(frozen=True)
class Job:
    """A piece of work: a function that workers can import, and arguments that can be pickled."""

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """How a job ended: with what its function returned, or with an error."""

    job: Job
    value: Any = None
    error: BaseException | None = None
    """What the function raised, or `WorkerKilledError`."""


Outcomes = Generator[Outcome, None, None]


class Workers(Protocol):
    """Where jobs run: `carm_kin.batches.local_workers.LocalWorkers`, `carm_kin.batches.cluster.ClusterWorkers`."""

    @property
    def window(self) -> int:
        """How many jobs are submitted at a time."""
        ...

    @property
    def lost(self) -> tuple[type[BaseException], ...]:
        """The errors of a job whose worker died."""
        ...

    def executor(self, window: int) -> AbstractContextManager[Executor]:
        """Worker processes for ``window`` jobs at a time; left by an exception, they end at once.

        Raises WorkersLostError where there are none.
        """
        ...

    def check(self) -> None:
        """Raise WorkersLostError where no worker is left. Asked while waiting."""
        ...


def run(jobs: Iterable[Job], workers: Workers) -> Outcomes:
    """The outcome of every job, in the order in which they end.

    An exception in a job is an outcome. Close the iterator, or leave it by an exception such as KeyboardInterrupt,
    to end the workers. Raises WorkersLostError where there is no worker left.
    """
    suspects: deque[Job] = deque()
    with closing(_outcomes(deque(jobs), workers, workers.window)) as outcomes:
        for outcome in outcomes:
            if isinstance(outcome.error, workers.lost):
                suspects.append(outcome.job)
            else:
                yield outcome
    with closing(_outcomes(suspects, workers, 1)) as outcomes:
        for outcome in outcomes:
            killed = isinstance(outcome.error, workers.lost)
            yield replace(outcome, error=WorkerKilledError()) if killed else outcome


def call(job: Job) -> Any:
    """What a worker does: the job alone in its process, on one thread, so that its numbers do not depend on others."""
    with _ONE_AT_A_TIME:
        _use_one_thread()
        return job.function(*job.arguments)


@cache
def _use_one_thread() -> None:
    from threadpoolctl import threadpool_limits

    os.environ.update(dict.fromkeys(THREADS, "1"))
    threadpool_limits(1)


def _outcomes(waiting: deque[Job], workers: Workers, window: int) -> Outcomes:
    """The outcomes, those of lost jobs among them; a fresh executor takes the place of a broken one."""
    while waiting:
        with workers.executor(window) as executor:
            yield from _until_broken(executor, waiting, workers, window)


def _until_broken(executor: Executor, waiting: deque[Job], workers: Workers, window: int) -> Outcomes:
    """Outcomes while the executor lasts; then those of all that it had, what it had not stays ``waiting``."""
    ended: SimpleQueue[Future] = SimpleQueue()
    running: dict[Future, Job] = {}
    intact = True
    while running or (waiting and intact):
        while waiting and intact and len(running) < window:
            try:
                future = executor.submit(call, waiting[0])
            except BrokenExecutor:
                intact = False
                continue
            running[future] = waiting.popleft()
            future.add_done_callback(ended.put)
        if not running:
            break
        future = _next(ended, workers)
        outcome = _outcome(running.pop(future), future)
        intact = intact and not isinstance(outcome.error, BrokenExecutor)
        yield outcome


def _next(ended: "SimpleQueue[Future]", workers: Workers) -> Future:
    while True:
        with suppress(Empty):
            return ended.get(timeout=POLL_S)
        workers.check()


def _outcome(job: Job, future: Future) -> Outcome:
    error = CancelledError() if future.cancelled() else future.exception()
    if isinstance(error, CancelledError):
        raise WorkersLostError("the workers are gone, and took back the jobs that they had")
    return Outcome(job, error=error) if error else Outcome(job, future.result())
