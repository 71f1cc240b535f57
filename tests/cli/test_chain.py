"""`carm-kin calibrate --urdf`: what is written, what is printed, how it ends."""

import json
from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.results.result import CalibrationResult
from helpers.chained import (
    ARM_JOINTS,
    C_ARM,
    C_JOINTS,
    LIFTS,
    arm,
    arm_recording,
    c_arm_recording,
    kinematics,
    written,
)
from helpers.command import fails, run


@pytest.fixture
def files(tmp_path):
    """A recording of the C-arm and its nominal URDF."""
    carm_kin.write_recording(c_arm_recording(1, C_JOINTS, ("lift",), LIFTS)[2], tmp_path / "rec.csv")
    written(tmp_path / "c.urdf", C_ARM)
    return tmp_path


@pytest.fixture
def arm_files(tmp_path):
    carm_kin.write_recording(arm_recording(1)[2], tmp_path / "rec.csv")
    written(tmp_path / "arm.urdf", arm())
    return tmp_path


def calibrate(capsys, folder, *more, rec="rec.csv", urdf="c.urdf"):
    return run(capsys, "calibrate", folder / rec, "--urdf", folder / urdf, *more)


def test_result_and_urdf_are_written(files, capsys):
    ended = calibrate(capsys, files, "--urdf-out", files / "out.urdf", "--json", files / "r.json")
    assert ended.status == 0, ended.err
    assert ended.out.startswith("ok: solver chain, ")
    assert {f"written: {files / name}" for name in ("out.urdf", "r.json")} <= set(ended.err.splitlines())
    result = CalibrationResult.from_json(files / "r.json")
    assert result.solver == "chain"
    assert result.options["free"] == "all"
    assert result.provenance.command.startswith("carm-kin calibrate rec.csv --urdf c.urdf --urdf-out out.urdf")
    recording = carm_kin.read_recording(files / "rec.csv")
    q = {name: np.nan_to_num(values) for name, values in recording.joints.items()}
    known = np.isfinite(list(recording.joints.values())).all(axis=0)
    poses = result.chain.bases[0].T_world_base @ kinematics((files / "out.urdf").read_text(), "sensor", q)
    off = (poses[:, :3, 3] - recording.p_world_sensor)[known]
    assert np.sqrt((off**2).sum(axis=1).mean()) == pytest.approx(np.sqrt(3) * 0.25e-3, rel=0.3)


def test_what_is_printed(files, capsys):
    out = calibrate(capsys, files).out
    result = json.loads(calibrate(capsys, files, "--json", "-").out)
    joint = result["chain"]["joints"][0]
    part = joint["estimated"][0]
    assert f"change of {joint['joint']}, {part}" in out
    nominal = result["chain"]["nominal"]["translation_rms_mm"]
    assert f"residuals of the nominal URDF     {nominal:.3f} mm" in out
    told = [line for line in out.splitlines() if not line.startswith("  not told: ")]
    assert max(map(len, told)) <= 80
    assert [f"  not told: {words}" for words in result["chain"]["not_identifiable"]] == [
        line for line in out.splitlines() if line.startswith("  not told: ")
    ]


def test_a_refused_calibration_is_not_written(files, capsys):
    """Nor is a file that stands there already touched."""
    wrong = written(files / "wrong.urdf", C_ARM.replace('xyz="0.8 0.02 0.1"', 'xyz="0.8 0.02 0.16"'))
    out = written(files / "out.urdf", "as it was")
    ended = calibrate(capsys, files, "--free", "none", "--urdf-out", out, "--json", "-", urdf=wrong.name)
    assert ended.status == 3
    assert ended.err.splitlines()[-1].startswith("refused (misfit): ")
    assert json.loads(ended.out)["chain"] is None
    assert out.read_text() == "as it was"


def test_options_reach_the_solver(arm_files, capsys):
    names = ["--sensor-link", "tool", "--angular", "j1", "--orbital", "j2"]
    more = ["--free", "j3, j4,j5", "--zeros", "j1", "--gains", "axes", "--sigma-reading-deg", "0"]
    more += ["--prior-mm", "1", "--prior-deg", "0.2", "--json", "-"]
    ended = calibrate(capsys, arm_files, *names, *more, urdf="arm.urdf")
    options = json.loads(ended.out)["options"]
    assert options["free"] == "j3,j4,j5"
    assert options["zeros"] == "j1"
    assert options["gains"] == "axes"
    assert options["prior_t"] == pytest.approx(1e-3)
    assert options["prior_r"] == pytest.approx(np.radians(0.2))
    assert ended.status in (0, 3)


def test_gains_are_printed_and_left_out_of_the_urdf(arm_files, capsys):
    names = ["--sensor-link", "tool", "--angular", "j1", "--orbital", "j2", "--gains", "j4", "--sigma-reading-deg", "0"]
    ended = calibrate(capsys, arm_files, *names, "--urdf-out", arm_files / "out.urdf", urdf="arm.urdf")
    assert ended.status == 0
    assert "change of j4, gain" in ended.out
    assert "warning (gains_not_in_urdf): " in ended.err


def test_several_recordings(tmp_path, capsys):
    for k in (1, 2):
        recording = arm_recording(1, n=50)[2] if k == 1 else replace(arm_recording(1)[2]).select(slice(50, 100))
        carm_kin.write_recording(recording, tmp_path / f"{k}.csv")
    written(tmp_path / "arm.urdf", arm())
    names = ["--sensor-link", "tool", "--angular", "j1", "--orbital", "j2", "--sigma-reading-deg", "0"]
    ended = run(
        capsys,
        "calibrate",
        tmp_path / "1.csv",
        tmp_path / "2.csv",
        "--urdf",
        tmp_path / "arm.urdf",
        *names,
        "--json",
        "-",
    )
    assert ended.status == 0, ended.err
    result = json.loads(ended.out)
    assert [base["label"] for base in result["chain"]["bases"]] == ["1", "2"]
    assert result["poses"] == 100
    assert result["provenance"]["input_name"] == "1.csv, 2.csv"
    assert len(result["provenance"]["input_sha256"].split(", ")) == 2


def test_held_out_errors_are_printed(files, capsys):
    out = calibrate(capsys, files, "--cross-validate", "4").out
    assert "held out, overall" in out
    assert "held out, fold 4" in out


@pytest.mark.parametrize(
    "more, words",
    [
        (["--free", "elbow"], "no joint of the chain is named 'elbow'; valid: all, axes, none, lift, angular, orbital"),
        (["--zeros", "axes,knee"], "no joint of the chain is named 'knee'"),
        (["--gains", ""], "no joint of the chain is named ''"),
        (["--prior-mm", "0"], "--prior-mm must be a finite number above 0, not 0"),
        (["--prior-deg", "nan"], "--prior-deg must be a finite number above 0, not nan"),
        (["--sigma-reading-deg", "-1"], "--sigma-reading-deg must be a finite number from 0 on, not -1"),
        (["--sigma-t-mm", "0"], "--sigma-t-mm must be a finite number above 0"),
        (["--urdf-out", "/nowhere/out.urdf"], "the folder /nowhere does not exist"),
        (["--sensor-link", "elbow"], "no link is named 'elbow'; valid: base, column, swivel, c, sensor"),
        (["--angular", "lift"], "the angular joint 'lift' is no revolute joint"),
        (["--locus", "point", "--free", "axes"], "--free: needs the calibration of a chain"),
        (["--solver", "kinematic", "--urdf-out", "x.urdf"], "--urdf-out: needs the calibration of a chain"),
        (["--cross-validate", "1"], "--cross-validate needs at least 2 parts, not 1"),
        (["-O", "speed=3"], "solver 'chain' has no option 'speed'; it has prior_t"),
        (["-O", "prior_t=fast"], "option 'prior_t' of solver 'chain' must be"),
        (["-O", "prior_t=0"], "option 'prior_t' of solver 'chain' must be at least 1e-07, not 0"),
        (["-O", "free=axes"], "--option 'free' is no option of a solver, but one of the command: --free"),
        (["-O", "folds=3"], "solver 'chain' has no option 'folds'"),
        (["-O", "prior_t=0.1", "--prior-mm", "1"], "--prior-mm and --option 'prior_t' say the same"),
    ],
)
def test_bad_options_end_in_one_line(files, capsys, more, words):
    assert words in fails(capsys, "calibrate", files / "rec.csv", "--urdf", files / "c.urdf", *more)


def test_the_chain_needs_a_urdf(files, capsys):
    assert "needs a urdf (--urdf" in fails(capsys, "calibrate", files / "rec.csv", "--solver", "chain")
    assert "several recordings: needs" in fails(capsys, "calibrate", files / "rec.csv", files / "rec.csv")


def test_one_axis_is_refused(files, capsys):
    recording = carm_kin.read_recording(files / "rec.csv")
    carm_kin.write_recording(recording.select(recording.sweep == "s0"), files / "one.csv")
    ended = calibrate(capsys, files, "--urdf-out", files / "out.urdf", rec="one.csv")
    assert ended.status == 3
    assert ended.err.splitlines()[-1].startswith("refused (")
    assert not (files / "out.urdf").exists()


def test_positions_alone_are_bad_input(files, capsys):
    recording = carm_kin.read_recording(files / "rec.csv")
    carm_kin.write_recording(replace(recording, R_world_sensor=None), files / "p.csv")
    message = fails(capsys, "calibrate", files / "p.csv", "--urdf", files / "c.urdf")
    assert "p.csv: has no orientations (qw, qx, qy, qz)" in message


def test_a_joint_of_another_machine_is_named(arm_files, capsys):
    written(arm_files / "c.urdf", C_ARM)
    message = fails(capsys, "calibrate", arm_files / "rec.csv", "--urdf", arm_files / "c.urdf")
    assert f"names the joint '{ARM_JOINTS[0]}', which the chain does not have; it has lift, angular, orbital" in message
