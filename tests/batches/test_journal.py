"""What a batch does again when it goes on, and what it leaves: by the journal, the key of a job, the files in place."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import carm_kin
from carm_kin.batches.batch import Batch
from carm_kin.batches.entries import entries
from carm_kin.batches.job import calibrate_file, versions
from carm_kin.batches.journal import Journal, Line
from carm_kin.calibration.settings import Settings
from carm_kin.errors import InputError
from carm_kin.machine.urdf import bundled_urdfs
from helpers.command import Ended, fails, run
from helpers.here import Here
from helpers.many import simulated
from helpers.places import ROOT

LINE = Line("a", "a.csv", "ok", "", "", "00", "11")


@pytest.fixture(autouse=True)
def _workers_here(monkeypatch):
    monkeypatch.setattr("carm_kin.batches.local_workers.LocalWorkers", Here)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> Path:
    """Two recordings that can be calibrated, and one with motion about one axis."""
    folder = tmp_path_factory.mktemp("recordings")
    for label, seed in (("first", 1), ("second", 2)):
        carm_kin.write_recording(simulated(seed, 12)[0], folder / f"{label}.csv")
    recording, _ = simulated(3, 12)
    carm_kin.write_recording(recording.select(recording.sweep == recording.sweeps[0].label), folder / "third.csv")
    return folder


@pytest.fixture(scope="module")
def finished(recordings, tmp_path_factory) -> dict[str, bytes]:
    """The files of a batch's folder."""

    out = tmp_path_factory.mktemp("finished")
    Batch(tuple(entries([recordings], {}, out)), out).run(Here(1), {})
    return {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}


@pytest.fixture
def out(finished, tmp_path) -> Path:
    """A folder of its own with these files."""
    for name, data in finished.items():
        (tmp_path / "out" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "out" / name).write_bytes(data)
    return tmp_path / "out"


def redone(ended: Ended) -> set[str]:
    """The labels of what was done, from the lines of progress."""
    return {line.split()[1].rstrip(":") for line in ended.err.splitlines() if line.split("/")[0].isdigit()}


def resume(capsys, recordings: object, out: Path, *more: object) -> set[str]:
    ended = run(capsys, "batch", recordings, "-o", out, "--jobs", 1, "--resume", *more)
    assert ended.status == 3, ended.err
    return redone(ended)


def test_a_finished_batch_is_not_begun_again_without_resume(recordings, out, capsys):
    assert "holds a batch; go on with it by --resume" in fails(capsys, "batch", recordings, "-o", out)


def test_nothing_is_done_again_where_nothing_changed(recordings, out, finished, capsys):
    assert resume(capsys, recordings, out) == set()
    assert {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()} == finished


def test_a_changed_recording_is_done_again(recordings, out, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(recordings.parent)
    copy = tmp_path / recordings.name
    copy.mkdir()
    for path in recordings.iterdir():
        (copy / path.name).write_bytes(path.read_bytes())
    with (copy / "second.csv").open("a") as file:
        file.write("# one more line\n")
    text = (out / "state.jsonl").read_text().replace(str(recordings), str(copy))
    (out / "state.jsonl").write_text(text)
    assert resume(capsys, copy, out) == {"second"}


@pytest.mark.parametrize("more", [("--solver", "closed_form"), ("-O", "seed=1"), ("--sigma-t-mm", "0.3")])
def test_changed_settings_do_all_again(more, recordings, out, capsys):
    assert resume(capsys, recordings, out, *more) == {"first", "second", "third"}


def test_other_versions_do_all_again(recordings, out, capsys, monkeypatch):
    from carm_kin.batches import batch

    monkeypatch.setattr(batch, "versions", lambda: versions() | {"numpy": "0.0.1"})
    ended = run(capsys, "batch", recordings, "-o", out, "--jobs", 1, "--resume")
    assert redone(ended) == {"first", "second", "third"}
    assert "this worker has numpy" in ended.err


@pytest.mark.parametrize(
    "harm",
    {
        "gone": lambda path: path.unlink(),
        "changed": lambda path: path.write_bytes(path.read_bytes().replace(b"0", b"1", 1)),
        "empty": lambda path: path.write_bytes(b""),
    }.items(),
    ids=lambda harm: harm[0],
)
def test_a_result_that_is_not_what_was_written_is_made_again(harm, recordings, out, finished, capsys):
    harm[1](out / "results/second.json")
    assert resume(capsys, recordings, out) == {"second"}
    result = carm_kin.CalibrationResult.from_json(out / "results/second.json")
    before = json.loads(finished["results/second.json"])
    assert result.to_dict()["offset_sensor_pivot_mm"] == before["offset_sensor_pivot_mm"]


def test_a_line_cut_off_by_a_kill_counts_as_not_written(recordings, out, capsys):
    text = (out / "state.jsonl").read_text()
    assert text.splitlines()[-1].startswith('{"label": "third"')
    (out / "state.jsonl").write_text(text[:-20])
    assert resume(capsys, recordings, out) == {"third"}


def test_a_killed_job_is_tried_again(recordings, out, capsys):
    lines = [json.loads(line) for line in (out / "state.jsonl").read_text().splitlines()]
    lines[0] |= {"status": "killed", "result_sha256": None}
    (out / "state.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert resume(capsys, recordings, out) == {"first"}


def test_a_result_that_no_longer_stands_is_removed(recordings, out, capsys):
    """`second` is refused with a limit on its noise that it does not keep."""
    ended = run(capsys, "batch", recordings, "-o", out, "--jobs", 1, "--resume", "--sigma-t-mm", "0.001")
    assert ended.status == 3
    assert list((out / "results").iterdir()) == []
    assert {path.name for path in (out / "refused").iterdir()} == {"first.json", "second.json", "third.json"}


def test_results_of_other_recordings_are_not_mixed_in(recordings, out, capsys):
    problem = fails(capsys, "batch", recordings / "first.csv", "-o", out, "--resume", "--jobs", 1)
    assert "holds results of 'second' and 1 more, not among the recordings given" in problem


@pytest.mark.parametrize(
    "arguments, expected",
    {
        ("rec.csv", "-o", "out", "--jobs", "0"): "--jobs",
        ("rec.csv", "-o", "out", "--jobs", "2", "--cluster", "tcp://127.0.0.1:9"): "exclude each other",
        ("rec.csv",): "Missing option '--out' / '-o'",
        ("none.csv", "-o", "out"): "none.csv: no such file or folder",
        ("rec.csv", "-o", "rec.csv", "--jobs", "1"): "rec.csv: the folder cannot be used",
        ("rec.csv", "-o", "out", "--solver", "bogus"): "solver 'bogus' is unknown",
        ("rec.csv", "-o", "out", "-O", "bogus=1"): "no option 'bogus'",
    }.items(),
)
def test_bad_usage_is_one_line_and_leaves_no_folder(arguments, expected, recordings, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rec.csv").write_bytes((recordings / "first.csv").read_bytes())
    assert expected in fails(capsys, "batch", *arguments)
    assert [path.name for path in tmp_path.iterdir()] == ["rec.csv"]


def test_a_scheduler_that_does_not_answer_leaves_a_folder_that_can_be_used(recordings, tmp_path, monkeypatch, capsys):
    pytest.importorskip("distributed")
    monkeypatch.setattr("carm_kin.batches.cluster.CONNECT_S", 0.3)
    arguments = ("batch", recordings, "-o", tmp_path / "out")
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in fails(
        capsys, *arguments, "--cluster", "tcp://127.0.0.1:9"
    )
    assert len(redone(run(capsys, *arguments, "--jobs", 1))) == 3


def test_the_command_in_a_result_makes_the_same_result(recordings, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(recordings)
    settings = Settings(solver="closed_form", sigma_t_mm=0.3, cross_validate=2, options={"reject_outliers": False})
    report = calibrate_file(recordings / "first.csv", settings, versions())
    assert report.status == "ok"
    assert report.text is not None
    whole = json.loads(report.text)
    command = whole["provenance"]["command"].split()
    assert command[:3] == ["carm-kin", "calibrate", "first.csv"]
    assert run(capsys, *command[1:], "--json", tmp_path / "same.json").status == 0
    same = json.loads((tmp_path / "same.json").read_text())
    assert {k: v for k, v in same.items() if k != "provenance"} == {k: v for k, v in whole.items() if k != "provenance"}


def test_with_a_urdf_its_chain_is_calibrated_and_its_bytes_are_in_the_key(recordings, tmp_path):
    machine = tmp_path / "own.urdf"
    machine.write_bytes(bundled_urdfs()["mobile_nonisocentric"].read_bytes())
    reports = [calibrate_file(recordings / "first.csv", Settings(urdf=str(machine)), versions())]
    machine.write_bytes(machine.read_bytes() + b"<!-- -->")
    reports.append(calibrate_file(recordings / "first.csv", Settings(urdf=str(machine)), versions()))
    first, second = (json.loads(report.text or "") for report in reports)
    assert first["solver"] == "chain"
    np.testing.assert_allclose(first["offset_sensor_pivot_mm"], [130, 80, -700], atol=1)
    assert first["offset_sensor_pivot_mm"] == second["offset_sensor_pivot_mm"]
    assert reports[0].key != reports[1].key


def test_a_worker_with_other_versions_does_not_calibrate(recordings):
    with pytest.raises(InputError, match=r"this worker has numpy .*: not what the batch was started with"):
        calibrate_file(recordings / "first.csv", Settings(), versions() | {"numpy": "0.0.1"})


@pytest.mark.parametrize("line", ["{", "3", "null", "[]", '{"label": "a"}', "\0\xff", "[" * 100_000])
def test_a_journal_of_nonsense_is_read_as_far_as_it_goes(line, tmp_path):
    journal = Journal(tmp_path / "state.jsonl")
    journal.append(LINE)
    with journal.path.open("a", encoding="utf-8") as file:
        file.write(line + "\n")
    journal.append(Line("b", "b.csv", "bad_input", "", "why", "22", None))
    assert journal.read().keys() == {"a", "b"}
    assert journal.read()["a"] == LINE


def test_the_last_line_of_a_label_counts(tmp_path):
    journal = Journal(tmp_path / "state.jsonl")
    journal.append(Line("a", "a.csv", "killed", "", "died", None, None))
    journal.append(LINE)
    assert journal.read() == {"a": LINE}


def test_the_script_and_the_list_in_the_docs_work(recordings, tmp_path):
    text = (ROOT / "docs" / "batch.md").read_text(encoding="utf-8")
    blocks = {kind: re.findall(rf"```{kind}\n(.*?)```", text, re.DOTALL) for kind in ("python", "toml")}
    (tmp_path / "recordings").mkdir()
    for name in ("first", "third"):
        (tmp_path / "recordings" / f"{name}.csv").write_bytes((recordings / f"{name}.csv").read_bytes())
    (tmp_path / "script.py").write_text(blocks["python"][0])
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    ended = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=env, capture_output=True, text=True, timeout=60, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert [line.split()[:2] for line in ended.stdout.splitlines()] == [["first", "ok"], ["third", "refused"]]
    assert (tmp_path / "calibrated/results/first.json").exists()
    for name in ("monday/a.csv", "tuesday.csv", "lift/b.csv", "our_carm.urdf"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(bundled_urdfs()["mobile_skewed"].read_bytes())
    (tmp_path / "list.toml").write_text(blocks["toml"][0])
    found = {entry.label: entry.settings for entry in entries([tmp_path / "list.toml"], {}, tmp_path / "out")}
    assert found.keys() == {"a", "patient 12", "b"}
    assert {settings.cross_validate for settings in found.values()} == {5}
