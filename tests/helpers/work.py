"""Jobs for the tests of the runner, importable by its workers."""

import os
import signal
import time
from pathlib import Path


def square(x: int) -> int:
    return x * x


def slow_square(x: int, seconds: float) -> int:
    time.sleep(seconds)
    return x * x


def fail(words: str) -> None:
    raise ZeroDivisionError(words)


def die() -> None:
    """As the kernel ends a process that is out of memory."""
    os.kill(os.getpid(), signal.SIGKILL)


def crash() -> None:
    """A segmentation fault."""
    os.kill(os.getpid(), signal.SIGSEGV)


def die_once(folder: str) -> str:
    """Kills the first worker that it meets, as an operator who ends the wrong process does."""
    mark = Path(folder) / "died"
    if not mark.exists():
        mark.touch()
        die()
    return "done"


def meet(folder: str, me: str, other: str) -> bool:
    """Whether both of two jobs run at the same time."""
    (Path(folder) / me).touch()
    deadline = time.monotonic() + 20
    while not (Path(folder) / other).exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    return (Path(folder) / other).exists()


def pid() -> int:
    return os.getpid()


def threads() -> dict[str, int]:
    """How many threads each mathematical library of the worker may use, and one that is loaded later."""
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_info

    now = {library["filepath"]: int(library["num_threads"]) for library in threadpool_info()}
    return now | {"later": int(os.environ.get("OPENBLAS_NUM_THREADS", 0))}
