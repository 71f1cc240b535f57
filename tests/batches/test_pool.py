"""The job runner: isolation of jobs that kill their worker, on this machine and on a real cluster."""

import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from carm_kin.batches.local_workers import LocalWorkers
from carm_kin.batches.pool import Job, Outcome, WorkerKilledError, WorkersLostError, run
from carm_kin.errors import InputError
from helpers import work
from helpers.loopback import Cluster, cluster, end
from helpers.places import pythonpath


@pytest.fixture(scope="module")
def loopback(tmp_path_factory):
    pytest.importorskip("distributed")
    at_once = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    with cluster(tmp_path_factory.mktemp("cluster"), at_once) as running:
        yield running


def squares(n: int) -> list[Job]:
    return [Job(f"square {i}", work.square, (i,)) for i in range(n)]


def by_name(outcomes) -> dict[str, Outcome]:
    """Outcomes by the name of their job; every job must have one and no more."""
    found = list(outcomes)
    names = [outcome.job.name for outcome in found]
    assert len(names) == len(set(names))
    return dict(zip(names, found, strict=True))


def alive(pid: int) -> bool:
    """Whether the process runs; one that has ended and is not yet reaped does not."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return False


def gone(pid: int, seconds: float = 10) -> bool:
    deadline = time.monotonic() + seconds
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    return not alive(pid)


def check_killers_are_named(workers):
    jobs = squares(12)
    jobs[2:2] = [Job("out of memory", work.die)]
    jobs[8:8] = [Job("crash", work.crash), Job("fails", work.fail, ("by zero",))]
    found = by_name(run(jobs, workers))
    assert set(found) == {job.name for job in jobs}
    assert [o.error for name, o in found.items() if name.startswith("square")] == [None] * 12
    assert [found[f"square {i}"].value for i in range(12)] == [i * i for i in range(12)]
    assert isinstance(found["out of memory"].error, WorkerKilledError)
    assert isinstance(found["crash"].error, WorkerKilledError)
    failed = found["fails"].error
    assert isinstance(failed, ZeroDivisionError)
    assert str(failed) == "by zero"


def test_jobs_that_kill_their_worker_are_named_and_take_no_other_with_them():
    check_killers_are_named(LocalWorkers(2))


def test_jobs_that_kill_a_worker_of_the_cluster_are_named(loopback: Cluster):
    from carm_kin.batches.cluster import ClusterWorkers

    check_killers_are_named(ClusterWorkers(loopback.address))


def test_a_job_is_not_blamed_for_a_worker_that_died_by_another_hand(tmp_path):
    jobs = [*squares(3), Job("unlucky", work.die_once, (str(tmp_path),))]
    found = by_name(run(jobs, LocalWorkers(1)))
    assert found["unlucky"].value == "done"
    assert [found[f"square {i}"].value for i in range(3)] == [0, 1, 4]


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core: every library has one thread anyway")
def test_a_worker_uses_one_thread(monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    (outcome,) = run([Job("threads", work.threads)], LocalWorkers(1))
    assert outcome.value
    assert set(outcome.value.values()) == {1}


def test_two_workers_work_at_the_same_time(tmp_path):
    jobs = [Job(me, work.meet, (str(tmp_path), me, other)) for me, other in (("a", "b"), ("b", "a"))]
    assert [outcome.value for outcome in run(jobs, LocalWorkers(2))] == [True, True]


def test_closing_the_outcomes_ends_the_workers():
    jobs = [Job("pid", work.pid), *[Job(str(i), work.slow_square, (i, 60)) for i in range(4)]]
    start = time.monotonic()
    with closing(run(jobs, LocalWorkers(2))) as outcomes:
        pid = next(outcomes).value
    assert gone(pid)
    assert time.monotonic() - start < 30


SCRIPT = """
from helpers import work
from carm_kin.batches.pool import Job, run
from carm_kin.batches.local_workers import LocalWorkers

jobs = [Job("pid", work.pid), *[Job(str(i), work.slow_square, (i, 60)) for i in range(4)]]
{guard}
    for outcome in run(jobs, LocalWorkers(1)):
        print(outcome.value, flush=True)
"""


def script(folder: Path, guard: str) -> subprocess.Popen:
    file = folder / "script.py"
    file.write_text(SCRIPT.format(guard=guard))
    env = os.environ | {"PYTHONPATH": pythonpath()}
    return subprocess.Popen(
        [sys.executable, str(file)], env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_workers_end_when_their_parent_is_killed(by, tmp_path):
    parent = script(tmp_path, "if __name__ == '__main__':")
    assert parent.stdout is not None
    worker = int(parent.stdout.readline())
    assert alive(worker)
    parent.send_signal(by)
    parent.communicate(timeout=20)
    assert gone(worker)


def test_a_script_without_a_guard_is_told_so_and_does_not_hang(tmp_path):
    parent = script(tmp_path, "if True:")
    _, err = parent.communicate(timeout=60)
    assert parent.returncode == 1
    assert "WorkersLostError: worker processes do not start; a script must be guarded" in err


def test_no_workers_is_an_input_error():
    with pytest.raises(InputError, match="at least one worker"):
        LocalWorkers(0)


def test_no_scheduler_is_an_input_error(monkeypatch):
    pytest.importorskip("distributed")
    from carm_kin.batches import cluster as module

    monkeypatch.setattr(module, "CONNECT_S", 0.5)
    with pytest.raises(InputError, match="no Dask scheduler answers at tcp://127"):
        list(run(squares(1), module.ClusterWorkers("tcp://127.0.0.1:9")))


def test_a_missing_distributed_says_how_to_get_it(monkeypatch):
    from carm_kin.batches.cluster import ClusterWorkers
    from carm_kin.errors import MissingDependencyError

    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'carm-kin\[cluster\]'"):
        ClusterWorkers("tcp://127.0.0.1:9")


def test_a_cluster_outlives_one_of_its_two_workers_and_not_both(tmp_path):
    pytest.importorskip("distributed")
    from carm_kin.batches.cluster import ClusterWorkers

    with cluster(tmp_path) as running:
        jobs = [Job(str(i), work.slow_square, (i, 0.05)) for i in range(40)]
        values = []
        for outcome in run(jobs, ClusterWorkers(running.address)):
            values.append(outcome.value)
            if len(values) == 5:
                end(running.workers[0])
        assert sorted(values) == [i * i for i in range(40)]
        end(running.workers[1])
        with pytest.raises(WorkersLostError, match="no worker for 3 s"):
            list(run(squares(2), ClusterWorkers(running.address, patience_s=3)))
