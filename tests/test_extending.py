"""Packages of others: what docs/extending.md writes is installed and run, broken ones are named and passed over."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.recording.recording import Recording
from carm_kin.testing.truth import machine, problem, sweeps_deg
from helpers.places import ROOT, pythonpath

PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
SNIPPETS = dict(re.findall(r"^```\w+\n# (\S+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))
MOST_LINES = 40
TURN = range(0, 360, 30)
TIP = np.array([0.01, -0.02, 0.15])


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """The page's package, built by its own backend and unpacked as pip does it."""
    pytest.importorskip("hatchling", reason="hatchling is not installed here; pip install hatchling")
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("installed")
    for name, text in SNIPPETS.items():
        (source / name).parent.mkdir(exist_ok=True)
        (source / name).write_text(text)
    (source / "my_carm" / "__init__.py").write_text("")
    code = f"from hatchling.build import build_wheel; build_wheel({str(source)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=source, check=True, capture_output=True, timeout=60)
    (wheel,) = source.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(target)
    (target / "test_contracts.py").write_text(SNIPPETS["tests/test_contracts.py"])
    return target


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A recording of a C-arm and one of a tool in a guide, as CSV."""
    folder = tmp_path_factory.mktemp("recordings")
    poses = problem(machine(5, 0.06), sweeps_deg((-90, 0, 90), TURN, (0, 70), TURN), 1e-4, 1e-4)
    carm = Recording(poses.p_world_sensor, poses.R_world_sensor, np.arange(len(poses)) / 10)
    carm_kin.write_recording(carm, folder / "rec.csv")
    R = Rotation.random(60, random_state=6).as_matrix()
    tip = np.column_stack([np.full(60, 0.3), np.full(60, 0.1), np.linspace(-0.9, -0.5, 60)])
    noise = 1e-5 * np.random.default_rng(5).normal(size=(60, 3))
    carm_kin.write_recording(Recording(tip - R @ TIP + noise, R), folder / "tool.csv")
    return folder


def python(folder: Path, paths: list[Path], *arguments: object) -> subprocess.CompletedProcess:
    """Python with these packages installed beside the project's own."""
    environment = os.environ | {"PYTHONPATH": pythonpath(*paths), "COLUMNS": "200"}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False
    )


def said(folder: Path, paths: list[Path], *arguments: object, status: int = 0) -> str:
    """Everything that the command printed."""
    ended = python(folder, paths, "-m", "carm_kin", *arguments)
    text = ended.stdout + ended.stderr
    assert ended.returncode == status, text
    assert "Traceback" not in text
    return text


def plugin(folder: Path, group: str, name: str, code: str, package: str = "their") -> Path:
    """A package with one entry point, installed by hand."""
    (folder / f"{package}.py").write_text(code)
    info = folder / f"{package}-2.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 2.0\n")
    (info / "entry_points.txt").write_text(f"[carm_kin.{group}]\n{name} = {package}\n")
    return folder


@pytest.mark.parametrize("name", [name for name in SNIPPETS if name.startswith("my_carm/")])
def test_each_is_under_forty_lines(name):
    assert len(SNIPPETS[name].splitlines()) < MOST_LINES


def test_the_page_writes_one_of_each_kind():
    assert sorted(SNIPPETS) == [
        *("my_carm/acme.py", "my_carm/guide.py", "my_carm/rows.py", "my_carm/trimmed.py"),
        *("pyproject.toml", "tests/test_contracts.py"),
    ]


def test_the_contracts_of_the_page_hold(installed, tmp_path):
    ended = python(tmp_path, [installed], "-m", "pytest", "-q", "-p", "no:cacheprovider", installed)
    assert "4 passed" in ended.stdout, ended.stdout + ended.stderr


NAMED = [
    ("calibrate", "--solver ", "trimmed"),
    ("calibrate", "--locus ", "guide"),
    ("batch", "--locus ", "guide"),
    ("compare", "--solvers ", "trimmed"),
    ("export", "--to ", "rows"),
]


@pytest.mark.parametrize("command, option, name", NAMED)
def test_the_help_names_them(command, option, name, installed, tmp_path):
    _, text = said(tmp_path, [installed], command, "--help").split(option, 1)
    assert re.search(rf"\b{name}\b", text[:400])
    assert not re.search(rf"\b{name}\b", said(tmp_path, [], command, "--help"))


def test_help_imports_no_plugin(tmp_path):
    paths = [plugin(tmp_path, "solvers", "slow", "raise SystemExit('imported')")]
    text = said(tmp_path, paths, "calibrate", "--help")
    assert "slow" in text
    assert "imported" not in text


def test_the_format_is_listed_and_read_and_written(installed, folder, tmp_path):
    assert re.search(r"acme +read, write +Log of an ACME tracker", said(folder, [installed], "formats"))
    said(folder, [installed], "convert", "rec.csv", "-o", tmp_path / "rec.acme")
    assert (tmp_path / "rec.acme").read_text().startswith("# ACME\n0.0")
    assert "(acme" in said(folder, [installed], "convert", tmp_path / "rec.acme", "-o", tmp_path / "again.csv")
    given, again = (carm_kin.read_recording(path) for path in (folder / "rec.csv", tmp_path / "again.csv"))
    np.testing.assert_allclose(again.p_world_sensor, given.p_world_sensor, rtol=0, atol=1e-11)


def test_the_solver_calibrates_with_its_options_and_the_export_writes(installed, folder, tmp_path):
    result, out = tmp_path / "result.json", tmp_path / "out.txt"
    said(folder, [installed], "calibrate", "rec.csv", "--solver", "trimmed", "--option", "kept=0.8", "--json", result)
    found = carm_kin.CalibrationResult.from_json(result)
    assert (found.solver, found.used, found.poses) == ("trimmed", 48, 60)
    np.testing.assert_allclose(found.offset_sensor_pivot_m, machine(5, 0.06).offset, rtol=0, atol=5e-4)
    said(folder, [installed], "export", result, "--to", "rows", "-o", out)
    np.testing.assert_allclose(np.loadtxt(out)[:3, 3] / 1e3, found.offset_sensor_pivot_m, rtol=1e-12)
    said(folder, [installed], "calibrate", "rec.csv", "--solver", "trimmed", "--option", "kept=0.1", status=2)


def test_the_locus_finds_the_tip_in_its_guide(installed, folder, tmp_path):
    result = tmp_path / "tool.json"
    said(folder, [installed], "calibrate", "tool.csv", "--locus", "guide", "--json", result)
    found = carm_kin.CalibrationResult.from_json(result)
    np.testing.assert_allclose(found.offset_sensor_pivot_m, TIP, rtol=0, atol=2e-5)
    assert 0 < found.sigma.offset_sensor_pivot_m.max() < 1e-5
    words = said(folder, [installed], "calibrate", "tool.csv", "--locus", "bogus", status=2)
    assert "it is one of circle, point, guide" in words


def test_the_solver_stands_in_a_comparison(installed, folder):
    words = said(folder, [installed], "compare", "rec.csv", "--folds", "0")
    assert re.search(r"^ *trimmed +[\d.-]", words, re.MULTILINE)
    assert "trimmed" not in said(folder, [], "compare", "rec.csv", "--folds", "0")


BROKEN = [
    ("formats", "raise ZeroDivisionError('ouch')", "ZeroDivisionError: ouch"),
    ("formats", "import nowhere_to_be_found", "No module named 'nowhere_to_be_found'"),
    ("formats", "import sys\nsys.exit(5)", "SystemExit: 5"),
    ("formats", "SUMMARY = ''\ndef read(path, declared): ...", "their has no matches"),
    ("formats", "def matches(p, h): return h[9**9]\nSUMMARY = ''\nread = 1", "IndexError: index out of range"),
    ("solvers", "def solve(problem, options): ...", "their has no Options"),
    ("exports", "syntax error", "SyntaxError: invalid syntax"),
]


@pytest.mark.parametrize("group, code, reason", BROKEN)
def test_a_broken_plugin_is_named_once_and_passed_over(group, code, reason, folder, tmp_path):
    paths, result = [plugin(tmp_path, group, "theirs", code)], tmp_path / "r.json"
    carm_kin.calibrate(carm_kin.read_recording(folder / "rec.csv")).to_json(result)
    arguments = {
        "formats": ("convert", "rec.csv", "-o", tmp_path / "rec.mha"),
        "solvers": ("compare", "rec.csv", "--folds", "0"),
        "exports": ("export", result, "--to", "json", "-o", tmp_path / "out.json"),
    }[group]
    words = said(folder, paths, *arguments)
    (warning,) = [line for line in words.splitlines() if line.startswith("warning: passed over")]
    assert warning.startswith(f"warning: passed over 'theirs' (carm_kin.{group}) of the package their 2.0: ")
    assert reason in warning


def test_a_broken_solver_that_is_asked_for_is_bad_input(folder, tmp_path):
    paths = [plugin(tmp_path, "solvers", "theirs", "raise ZeroDivisionError('ouch')")]
    words = said(folder, paths, "calibrate", "rec.csv", "--solver", "theirs", status=2)
    assert "theirs" in words
    assert "their 2.0: ZeroDivisionError: ouch" in words


def test_a_solver_that_fails_says_so_in_its_place(folder, tmp_path):
    code = "Options = __import__('solvers.closed_form', fromlist=['Options']).Options\n"
    paths = [plugin(tmp_path, "solvers", "theirs", code + "def solve(problem, options): return 1 // 0")]
    words = said(folder, paths, "compare", "rec.csv", "--folds", "0")
    assert "theirs: 'theirs' (carm_kin.solvers) of the package their 2.0: ZeroDivisionError" in words
    assert re.search(r"^ *kinematic +[\d.-]", words, re.MULTILINE)
    words = said(folder, paths, "demo", "--out", tmp_path / "demo")
    assert "theirs: 'theirs' (carm_kin.solvers)" in words


@pytest.mark.parametrize("name", ["kinematic", "chain"])
def test_a_name_that_is_taken_stays_what_it_is(name, folder, tmp_path):
    paths = [plugin(tmp_path, "solvers", name, "raise AssertionError")]
    words = said(folder, paths, "compare", "rec.csv", "--folds", "0")
    assert f"passed over '{name}' (carm_kin.solvers) of the package their 2.0: the name is taken already" in words
    assert re.search(r"^ *kinematic +[\d.-]", words, re.MULTILINE)


def test_of_two_packages_the_first_has_the_name(folder, tmp_path):
    code = "SUMMARY = '{}'\ndef matches(path, head): return False\ndef read(path, declared): ..."
    paths = []
    for package in ("one", "other"):
        (tmp_path / package).mkdir()
        paths.append(plugin(tmp_path / package, "formats", "theirs", code.format(package), package))
    words = said(folder, paths, "formats")
    assert re.search(r"^ *theirs +read +one$", words, re.MULTILINE)
    assert "passed over 'theirs' (carm_kin.formats) of the package other 2.0: the name is taken already" in words
