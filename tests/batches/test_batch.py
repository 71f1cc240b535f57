"""The batch as a whole: broken recordings, killed workers, interruption and going on, here and on a cluster."""

import csv
import json
import signal
from pathlib import Path

import numpy as np
import pytest

from carm_kin.results.result import CalibrationResult
from helpers.loopback import cluster, end
from helpers.many import ENVIRONMENT, Many, batch, content, interrupted, make

AT_ONCE = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0", "PYTHONPATH": ENVIRONMENT["PYTHONPATH"]}


def rows(out: Path) -> dict[str, dict[str, str]]:
    """The summary by label, in its order."""
    with (out / "summary.csv").open(newline="") as file:
        return {row["label"]: row for row in csv.DictReader(file)}


def files(folder: Path) -> set[str]:
    return {path.stem for path in folder.iterdir()}


def check_all(many: Many, out: Path):
    """One result a recording that has one, near its truth; one reason for every other."""
    found = rows(out)
    assert set(found) == many.labels
    assert list(found) == sorted(found)
    assert files(out / "results") == set(many.truth)
    assert files(out / "refused") == set(many.refused)
    status = {"ok": set(many.truth), "bad_input": set(many.corrupt), "refused": set(many.refused)}
    status["killed"] = set(many.kills)
    assert {s: {label for label, row in found.items() if row["status"] == s} for s in status} == status
    for label, offset in many.truth.items():
        result = CalibrationResult.from_json(out / "results" / f"{label}.json")
        sigma = result.sigma.offset_sensor_pivot_m
        assert np.all(np.abs(result.offset_sensor_pivot_m - offset) < 5 * sigma), label  # 600 draws: 3.5e-4 by chance
        assert result.provenance.input_name == f"{label}.csv"
        shown = [float(found[label][f"offset_{axis}_mm"]) for axis in "xyz"]
        np.testing.assert_allclose(shown, result.offset_sensor_pivot_m * 1e3, rtol=1e-12)
        assert found[label]["reason"] == ""
    for label in many.corrupt:
        assert f"{label}.csv" in found[label]["reason"]
        assert found[label]["offset_x_mm"] == ""
    assert {found[label]["code"] for label in many.refused} <= {"one_axis_only", "too_few_poses"}
    assert all("its worker process died" in found[label]["reason"] for label in many.kills)


@pytest.fixture(scope="module")
def many(tmp_path_factory) -> Many:
    return make(tmp_path_factory.mktemp("many") / "recordings", good=18, corrupt=3, refused=2)


@pytest.fixture(scope="module")
def local(many, tmp_path_factory) -> Path:
    """The folder of a batch that was left alone, with one worker."""
    out = tmp_path_factory.mktemp("local") / "out"
    ended = batch(many.folder, out, "--jobs", 1)
    assert ended.returncode == 3, ended.stderr
    summary = "18 of 24 recordings calibrated, 3 bad_input, 1 killed, 2 refused"
    assert ended.stdout == f"{summary}\n"
    lines = ended.stderr.splitlines()
    done = len(many.labels)
    assert [line.split()[0] for line in lines[:done]] == [f"{k + 1}/24" for k in range(done)]
    assert {line.split()[1] for line in lines[done:-1]} == {str(path) for path in out.iterdir()}
    assert lines[-1] == f"partial: {summary}: the reasons are in {out / 'summary.csv'}"
    return out


def test_broken_refused_and_killing_recordings_take_no_other_with_them(many, local):
    check_all(many, local)


def test_parquet_says_the_same_as_csv(local):
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(local / "summary.parquet")
    assert [str(table.schema.field(name).type) for name in ("label", "poses", "offset_x_mm")] == [
        "string",
        "int64",
        "double",
    ]
    for row, text in zip(table.to_pylist(), rows(local).values(), strict=True):
        assert {name: "" if value is None else str(value) for name, value in row.items()} == text


def test_killed_half_way_and_resumed_the_folder_is_the_same(many, local, tmp_path):
    out = tmp_path / "out"
    status, _ = interrupted(many.folder, out, 8, signal.SIGKILL, "--jobs", 2)
    assert status == -signal.SIGKILL
    assert not (out / "summary.csv").exists()
    before = {path: path.stat().st_mtime_ns for path in sorted((out / "results").iterdir())}
    journalled = {json.loads(line)["label"] for line in (out / "state.jsonl").read_text().splitlines()}
    kept = {path for path in before if path.stem in journalled}
    assert 4 <= len(kept) < len(many.truth)
    ended = batch(many.folder, out, "--jobs", 2, "--resume")
    assert f"{len(journalled - {'kills'})} of 24 recordings are done already" in ended.stderr
    assert content(out) == content(local)
    assert {path: path.stat().st_mtime_ns for path in kept} == {path: before[path] for path in kept}


def test_ctrl_c_says_how_to_go_on(many, tmp_path):
    out = tmp_path / "out"
    status, err = interrupted(many.folder, out, 3, signal.SIGINT, "--jobs", 2)
    assert status == 130
    assert "Traceback" not in err
    assert f"what is done is kept in {out}; the same command with --resume goes on" in err


def test_a_cluster_that_loses_a_worker_gives_the_same_folder(many, local, tmp_path):
    pytest.importorskip("distributed")
    out = tmp_path / "out"
    with cluster(tmp_path, AT_ONCE) as running:
        status, _ = interrupted(many.folder, out, 4, signal.SIGTERM, "--cluster", running.address)
        assert status == -signal.SIGTERM
        assert not (out / "summary.csv").exists()
        end(running.workers[0])
        ended = batch(many.folder, out, "--cluster", running.address, "--resume")
    assert ended.returncode == 3, ended.stderr
    assert "distributed" not in ended.stderr
    assert content(out) == content(local)


@pytest.mark.study
def test_two_hundred_recordings_here_and_on_a_cluster(tmp_path):
    """`pytest -m study tests/batches`: 4 corrupt, 2 refused, 1 that kills its worker; 193 results, 7 reasons."""
    many = make(tmp_path / "recordings", good=193, corrupt=4, refused=2, step=1)
    assert len(many.labels) == 200
    alone, halved, remote = tmp_path / "alone", tmp_path / "halved", tmp_path / "remote"
    assert batch(many.folder, alone, "--jobs", 1).returncode == 3
    check_all(many, alone)
    assert len(files(alone / "results")) == 193
    assert sum(bool(row["reason"]) for row in rows(alone).values()) == 7
    assert interrupted(many.folder, halved, 100, signal.SIGKILL, "--jobs", 2)[0] == -signal.SIGKILL
    assert batch(many.folder, halved, "--jobs", 2, "--resume").returncode == 3
    assert content(halved) == content(alone)
    with cluster(tmp_path, {"PYTHONPATH": ENVIRONMENT["PYTHONPATH"]}) as running:
        assert interrupted(many.folder, remote, 100, signal.SIGKILL, "--cluster", running.address)[0] == -signal.SIGKILL
        end(running.workers[0])
        assert batch(many.folder, remote, "--cluster", running.address, "--resume").returncode == 3
    assert content(remote) == content(alone)
