"""What goes to stdout and what to stderr, and how much of it: redirected, quiet, verbose, in narrow places."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import carm_kin
from carm_kin.cli.terminal import Stdout
from helpers.command import fails, run

COMMANDS = (
    *("batch", "calibrate", "capture", "centre", "check", "compare", "convert", "demo"),
    *("experiment", "export", "formats", "inspect", "replay", "simulate"),
)
NUMBERS = re.compile(r"^  (offset sensor to rotation centre, x|major radius|minor radius) .*± .* mm$", re.M)


@pytest.fixture(scope="module")
def rec(tmp_path_factory) -> Path:
    """A recording without a label of the orbital joint, which is warned of."""
    path = tmp_path_factory.mktemp("rec") / "rec.csv"
    recording, _ = carm_kin.simulate("mobile_skewed", sigma_t_m=3e-4, sigma_r_rad=1e-3, labels=False, seed=1)
    carm_kin.write_recording(recording.select(slice(None, None, 4)), path)
    return path


def shell(line: str, folder: Path, **environment: str) -> subprocess.CompletedProcess:
    """A line of sh in which ``carm-kin`` is the command."""
    whole = f'carm-kin() {{ "{sys.executable}" -m carm_kin "$@"; }}\n{line}'
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **environment}
    return subprocess.run(["bash", "-c", whole], cwd=folder, env=env, capture_output=True, text=True, timeout=120)


needs_bash = pytest.mark.skipif(os.name != "posix", reason="needs a shell of POSIX")


@needs_bash
def test_what_is_redirected_holds_the_result(rec, tmp_path):
    ended = shell(f"carm-kin calibrate {rec} --json r.json > out.txt 2> err.txt", tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
    out, err = ((tmp_path / name).read_text() for name in ("out.txt", "err.txt"))
    assert out.startswith("ok: solver kinematic, ")
    assert len(NUMBERS.findall(out)) == 3
    assert "warning" not in out
    lines = err.splitlines()
    assert lines[0] == "written: r.json"
    assert lines[1:]
    assert all(line.startswith("warning (") for line in lines[1:])


def test_json_has_stdout_for_itself_and_the_summary_moves_to_stderr(rec, capsys):
    ended = run(capsys, "calibrate", rec, "--json", "-")
    assert json.loads(ended.out)["status"] == "ok"
    assert len(NUMBERS.findall(ended.err)) == 3
    quiet = run(capsys, "calibrate", rec, "--json", "-", "-q")
    assert (json.loads(quiet.out)["status"], quiet.err) == ("ok", "")


@pytest.mark.parametrize("place", ["before", "after"])
def test_quiet_leaves_the_result_alone(place, rec, tmp_path, capsys):
    def quiet(*arguments: object):
        return run(capsys, *(("-q", *arguments) if place == "before" else (*arguments, "--quiet")))

    ended = quiet("calibrate", rec)
    assert (ended.status, ended.err) == (0, "")
    assert len(NUMBERS.findall(ended.out)) == 3
    for arguments in (
        ("calibrate", rec, "--json", tmp_path / "r.json"),
        ("calibrate", rec, "--report", tmp_path / "r.html"),
        ("convert", rec, "-o", tmp_path / "c.csv"),
        ("simulate", "mobile_isocentric", "--protocol", "minimal", "-o", tmp_path / "s.csv"),
        ("export", tmp_path / "r.json", "--to", "itk", "-o", tmp_path / "r.tfm"),
        ("check", tmp_path / "r.json", rec, "--json", tmp_path / "check.json"),
        ("batch", rec, "-o", tmp_path / "batch", "--jobs", 1),
    ):
        ended = quiet(*arguments)
        assert (ended.status, ended.out, ended.err) == (0, "", ""), arguments


def test_quiet_still_says_why_there_is_no_result(rec, tmp_path, capsys):
    recording = carm_kin.read_recording(rec)
    carm_kin.write_recording(recording.select(slice(0, 4)), tmp_path / "few.csv")
    ended = run(capsys, "-q", "calibrate", tmp_path / "few.csv", "--json", tmp_path / "r.json")
    assert (ended.status, ended.out) == (3, "")
    assert ended.err.startswith("refused (too_few_poses): ")
    assert len(ended.err.splitlines()) == 1
    assert "no such file" in fails(capsys, "calibrate", tmp_path / "none.csv", "-q")


@pytest.mark.parametrize("place", ["before", "after"])
def test_verbose_says_what_is_being_done_with_times(place, rec, tmp_path, capsys):
    arguments = ("calibrate", rec, "--report", tmp_path / "r.html")
    ended = run(capsys, *(("-v", *arguments) if place == "before" else (*arguments, "--verbose")))
    assert ended.status == 0
    steps = [line for line in ended.err.splitlines() if re.search(r" \(\d+\.\d\d s\)$", line)]
    poses = len(carm_kin.read_recording(rec))
    assert [re.sub(r" \([\d.]+ s\)$", "", line) for line in steps] == [
        f"read {rec}: {poses} poses",
        f"solve by kinematic: {poses} poses",
        "assess the estimate",
        "write the report",
    ]
    assert "solve by" not in ended.out
    assert " s)" not in run(capsys, *arguments).err  # the next command is as it was


def test_python_hears_of_the_same(rec, caplog):
    caplog.set_level("INFO", logger="carm_kin")
    carm_kin.calibrate(carm_kin.read_recording(rec))
    assert [record.message.split(":")[0] for record in caplog.records][:2] == [f"read {rec}", "solve by kinematic"]


def test_quiet_and_verbose_exclude_each_other(rec, capsys):
    assert "--quiet and --verbose exclude each other" in fails(capsys, "calibrate", rec, "-q", "-v")
    assert "--quiet and --verbose exclude each other" in fails(capsys, "-qv", "calibrate", rec)


@pytest.mark.parametrize("command", [(), *((name,) for name in COMMANDS), ("session",), ("session", "init")])
def test_h_is_help(command, capsys):
    short, long = (run(capsys, *command, option) for option in ("-h", "--help"))
    assert (short.status, short.err) == (0, "")
    assert short.out == long.out
    assert f"Usage: carm-kin {' '.join(command)}".strip() in short.out
    if command != ("session",):
        assert all(option in short.out for option in ("--quiet", "-q", "--verbose", "-v"))


def said(tables: str) -> list[list[str]]:
    """The words of every line but for times, whose digits also make a column and its rule wider or narrower."""
    without_times = re.sub(r"\d+\.\d *$", "", tables, flags=re.M)
    return [line.split() for line in without_times.splitlines() if set(line.strip()) != {"─"}]


@needs_bash
def test_no_table_is_cut(rec, tmp_path):
    arguments = "--solvers kinematic,direct,closed_form --folds 0"
    wide = shell(f"carm-kin compare {rec} {arguments} | cat", tmp_path, COLUMNS="400")
    ended = shell(f"carm-kin compare {rec} {arguments} | cat", tmp_path, COLUMNS="40")
    assert "sigmas, own and kinematic's" in ended.stdout
    assert "orbital, in the sensor   angular, in the world" in re.sub(r"  +", "   ", ended.stdout)
    assert "…" not in ended.stdout
    assert max(map(len, ended.stdout.splitlines())) > 40
    assert said(ended.stdout) == said(wide.stdout)
    ended = shell(f"carm-kin compare {rec} {arguments} --json - > c.json", tmp_path, COLUMNS="40")
    assert "sigmas, own and kinematic's" in ended.stderr
    assert "…" not in ended.stderr


def test_no_table_is_cut_on_a_narrow_terminal(monkeypatch, capsys):
    from carm_kin.machine import inspection

    monkeypatch.setenv("COLUMNS", "30")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    console = Stdout()
    assert console.is_terminal
    inspection.show(inspection.inspect("mobile_skewed", None, None, None), console)
    text = re.sub(r"\x1b\[[\d;]*m", "", capsys.readouterr().out)
    assert "second axis (beta)" in text
    assert "…" not in text


def test_every_file_that_is_written_has_a_line(rec, tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib", reason="pip install 'carm-kin[figures]'")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("carm_kin.cli.demo.solvers.solver_names", lambda: ("closed_form", "kinematic"))
    known: set[Path] = set()
    for arguments in (
        "simulate mobile_skewed -o s.csv --sigma-t-mm 0.3 --sigma-r-deg 0.05",
        "calibrate s.csv --json r.json --report r.html --figures figures",
        "calibrate s.csv --urdf mobile_skewed --urdf-out c.urdf",
        "compare s.csv --solvers kinematic --folds 0 --json c.json --csv c.csv --figure c.svg --report c.html",
        "check r.json s.csv --json check.json",
        "export r.json --to ros2 -o r.yaml",
        "convert s.csv -o again.csv",
        "demo -o demo --report demo.html",
    ):
        ended = run(capsys, *arguments.split())
        assert ended.status == 0, ended.err
        told = [line.split(" (")[0] for line in ended.err.splitlines() if line.startswith("written: ")]
        files = {path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()}
        assert sorted(told) == sorted(f"written: {path}" for path in files - known), arguments
        known = files


@needs_bash
@pytest.mark.parametrize("first", ["calibrate {rec}", "inspect mobile_skewed", "formats"])
def test_who_reads_the_first_line_may_stop(first, rec, tmp_path):
    ended = shell(f"set -o pipefail; carm-kin {first.format(rec=rec)} | head -1", tmp_path)
    assert ended.returncode == 0
    assert len(ended.stdout.splitlines()) == 1
    assert "Error" not in ended.stderr
    assert "Traceback" not in ended.stderr


@needs_bash
def test_completion_is_installed_and_completes(tmp_path):
    """By the shell that asks, as a user does it; the script then calls the command with what was typed."""
    home = {"HOME": str(tmp_path)}
    ended = shell("carm-kin --install-completion; echo status $?", tmp_path, **home)
    if "not supported" in ended.stderr:
        pytest.skip("the shell around is not told from here")
    script = tmp_path / ".bash_completions" / "carm-kin.sh"
    assert f"bash completion installed in {script}" in ended.stdout, ended.stderr
    assert str(script) in (tmp_path / ".bashrc").read_text()
    program = tmp_path / "carm-kin"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m carm_kin "$@"\n')
    program.chmod(0o755)
    typed = f"source {script}; COMP_WORDS=(carm-kin calib); COMP_CWORD=1; _carm_kin_completion {program}"
    assert shell(f'{typed}; echo "${{COMPREPLY[@]}}"', tmp_path, **home).stdout == "calibrate\n"
