"""A Dask scheduler and workers, as an operator starts them, on the loopback interface."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from helpers.places import pythonpath


@dataclass(frozen=True)
class Cluster:
    """Its address, and its worker processes; each has a nanny, which starts it anew when it dies."""

    address: str
    workers: tuple[subprocess.Popen, ...]


@contextmanager
def cluster(folder: Path, environment: Mapping[str, str] | None = None, workers: int = 2) -> Iterator[Cluster]:
    """The cluster; its processes end with it."""
    env = (
        os.environ
        | {"PYTHONPATH": pythonpath(), "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "5s"}
        | dict(environment or {})
    )
    file = folder / "scheduler.json"
    started = []

    def start(*arguments: object) -> subprocess.Popen:
        log = (folder / f"log{len(started)}.txt").open("w")
        command = [sys.executable, "-m", "dask", *map(str, arguments), "--no-dashboard", "--scheduler-file", str(file)]
        process = subprocess.Popen(command, env=env, cwd=folder, stdout=log, stderr=log, start_new_session=True)
        started.append(process)
        return process

    try:
        start("scheduler", "--host", "127.0.0.1", "--port", 0)
        address = _address(file)
        yield Cluster(address, tuple(start("worker", "--nworkers", 1, "--nthreads", 1) for _ in range(workers)))
    finally:
        for process in started:
            end(process)


def end(process: subprocess.Popen) -> None:
    """Kill a process and all that it started."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _address(file: Path) -> str:
    """Where the scheduler listens, once it does."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        if file.exists() and (text := file.read_text()):
            return json.loads(text)["address"]
        time.sleep(0.05)
    raise TimeoutError("the scheduler does not start")
