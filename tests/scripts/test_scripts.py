"""Every script, run as a user runs it, and what it prints against what the URDF's own numbers say."""

import json
import os
import re
import runpy
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import carm_kin
from helpers.family import FILES, link_pose
from helpers.places import ROOT, pythonpath

SCRIPTS = {path.stem: path for path in sorted((ROOT / "scripts").glob("*.py"))}
README = (ROOT / "scripts" / "README.md").read_text("utf-8")
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
NOISE = {"sigma_t_m": 0.2e-3, "sigma_r_rad": np.radians(0.1)}
OWN = "mobile_beam_offset"
"""The machine of the recordings that the scripts are given."""
DETECTOR = np.array([1024, 1024]), 0.3e-3
"""Pixels and their size in scripts/projection.py."""


@dataclass(frozen=True)
class Ended:
    """What a script left behind."""

    out: str
    folder: Path

    def numbers(self, pattern: str) -> np.ndarray:
        """(L, K) the numbers in each line that holds the pattern, those of the pattern itself left out."""
        lines = [re.sub(pattern, "", line) for line in self.out.splitlines() if re.search(pattern, line)]
        return np.array([[float(number) for number in NUMBER.findall(line)] for line in lines])


def run(script: str, folder: Path, *arguments: object) -> Ended:
    """``python scripts/SCRIPT.py ARGUMENTS`` in a folder."""
    environment = os.environ | {"PYTHONPATH": pythonpath(), "PYTHONUTF8": "1", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(SCRIPTS[script]), *map(str, arguments)]
    ended = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, encoding="utf-8", timeout=120, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert "Traceback" not in ended.stderr
    return Ended(ended.stdout, folder)


def axes(urdf: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A point on the angular axis and its direction, the same of the orbital axis, in the sensor's frame, m."""
    root = ElementTree.parse(urdf).getroot()
    T_sensor_base = np.linalg.inv(link_pose(urdf, "sensor", {}))
    found = []
    for name in ("angular", "orbital"):
        joint = root.find(f"joint[@name='{name}']")
        T = T_sensor_base @ link_pose(urdf, joint.find("child").get("link"), {})
        direction = T[:3, :3] @ np.array(joint.find("axis").get("xyz").split(), float)
        found += [T[:3, 3], direction / np.linalg.norm(direction)]
    return tuple(found)


def pivot_mm(urdf: Path) -> np.ndarray:
    """(3,) the foot of the common perpendicular of both axes on the orbital one, in the sensor's frame."""
    p, n, q, a = axes(urdf)
    normal = np.cross(n, a)
    along = np.linalg.solve(np.stack([n, -a, normal], axis=1), q - p)[1]
    return (q + along * a) * 1e3


def radius_mm(urdf: Path) -> float:
    """The distance of the axes."""
    p, n, q, a = axes(urdf)
    normal = np.cross(n, a)
    return abs((q - p) @ normal) / np.linalg.norm(normal) * 1e3


def offset_in_summary(ended: Ended, machine: str) -> np.ndarray:
    """(3,) the offset, mm, which is right by the standard deviations beside it."""
    offset, sigma = ended.numbers(r"rotation centre, x|^ {36}[yz] ").T
    assert (abs(offset - pivot_mm(FILES[machine])) < 4 * sigma).all()
    assert (sigma < 0.1).all()
    return offset


def calibrate_recording(ended: Ended, machine: str) -> None:
    offset = offset_in_summary(ended, machine)
    np.testing.assert_allclose(ended.numbers("offset in metres")[0] * 1e3, offset, atol=6e-4)
    saved = json.loads((ended.folder / "example" / "result.json").read_bytes())
    np.testing.assert_allclose(saved["offset_sensor_pivot_mm"], offset, atol=6e-4)
    assert (ended.folder / "example" / "report.html").read_text("utf-8").lower().startswith("<!doctype html>")


def compare_solvers(ended: Ended, machine: str) -> None:
    direct, decomposed = (ended.numbers(rf"^{solver} +offset ")[0, :3] for solver in ("direct", "decomposed"))
    truth = pivot_mm(FILES[machine])
    for offset in (direct, decomposed):
        assert np.linalg.norm(offset - truth) < 0.3
    apart = {"direct and decomposed": direct - decomposed}
    if "and truth" in ended.out:
        apart |= {"direct and truth": direct - truth, "decomposed and truth": decomposed - truth}
    for pair, difference in apart.items():
        (stated,) = ended.numbers(f"offsets of {pair} differ by")[0]
        assert stated == pytest.approx(np.linalg.norm(difference), abs=2e-3)


def batch_folder(ended: Ended, machine: str) -> None:
    good = ended.numbers("^(monday|wednesday)")
    assert len(good) == 2
    np.testing.assert_allclose(good[:, :3], [pivot_mm(FILES[machine])] * 2, atol=0.3)
    np.testing.assert_allclose(good[:, 3], radius_mm(FILES[machine]), atol=0.15)
    assert re.search(r"^tuesday +refused \(one_axis_only\): ", ended.out, re.MULTILINE)
    results = ended.folder / "example" / "calibrated" / "results"
    assert sorted(path.name for path in results.iterdir()) == ["monday.json", "wednesday.json"]


def calibrated_urdf(ended: Ended, machine: str) -> None:
    """The file that was written has the numbers of the machine that the recording is of."""
    written = ended.folder / "example" / "calibrated.urdf"
    assert radius_mm(written) == pytest.approx(radius_mm(FILES[machine]), abs=0.1)
    np.testing.assert_allclose(pivot_mm(written), pivot_mm(FILES[machine]), atol=0.2)
    drawing, calibrated = ended.numbers(r"^residuals, \w+")[:, 0]
    assert calibrated < 0.5 < drawing
    ((shift, sigma),) = ended.numbers("orbital moved along z")
    assert 4 * sigma > abs(abs(shift) - abs(radius_mm(FILES[machine]) - radius_mm(FILES["mobile_nonisocentric"])))


def rotation_centre(ended: Ended, machine: str) -> None:
    """The first and last pose stand at the ends of the sweeps; the pivots lie on a circle of the major radius."""
    rows = ended.numbers("±")
    np.testing.assert_allclose(rows[0, 1:3], [-90, -40], atol=0.5)
    assert rows[-1, 1] == pytest.approx(90, abs=0.5)
    angular, measured, sigma, nearest = np.radians(rows[:, 1]), rows[:, 3:6], rows[:, 6:7], rows[:, 7:10]
    assert (abs(measured - nearest) < 4 * sigma).all()
    chords = np.linalg.norm(nearest[:, None] - nearest, axis=2)
    expected = 2 * radius_mm(FILES[machine]) * abs(np.sin((angular[:, None] - angular) / 2))
    np.testing.assert_allclose(chords, expected, atol=0.3)


def pixels(urdf: Path, X_sensor_m: np.ndarray) -> np.ndarray:
    """(N, 2) where the rays from the source through points (N, 3) in the sensor's frame meet the detector."""
    T_sensor_base = np.linalg.inv(link_pose(urdf, "sensor", {}))
    source, face = (T_sensor_base @ link_pose(urdf, link, {}) for link in ("source", "detector"))
    X = np.c_[X_sensor_m, np.ones(len(X_sensor_m))] @ np.linalg.inv(face).T
    s = (np.linalg.inv(face) @ source)[:3, 3]
    hit = s + (X[:, :3] - s) * (s[2] / (s[2] - X[:, 2]))[:, None]
    return (DETECTOR[0] - 1) / 2 + hit[:, :2] / DETECTOR[1]


def projection(ended: Ended, machine: str) -> None:
    rows = ended.numbers(" px ")
    pivot = pivot_mm(FILES[machine])[None] / 1e3
    np.testing.assert_allclose(rows[:, 1:3], np.repeat(pixels(FILES[machine], pivot), len(rows), axis=0), atol=0.5)
    np.testing.assert_allclose(rows[0, 3:], rows[0, 1:3], atol=0.01)
    assert (np.linalg.norm(rows[1:, 3:] - rows[1:, 1:3], axis=1) > 20).all()
    lines = ended.out.partition("at every pose:\n")[2].splitlines()[:3]
    P = np.array([[float(number) for number in line.split()] for line in lines])
    X = pivot + np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
    image = np.c_[X, np.ones(len(X))] @ P.T
    np.testing.assert_allclose(image[:, :2] / image[:, 2:], pixels(FILES[machine], X), atol=0.7)


def live_capture(ended: Ended, machine: str) -> None:
    captured = carm_kin.read_recording(ended.folder / "example" / "captured.csv")
    poses, frames = ended.numbers(" frames had a pose")[0]
    assert len(captured) == poses == frames == len(carm_kin.simulate(machine)[0])
    offset_in_summary(ended, machine)


CHECKS = {
    check.__name__: check
    for check in (
        calibrate_recording,
        compare_solvers,
        batch_folder,
        calibrated_urdf,
        rotation_centre,
        projection,
        live_capture,
    )
}
MACHINES = {"compare_solvers": "mobile_nonisocentric"}
"""What a script simulates, if not ``mobile_skewed``."""


def test_every_script_is_checked_and_shown():
    assert set(CHECKS) == set(SCRIPTS)
    assert re.findall(r"^python scripts/(\w+)\.py$", README, re.MULTILINE) == list(CHECKS)


@pytest.fixture(scope="module", params=list(SCRIPTS))
def alone(request, tmp_path_factory) -> tuple[str, Ended]:
    """A script without arguments, in an empty folder."""
    return request.param, run(request.param, tmp_path_factory.mktemp(request.param))


def test_a_script_without_arguments_prints_what_is_true(alone):
    script, ended = alone
    CHECKS[script](ended, MACHINES.get(script, "mobile_skewed"))


def test_the_readme_shows_what_a_script_prints(alone):
    """The words exactly, the numbers nearly: their last digits belong to the machine that computes them."""
    script, ended = alone
    shown = re.search(rf"^python scripts/{script}\.py\n```\n\n```\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
    assert shown is not None
    words = [" ".join(NUMBER.sub("#", text).split()) for text in (shown.group(1), ended.out)]
    assert words[0] == words[1]
    numbers = [np.array(NUMBER.findall(text), float) for text in (shown.group(1), ended.out)]
    np.testing.assert_allclose(*numbers, rtol=1e-4, atol=0.05)


def test_a_script_is_a_page():
    for path in SCRIPTS.values():
        assert len(path.read_text("utf-8").splitlines()) <= 60, path.name


@pytest.fixture(scope="module")
def own(tmp_path_factory) -> Path:
    """A folder with the recording of another machine, its result, and another one of too few sweeps."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "week").mkdir()
    recording, _ = carm_kin.simulate(OWN, **NOISE, seed=20)
    for name in ("monday", "wednesday"):
        carm_kin.write_recording(recording, folder / "week" / f"{name}.csv")
    carm_kin.write_recording(recording.select(recording.sweeps[0].poses), folder / "week" / "tuesday.csv")
    carm_kin.calibrate(recording).to_json(folder / "result.json")
    return folder


@pytest.mark.parametrize(
    "script, arguments",
    [
        ("calibrate_recording", ["week/monday.csv"]),
        ("compare_solvers", ["week/monday.csv"]),
        ("batch_folder", ["week"]),
        ("calibrated_urdf", ["week/monday.csv", "mobile_nonisocentric"]),
        ("rotation_centre", ["result.json", "week/monday.csv"]),
        ("projection", ["week/monday.csv", OWN]),
    ],
)
def test_a_script_takes_what_a_user_has(script, arguments, own):
    CHECKS[script](run(script, own, *arguments), OWN)


@pytest.mark.parametrize("script", list(SCRIPTS))
def test_bad_input_gives_a_sentence(script, tmp_path, monkeypatch):
    wrong = "127.0.0.1:1" if script == "live_capture" else "absent.csv"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", [script, *[wrong] * (2 if script == "rotation_centre" else 1)])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(SCRIPTS[script]), run_name="__main__")
    assert re.fullmatch(rf"error: .*{re.escape(wrong)}.*", str(ended.value.code))


@pytest.mark.parametrize("script", ["calibrate_recording", "batch_folder", "calibrated_urdf", "live_capture"])
def test_a_folder_that_cannot_be_made_gives_a_sentence(script, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr("sys.argv", [script, "--out", str(tmp_path / "file")])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(SCRIPTS[script]), run_name="__main__")
    assert re.fullmatch(r"error: .*file.*", str(ended.value.code))


def test_a_capture_on_this_computer_can_be_repeated(tmp_path):
    (tmp_path / "example").mkdir()
    (tmp_path / "example" / "captured.csv").write_text("of an earlier time")
    live_capture(run("live_capture", tmp_path), "mobile_skewed")


@pytest.mark.parametrize(
    "script, option", [("calibrate_recording", ()), ("calibrated_urdf", ("mobile_nonisocentric",))]
)
def test_a_refusal_is_told_and_is_the_status(script, option, own, tmp_path, monkeypatch, capsys):
    """Of a recording with one sweep only."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", [script, str(own / "week" / "tuesday.csv"), *option])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(SCRIPTS[script]), run_name="__main__")
    assert ended.value.code == 3
    assert "refused (one_axis_only): " in capsys.readouterr().out
    assert not (tmp_path / "example" / "calibrated.urdf").exists()
