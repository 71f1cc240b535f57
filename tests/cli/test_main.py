"""The command: exit status, streams, one-line errors."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import carm_kin
from carm_kin.cli import main as cli
from carm_kin.machine.urdf import bundled_urdfs
from carm_kin.results.result import CalibrationResult
from helpers.command import fails, run

RESULTS = ("calibrate", "compare", "check", "centre", "trend", "batch", "export")
COMMANDS = ("demo", "inspect", "simulate", "convert", *RESULTS)


@pytest.fixture(scope="module")
def rec(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("rec") / "rec.csv"
    recording, truth = carm_kin.simulate("mobile_nonisocentric", sigma_t_m=3e-4, sigma_r_rad=1e-3, seed=1)
    carm_kin.write_recording(recording, path)
    truth.to_json(path.with_suffix(".truth.json"))
    return path


@pytest.fixture(scope="module")
def orbital_only(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("rec") / "orbital.csv"
    recording, _ = carm_kin.simulate("mobile_nonisocentric", sigma_t_m=3e-4, sigma_r_rad=1e-3, seed=1)
    carm_kin.write_recording(recording.select(recording.sweep == recording.sweeps[0].label), path)
    return path


def process(*arguments: object, **more) -> subprocess.CompletedProcess:
    """The command in a process of its own."""
    command = [sys.executable, "-m", "carm_kin", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, **more)


def test_version(capsys):
    ended = run(capsys, "--version")
    assert (ended.status, ended.out, ended.err) == (0, f"carm-kin {carm_kin.__version__}\n", "")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(command, capsys):
    ended = run(capsys, command, "--help")
    assert ended.status == 0
    assert f"Example: carm-kin {command}" in ended.out


def test_help_lists_every_command(capsys):
    ended = run(capsys, "--help")
    assert ended.status == 0
    assert all(command in ended.out for command in COMMANDS)


@pytest.mark.parametrize(
    "arguments, expected",
    {
        (): "a command is missing",
        ("bogus",): "No such command 'bogus'",
        ("calibrate",): "Missing argument 'recording' (see carm-kin calibrate --help)",
        ("check", "a.json", "b.csv", "c.csv"): "c.csv",
        ("calibrate", "a.csv", "--bogus"): "No such option: --bogus",
        ("calibrate", "a.csv", "--sigma-t-mm", "abc"): "--sigma-t-mm",
        ("calibrate", "a.csv", "--json"): "--json",
        ("inspect",): "Missing argument 'urdf'",
        ("simulate", "mobile_skewed"): "Missing option '--out' / '-o'",
        ("simulate", "mobile_skewed", "-o", "a.csv", "--seed", "-1"): "--seed",
        ("simulate", "mobile_skewed", "-o", "a.csv", "--sigma-t-mm", "-1"): "--sigma-t-mm",
    }.items(),
)
def test_bad_usage_is_one_line_and_status_2(arguments, expected, capsys):
    assert expected in fails(capsys, *arguments)


@pytest.mark.parametrize(
    "arguments, expected",
    {
        ("--protocol", "bogus"): "protocol 'bogus' is unknown; it is one of paper, clinical, minimal, free",
        ("--protocol", "none.toml"): "none.toml: no such file",
        ("--sigma-t-mm", "nan"): "sigma",
        ("--sigma-t-mm", "inf"): "not inf",
        ("--sigma-r-deg", "nan"): "sigma",
        ("--sigma-r-deg", "-0.1"): "--sigma-r-deg",
        ("--sag-mm", "-1"): "--sag-mm",
        ("--sag-mm", "nan"): "--sag-mm must be a finite number from 0 on, not nan",
        ("--sag-mm", "500"): "sag_m must be from 0 to 0.1, not 0.5",
        ("--field-mm", "inf"): "--field-mm must be",
        ("--creep-mm", "-0.1"): "--creep-mm",
        ("--backlash-deg", "90"): "backlash_rad must be from 0 to 0.349",
        ("--smoothing-s", "nan"): "--smoothing-s must be",
        (
            "--smoothing-s",
            "0.1",
            "--rate-hz",
            "500",
        ): "smoothing_s is of continuous sweeps; here the sensor turns by 500",
        ("--rate-hz", "0"): "rate_hz must be from 0.1 to 10000 frames a second, not 0.0",
        ("--correlation", "1"): "correlation must be from 0 to below 1, not 1.0",
        ("--correlation", "nan"): "correlation must be from 0 to below 1, not nan",
        ("--anisotropy", "nan"): "anisotropy must be from 0.01 to 100, not nan",
        ("--label-resolution-deg", "-1"): "--label-resolution-deg",
        ("--outliers", "1"): "outliers must be a share of the poses, from 0 to below 1, not 1.0",
        ("--outliers", "-0.1"): "outliers must be",
        ("--outliers", "nan"): "outliers must be",
        ("--missing", "nan"): "missing must be",
        ("--angular", "bogus"): "'bogus'",
        ("--angular", "lift"): "the angular joint 'lift' is no revolute joint",
        ("--angular", "orbital", "--orbital", "orbital"): "must differ",
        ("--sigma-reading-deg", "-1"): "--sigma-reading-deg",
        ("--sigma-reading-mm", "nan"): "--sigma-reading-mm",
        ("--sensor-link", "bogus"): "no link is named 'bogus'",
        ("-o", "rec.xyz"): "the extension does not tell the format",
        ("-o", "none/rec.csv"): "the folder none does not exist",
        ("-o", "."): "is a folder",
        ("-o", ""): "is a folder",
    }.items(),
)
def test_bad_options_of_simulate(arguments, expected, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert expected in fails(capsys, "simulate", "mobile_skewed", "-o", "rec.csv", *arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments, expected",
    {
        (
            "--solver",
            "bogus",
        ): "solver 'bogus' is unknown; it is one of chain, closed_form, decomposed, direct",
        ("--solver", "../x"): "solver '../x' is unknown",
        ("--locus", "bogus"): "locus 'bogus' is unknown; it is one of circle, point",
        ("--locus", "point", "--solver", "kinematic"): "locus 'point' needs the solver 'direct', not 'kinematic'",
        ("--solver", "direct", "-O", "gauge=bogus"): "gauge 'bogus' is unknown; it is one of tangent, published",
        ("--sigma-t-mm", "-1"): "--sigma-t-mm must be a finite number above 0, not -1.0",
        ("--sigma-t-mm", "0"): "--sigma-t-mm must be",
        ("--sigma-r-deg", "nan"): "--sigma-r-deg must be",
        ("--sigma-r-deg", "inf"): "--sigma-r-deg must be",
        ("-O", "bogus=1"): "solver 'kinematic' has no option 'bogus'; it has fix_non_orthogonality",
        ("-O", "tolerance"): "'tolerance' is not of the form NAME=VALUE",
        ("-O", "=1"): "'=1' is not of the form NAME=VALUE",
        ("-O", "locus=point"): "'locus' is no option of a solver",
        ("-O", "limits=3"): "solver 'kinematic' has no option 'limits'",
        ("-O", "recording=3"): "solver 'kinematic' has no option 'recording'",
        ("-O", "tolerance=1", "-O", "tolerance=2"): "'tolerance' is given twice",
        ("--angular", "bogus"): "--angular: no joint 'bogus'; the recording has angular, orbital",
        ("--orbital", "bogus"): "--orbital: no joint 'bogus'",
        ("--urdf", "bogus"): "bogus: no such file; bundled machines: biplane, ceiling_angio",
        ("--json", "none/r.json"): "the folder none does not exist",
        ("--json", "."): "is a folder",
        ("--json", ""): "is a folder",
    }.items(),
)
def test_bad_options_of_calibrate(arguments, expected, rec, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert expected in fails(capsys, "calibrate", rec, *arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("value", ["abc", "-1", "1.5", "true", "null", "[1]", "NaN", "1e400", "[" * 5000, "9" * 5000])
def test_option_values_of_a_wrong_type(value, rec, capsys):
    message = fails(capsys, "calibrate", rec, "-O", f"max_iterations={value}")
    assert message.startswith("option 'max_iterations' of solver 'kinematic' must be ")


def test_a_urdf_of_another_machine_is_named(rec, tmp_path, capsys):
    other = tmp_path / "other.urdf"
    text = bundled_urdfs()["mobile_skewed"].read_text()
    other.write_text(text.replace('name="angular"', 'name="tilt"').replace('name="orbital"', 'name="slide"'))
    message = fails(capsys, "calibrate", rec, "--urdf", other)
    assert "names the joint 'angular', which the chain does not have" in message
    message = fails(capsys, "calibrate", rec, "--urdf", other, "--solver", "kinematic")
    assert message.startswith("--urdf: its axes are 'tilt' and 'slide'; the recording has angular, orbital")


def test_joint_names_come_from_the_urdf(tmp_path, capsys):
    other = tmp_path / "other.urdf"
    text = bundled_urdfs()["mobile_skewed"].read_text()
    other.write_text(text.replace('name="angular"', 'name="tilt"').replace('name="orbital"', 'name="slide"'))
    rec = tmp_path / "rec.csv"
    assert run(capsys, "simulate", other, "-o", rec).status == 0
    assert "'slide'" in fails(capsys, "calibrate", rec)
    ended = run(capsys, "calibrate", rec, "--urdf", other, "--json", "-")
    assert ended.status == 0
    assert json.loads(ended.out)["placements"][0]["referenced"] is True
    assert run(capsys, "calibrate", rec, "--angular", "tilt", "--orbital", "slide").status == 0


def test_json_on_stdout_is_alone_there(rec, tmp_path, capsys):
    ended = run(capsys, "calibrate", rec, "--json", "-")
    assert ended.status == 0
    data = json.loads(ended.out)
    assert data["status"] == "ok"
    assert data["major_radius_mm"] == pytest.approx(100, abs=0.3)
    assert "major radius" in ended.err
    ended = run(capsys, "calibrate", rec, "--json", tmp_path / "r.json")
    assert "major radius" in ended.out
    assert ended.err == f"written: {tmp_path / 'r.json'}\n"
    result = CalibrationResult.from_json(tmp_path / "r.json")
    assert result.offset_sensor_pivot_m is not None
    assert result.offset_sensor_pivot_m * 1e3 == pytest.approx(data["offset_sensor_pivot_mm"])


def test_inspect_as_json_is_alone_on_stdout(capsys):
    ended = run(capsys, "inspect", "mobile_skewed", "--json")
    assert (ended.status, ended.err) == (0, "")
    data = json.loads(ended.out)
    assert data["major_radius_mm"] == pytest.approx(60, abs=1e-9)
    assert data["axis_non_orthogonality_deg"] == pytest.approx(0.7, abs=1e-9)
    assert data["isocentric"] is False
    assert [joint["name"] for joint in data["joints"]][-2:] == ["angular", "orbital"]
    ended = run(capsys, "inspect", "mobile_skewed")
    assert (ended.status, ended.err) == (0, "")
    assert "60.000 mm (not isocentric)" in ended.out
    assert "(isocentric)" in run(capsys, "inspect", "mobile_isocentric").out


def test_inspect_says_what_was_accepted_with_a_remark(tmp_path, capsys):
    text = bundled_urdfs()["mobile_skewed"].read_text()
    file = tmp_path / "m.urdf"
    file.write_text(text.replace('<axis xyz="1 0 0"/>', '<axis xyz="1.0005 0 0"/>', 1))
    assert "normalised" in run(capsys, "inspect", file).err
    assert "normalised" in json.loads(run(capsys, "inspect", file, "--json").out)["notes"][0]


def test_a_refusal_is_status_3_and_a_result(orbital_only, capsys):
    ended = run(capsys, "calibrate", orbital_only, "--json", "-")
    assert ended.status == 3
    data = json.loads(ended.out)
    assert data["status"] == "refused"
    assert data["refusal"]["code"] == "one_axis_only"
    last = ended.err.splitlines()[-1]
    assert last.startswith("refused (one_axis_only): no angular motion")
    assert "offset sensor" not in ended.err
    ended = run(capsys, "calibrate", orbital_only)
    assert ended.out.splitlines()[0].startswith("refused: solver kinematic, ")
    assert "offset sensor" not in ended.out
    assert ended.err.splitlines()[-1] == last


def test_no_path_and_no_user_in_a_result(rec, tmp_path, monkeypatch, capsys):
    out = tmp_path / "secret-folder" / "r.json"
    out.parent.mkdir()
    assert run(capsys, "calibrate", rec, f"--json={out}").status == 0
    text = out.read_text()
    assert str(rec.parent) not in text
    assert "secret-folder" not in text
    assert json.loads(text)["provenance"]["command"] == "carm-kin calibrate rec.csv --json=r.json"
    assert json.loads(text)["provenance"]["input_name"] == "rec.csv"


def test_text_of_a_recording_is_no_markup_and_no_escape_code(tmp_path, capsys):
    """Labels reach the terminal as they are."""
    recording, _ = carm_kin.simulate("mobile_skewed", sigma_t_m=3e-4, sigma_r_rad=1e-3)
    labels = ["[/]" if i % 2 else "[red]\x1b[2J" for i in range(len(recording))]
    odd = carm_kin.Recording(recording.p_world_sensor, recording.R_world_sensor, placement=labels)
    carm_kin.write_recording(odd, tmp_path / "rec.csv")
    ended = run(capsys, "calibrate", tmp_path / "rec.csv")
    assert ended.status == 0
    assert "placement [/]" in ended.out
    assert "\x1b" not in ended.out + ended.err


def test_simulate_then_calibrate(tmp_path, capsys):
    rec = tmp_path / "a.b.csv"
    ended = run(capsys, "simulate", "mobile_isocentric", "-o", rec, "--protocol", "minimal", "--sigma-t-mm", "0.2")
    assert (ended.status, ended.out) == (0, "")
    assert "warning (joint_limits_ignored)" in ended.err
    assert f"written: {rec} (1440 poses)" in ended.err
    assert f"written: {tmp_path / 'a.b.truth.json'} (the truth)" in ended.err
    truth = CalibrationResult.from_json(tmp_path / "a.b.truth.json")
    assert truth.major_radius_m == pytest.approx(0, abs=1e-12)
    assert run(capsys, "calibrate", rec, "--sigma-t-mm", "0.2", "--sigma-r-deg", "0.01").status == 0


def test_demo_writes_its_files_and_says_where(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("carm_kin.cli.demo.solvers.solver_names", lambda: ("closed_form", "kinematic"))
    folder = tmp_path / "a" / "demo"
    ended = run(capsys, "demo", "-o", folder)
    assert ended.status == 0
    assert "Errors against the truth (mm, deg)" in ended.out
    assert ended.out.count("offset sensor to rotation centre, x") == 2
    assert {f.name for f in folder.iterdir()} == {
        "recording.csv", "recording.truth.json", "closed_form.json", "kinematic.json",
    }  # fmt: skip
    for file in folder.iterdir():
        assert ended.err.count(f"written: {file}") == 1
    assert f"carm-kin calibrate {folder}/recording.csv" in ended.err
    result, truth = (CalibrationResult.from_json(folder / f) for f in ("kinematic.json", "recording.truth.json"))
    assert result.offset_sensor_pivot_m == pytest.approx(truth.offset_sensor_pivot_m, abs=3e-4)
    (tmp_path / "file").write_text("")
    assert "cannot be made" in fails(capsys, "demo", "-o", tmp_path / "file")


@pytest.mark.parametrize("arguments", [("demo",), ("inspect", "mobile_skewed"), ("calibrate",)])
def test_lines_fit_into_80_columns(arguments, rec, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("carm_kin.cli.demo.solvers.solver_names", lambda: ("closed_form", "kinematic"))
    ended = run(capsys, *arguments, *([rec] if arguments == ("calibrate",) else []))
    assert ended.out
    assert max(map(len, ended.out.splitlines())) <= 80


def test_an_interrupt_is_status_130_without_a_traceback(monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("carm_kin.machine.inspection.inspect", interrupted)
    ended = run(capsys, "inspect", "mobile_skewed")
    assert ended.status == 130
    assert "Traceback" not in ended.err


def test_a_defect_is_no_bad_input(monkeypatch):
    def defect(*_):
        raise ZeroDivisionError

    monkeypatch.setattr("carm_kin.machine.inspection.inspect", defect)
    monkeypatch.setattr("sys.argv", ["carm-kin", "inspect", "mobile_skewed"])
    with pytest.raises(ZeroDivisionError):
        cli.main()


def test_in_a_process_errors_are_one_line(tmp_path):
    file = tmp_path / "rec.csv"
    file.write_text("x_mm,y_mm,z_mm\n1,2\n")
    ended = process("calibrate", file)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.splitlines() == [f"error: {file}, line 2, column z_mm: the row has 2 cells, the header has 3"]


def test_in_a_process_a_refusal_is_status_3(orbital_only):
    ended = process("calibrate", orbital_only)
    assert ended.returncode == 3
    assert "Traceback" not in ended.stderr


def test_in_a_process_with_an_ascii_terminal():
    ended = process("inspect", "mobile_skewed", env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert ended.returncode == 0, ended.stderr


@pytest.mark.skipif(os.name != "posix", reason="pipes and signals as POSIX has them")
@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_whoever_reads_may_stop(stream, rec):
    """As in ``carm-kin ... | head -0``."""
    reading, writing = os.pipe()
    os.close(reading)
    arguments = ("calibrate", rec, "--json", "-") if stream == "stdout" else ("inspect", "mobile_skewed")
    other = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | {stream: writing}
    command = [sys.executable, "-m", "carm_kin", *map(str, arguments)]
    ended = subprocess.run(command, text=True, timeout=60, check=False, **other)
    os.close(writing)
    assert ended.returncode == 0
    assert "Error" not in (ended.stderr or "")


@pytest.mark.skipif(os.name != "posix", reason="pipes and signals as POSIX has them")
def test_ctrl_c_ends_a_long_run_at_once(tmp_path):
    protocol = tmp_path / "long.toml"
    protocol.write_text('[[sweep]]\nmoving = "orbital"\nfrom_deg = 0\nto_deg = 359\nstep_deg = 0.0004\n')
    command = [sys.executable, "-m", "carm_kin", "simulate", "mobile_skewed", "-o", str(tmp_path / "rec.csv")]
    running = subprocess.Popen([*command, "--protocol", str(protocol), "-v"], stderr=subprocess.PIPE, text=True)
    assert running.stderr is not None
    assert running.stderr.readline().startswith("read")  # the machine: past the imports, well before the end
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=20)
    assert running.returncode == 130
    assert "Traceback" not in err
    assert [f.name for f in tmp_path.iterdir()] == ["long.toml"]
