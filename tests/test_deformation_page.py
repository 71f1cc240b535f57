"""docs/deformation.md: its commands and its Python run in an empty folder, and what it says of their output is so."""

import csv
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import carm_kin
from carm_kin.errors import InputError
from helpers.command import run
from helpers.places import ROOT

PAGE = (ROOT / "docs" / "deformation.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
COMMANDS = [line for kind, block in BLOCKS if kind == "sh" for line in block.splitlines()]
PYTHON = "\n".join(block for kind, block in BLOCKS if kind == "python")
SHOWN = [line for kind, block in BLOCKS if not kind for line in block.splitlines()]
LIKE = re.compile(r"\d+(\.\d+)?|noise .*, (gravity|deformation) .*")
"""What may differ from machine to machine."""


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def within_95(result: carm_kin.CalibrationResult, truth: carm_kin.CalibrationResult) -> bool:
    """Whether the true offset is where the result says that it is."""
    assert result.offset_sensor_pivot_m is not None
    assert result.offset_within_95_m is not None
    assert truth.offset_sensor_pivot_m is not None
    return bool(np.linalg.norm(result.offset_sensor_pivot_m - truth.offset_sensor_pivot_m) < result.offset_within_95_m)


def test_commands_and_python_of_the_page_run(folder, capsys):
    said = []
    for command in COMMANDS:
        name, *arguments = shlex.split(command)
        assert name == "carm-kin"
        ended = run(capsys, *arguments)
        assert ended.status == 0, (command, ended.err)
        said.append(ended.out)
    lines = LIKE.sub("0", "".join(said)).splitlines()
    assert len(SHOWN) > 5
    assert [line for line in SHOWN if LIKE.sub("0", line) not in lines] == []

    exec(compile(PYTHON, "docs/deformation.md", "exec"), {})
    assert "gravity" in capsys.readouterr().out

    result, truth = carm_kin.read_result("result.json"), carm_kin.read_result("rec.truth.json")
    assert {"gravity", "deformation"} & {effect.name for effect in result.effects}
    assert within_95(result, truth)
    plan = carm_kin.read_result("plan.json"), carm_kin.read_result("plan.truth.json")
    assert within_95(*plan)
    assert {"field", "marker"} & {effect.name for effect in plan[0].effects}

    found, true = (carm_kin.isocentre(one).balls[-1] for one in (result, truth))
    assert abs(found.diameter_m - true.diameter_m) < 2 * found.sigma_m
    assert 0.2e-3 < true.diameter_m < 2e-3
    assert json.loads(Path("carm.json").read_text())["deformation"]["grid"]


def test_without_effects_there_is_no_deformation(folder):
    poses, _ = carm_kin.simulate("mobile_skewed", sag_m=2e-3, sigma_t_m=2e-4, sigma_r_rad=1e-3, seed=1)
    rigid = carm_kin.calibrate(poses, systematic="none")
    assert rigid.deformation is None
    with pytest.raises(InputError, match="tells no deformation"):
        carm_kin.isocentre(rigid)


def rows(**condition: object) -> list[dict[str, str]]:
    """Of the study behind the pictures."""
    with (ROOT / "docs" / "deformation.csv").open(encoding="utf-8", newline="") as file:
        return [row for row in csv.DictReader(file) if all(row[k] == str(v) for k, v in condition.items())]


def rms(found: list[dict[str, str]]) -> str:
    return f"{np.sqrt(np.mean([float(row['error_mm']) ** 2 for row in found])):.3f}"


def within(found: list[dict[str, str]]) -> int:
    return sum(float(row["error_mm"]) <= float(row["within_95_mm"]) for row in found)


def test_the_page_says_what_the_study_found():
    full = {"swivel_deg": 180, "placements": 1}
    distorted = {name: rows(field_mm=0.2, systematic=name, **full) for name in ("none", "auto")}
    assert f"{within(distorted['none'])} of {len(distorted['none'])} errors" in PAGE
    assert within(distorted["auto"]) == len(distorted["auto"]) == 24
    two = {name: rms([row for row in found if row["sag_mm"] == "2.0"]) for name, found in distorted.items()}
    assert f"({two['auto']} against {two['none']} mm" in PAGE

    four = [rms(rows(sag_mm=4.0, field_mm=0.0, systematic=name, **full)) for name in ("none", "auto")]
    assert "({:.2f} mm root mean square at 4 mm of sag, {:.2f} mm with effects)".format(*map(float, four)) in PAGE

    arcs = [rows(sag_mm=2.0, field_mm=0.2, systematic="auto", swivel_deg=x, placements=1) for x in (60, 120, 180)]
    assert f"falls from {float(rms(arcs[0])):.2f} to {float(rms(arcs[2])):.2f} mm" in PAGE
    held = " ".join(PAGE.split())
    assert "held {} of 6 errors, on the middle ones {}, on the long ones {}".format(*map(within, arcs)) in held

    moved = [float(rms(rows(sag_mm=0.0, field_mm=0.3, placements=n))) for n in (1, 2, 3)]
    assert "{:.2f}, {:.2f}, {:.2f} mm".format(*moved) in PAGE


@pytest.mark.parametrize("name", re.findall(r"\((\w+\.svg)\)", PAGE))
def test_pictures_stand_beside_the_page(name):
    assert "<svg" in (ROOT / "docs" / name).read_text(encoding="utf-8")
