"""What `carm_kin` itself offers: its names, paths for objects, what is printed and shown, what is said of mistakes."""

import ast
import copy
import pickle
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.calibration.chain.calibrate import free_of
from carm_kin.calibration.chain.model import chain_model
from helpers.command import run
from helpers.places import ROOT
from solvers.estimate import Note

PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
MACHINE = "mobile_skewed"
HOSTILE = '<script>alert("x")</script> & \x1b[31m'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """rec.csv, another.csv of other poses, result.json, refused.json."""
    folder = tmp_path_factory.mktemp("surface")
    for name, seed in (("rec.csv", 1), ("another.csv", 2)):
        recording, _ = carm_kin.simulate(MACHINE, "minimal", sigma_t_m=3e-4, sigma_r_rad=1e-3, seed=seed)
        carm_kin.write_recording(recording.select(slice(None, None, 4)), folder / name)
    recording = carm_kin.read_recording(folder / "rec.csv")
    carm_kin.calibrate(recording).to_json(folder / "result.json")
    carm_kin.calibrate(recording.select(slice(0, 3))).to_json(folder / "refused.json")
    return folder


@pytest.fixture(scope="module")
def recording(folder):
    return carm_kin.read_recording(folder / "rec.csv")


@pytest.fixture(scope="module")
def result(folder):
    return carm_kin.read_result(folder / "result.json")


# names


def imported_for_type_checkers() -> set[str]:
    tree = ast.parse((ROOT / "carm_kin" / "__init__.py").read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    return {f"{node.module}.{alias.name}" for node in block.body for alias in node.names}


def test_the_table_is_what_editors_are_told():
    assert {f"{module}.{name}" for name, module in carm_kin._HOME.items()} == imported_for_type_checkers()
    assert sorted(carm_kin.__all__) == sorted(carm_kin._HOME)
    assert {*carm_kin.__all__} <= {*dir(carm_kin)}


@pytest.mark.parametrize("name", carm_kin.__all__)
def test_every_name_is_there_and_documented(name):
    assert getattr(carm_kin, name).__doc__
    assert re.search(rf"\b{name}\b", PAGE)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'callibrate'"):
        carm_kin.callibrate  # noqa: B018
    assert not hasattr(carm_kin, "callibrate")


def test_the_import_is_cheap():
    code = "import sys, carm_kin; print(*sorted({name.split('.')[0] for name in sys.modules}))"
    ended = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    heavy = {"casadi", "scipy", "pinocchio", "rich", "typer", "plotly", "lxml", "jinja2", "matplotlib"}
    assert not heavy & {*ended.stdout.split()}


def test_the_examples_of_the_page_run(folder, tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib", reason="pip install 'carm-kin[figures]'")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rec.csv").write_bytes((folder / "rec.csv").read_bytes())
    script = "\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL))
    exec(compile(script.replace('if __name__ == "__main__"', "if True"), "docs/python.md", "exec"), {})
    assert "rec ok" in capsys.readouterr().out
    made = {path.name for path in tmp_path.iterdir()}
    assert {"report.html", "summary.html", "carm.yaml", "calibrated.urdf", "recording.png", "result.png"} <= made


# paths and objects


def numbers(found) -> dict:
    """Everything but times, dates and seeds of a result."""
    data = found.to_dict()
    data.pop("provenance")
    for one in data.get("runs", ()):
        one["time_s"] = None
        if one["result"]:
            one["result"].pop("provenance")
    return data


def test_paths_give_what_objects_give(folder, recording, result):
    rec, saved = str(folder / "rec.csv"), folder / "result.json"
    urdf = carm_kin.read_urdf(MACHINE)
    pairs = [
        (carm_kin.calibrate(rec), carm_kin.calibrate(recording)),
        (carm_kin.calibrate_chain([rec], MACHINE), carm_kin.calibrate_chain(recording, urdf)),
        (carm_kin.check(saved, rec), carm_kin.check(result, recording)),
        (carm_kin.virtual_centre(saved, rec), carm_kin.virtual_centre(result, recording)),
        (
            carm_kin.compare(rec, "kinematic, surface", truth=saved, folds=None),
            carm_kin.compare(recording, ["kinematic", "surface"], truth=result, folds=None),
        ),
    ]
    for by_path, by_object in pairs:
        assert numbers(by_path) == numbers(by_object)
    assert carm_kin.cross_validate(rec, 3) == carm_kin.cross_validate(recording, 3)
    T = recording.T_world_sensor[:5]
    one, other = (carm_kin.RotationCentre(given).locate(T).pivot_world_m for given in (saved, result))
    np.testing.assert_array_equal(one, other)
    xray = carm_kin.Xray.of_urdf(urdf, carm_kin.Detector(3e-4, 100, 100))
    np.testing.assert_array_equal(xray.P_image_sensor(saved), xray.P_image_sensor(result))
    first, second = (carm_kin.simulate(given, "minimal", seed=3)[0].p_world_sensor for given in (MACHINE, urdf))
    np.testing.assert_array_equal(first, second)


def test_files_by_path_are_those_by_object(folder, recording, result, tmp_path):
    rec, saved = folder / "rec.csv", folder / "result.json"
    for k, (calibration, poses) in enumerate([(saved, rec), (result, recording)]):
        carm_kin.write_report(calibration, poses, tmp_path / f"report{k}", compared={"a": calibration})
        carm_kin.write_summary({"a": calibration}, tmp_path / f"summary{k}")
        carm_kin.write_recording(poses, tmp_path / f"rec{k}", "csv")
        assert carm_kin.export(calibration, "itk", tmp_path / f"itk{k}").status == "ok"
    for name in ("report", "summary", "rec", "itk"):
        assert (tmp_path / f"{name}0").read_bytes() == (tmp_path / f"{name}1").read_bytes()


def test_a_batch_is_that_of_the_command(folder, tmp_path, capsys):
    lines = carm_kin.batch(folder / "rec.csv", tmp_path / "here", solver="closed_form")
    ended = run(capsys, "batch", folder / "rec.csv", "-o", tmp_path / "there", "--solver", "closed_form", "--jobs", 1)
    assert [(line.label, line.status) for line in lines] == [("rec", "ok")]
    assert ended.status == 0
    one, other = ((tmp_path / place / "summary.csv").read_text() for place in ("here", "there"))
    assert one == other
    with pytest.raises(carm_kin.InputError, match="go on with it by resume=True"):
        carm_kin.batch(folder / "rec.csv", tmp_path / "here", solver="closed_form")
    assert carm_kin.batch([folder / "rec.csv"], tmp_path / "here", solver="closed_form", resume=True) == lines


@pytest.mark.parametrize("free, expected", [("axes", 2), ("angular, orbital", 2), (("lift",), 1), ("none", 0)])
def test_what_is_free_may_be_a_text(free, expected):
    model = chain_model(carm_kin.read_urdf(MACHINE), [None])
    assert free_of(model, carm_kin.FreeJoints(free)).placements.sum() == expected


def test_poses_become_a_recording(recording):
    T = recording.T_world_sensor
    own = carm_kin.Recording.from_poses(T, sweep=recording.sweep, moving=recording.moving, joints=recording.joints)
    assert numbers(carm_kin.calibrate(own)) == numbers(carm_kin.calibrate(recording))
    assert len(carm_kin.Recording.from_poses(T[0].tolist())) == 1
    with pytest.raises(carm_kin.InputError, match="not a rotation"):
        carm_kin.Recording.from_poses(2 * T)


def test_a_machine_is_its_chain():
    machine = carm_kin.Machine(MACHINE)
    q = np.random.default_rng(0).uniform(-0.3, 0.3, (4, len(machine.joints)))
    T = machine.forward_kinematics(q)
    assert T.shape == (4, 4, 4)
    step = 1e-6
    for j in range(len(machine.joints)):
        moved = machine.forward_kinematics(q + step * np.eye(len(machine.joints))[j])
        v = np.einsum("nji,nj->ni", T[:, :3, :3], (moved - T)[:, :3, 3]) / step
        np.testing.assert_allclose(machine.jacobian(q)[:, :3, j], v, atol=1e-5)
    assert machine.axes == ("angular", "orbital")
    assert machine.limits.shape == (len(machine.joints), 2)
    assert machine.nominal.major_radius == pytest.approx(0.06, abs=1e-3)
    with pytest.raises(carm_kin.InputError, match="no array of numbers"):
        machine.forward_kinematics("home")


# what is printed


def printed(capsys, *arguments) -> str:
    return "\n".join(line.rstrip() for line in (lambda e: e.out + e.err)(run(capsys, *arguments)).splitlines())


@pytest.mark.parametrize(
    "arguments",
    [(), ("--solver", "surface"), ("--cross-validate", "3"), ("--urdf", "mobile_nonisocentric", "--free", "none")],
    ids=["kinematic", "surface", "held out", "refused"],
)
def test_print_gives_what_calibrate_prints(folder, tmp_path, capsys, arguments):
    shown = printed(capsys, "calibrate", folder / "rec.csv", "--json", tmp_path / "out.json", *arguments)
    text = str(carm_kin.read_result(tmp_path / "out.json"))
    assert {line.rstrip() for line in text.splitlines()} <= {*shown.splitlines()}
    assert text.splitlines()[0] == shown.splitlines()[0]


@pytest.mark.parametrize("name", ["rec.csv", "another.csv"])
def test_print_gives_what_check_and_centre_print(folder, capsys, name):
    for command, found in (
        ("check", carm_kin.check(folder / "result.json", folder / name)),
        ("centre", carm_kin.virtual_centre(folder / "result.json", folder / name)),
    ):
        shown = printed(capsys, command, folder / "result.json", folder / name)
        assert [line.rstrip() for line in str(found).splitlines()] == shown.splitlines()


def test_print_gives_the_tables_that_compare_prints(folder, capsys):
    arguments = "--solvers", "surface,closed_form", "--folds", 0, "--all-poses"
    shown = printed(capsys, "compare", folder / "rec.csv", *arguments).splitlines()
    found = str(carm_kin.compare(folder / "rec.csv", ["surface", "closed_form"], folds=None)).splitlines()
    residuals = next(k for k, line in enumerate(found) if line.startswith("Residuals"))  # its table holds times
    first, last = found[:residuals], found[residuals + 6 :]
    assert len(first) > 10
    assert any("closed_form" in line for line in last)
    assert [line for line in first + last if line not in shown] == []


def test_a_repr_is_one_short_line(folder, recording, result):
    refused = carm_kin.read_result(folder / "refused.json")
    every = [recording, result, refused, carm_kin.Machine(MACHINE), carm_kin.check(result, recording)]
    every += [carm_kin.virtual_centre(result, recording), carm_kin.compare(recording, "surface", folds=None)]
    for one in every:
        assert "\n" not in repr(one)
        assert len(repr(one)) < 200 + len(str(folder))
    assert "ok" in repr(result)
    assert "±" in repr(result)
    assert "refused (too_few_poses)" in repr(refused)


def test_a_notebook_shows_a_table_with_everything_escaped(folder, result):
    placement = replace(result.placements[0], label=HOSTILE)
    bad = replace(
        result, warnings=(Note("a_code", HOSTILE),), solver=HOSTILE, placements=(placement, placement),
        sigma=replace(result.sigma, placements=()),
    )  # fmt: skip
    for html in (bad._repr_html_(), replace(bad, refusal=Note("x", HOSTILE), status="refused")._repr_html_()):
        assert "<script" not in html
        assert "\x1b" not in html
        assert "&lt;script&gt;alert(&quot;x&quot;)&lt;/script&gt; &amp; \\x1b[31m" in html
    assert f"{result.offset_sensor_pivot_m[0] * 1e3:.3f}" in result._repr_html_()
    assert f"± {result.sigma.offset_sensor_pivot_m[0] * 1e3:.3f}" in result._repr_html_()
    refused = carm_kin.read_result(folder / "refused.json")._repr_html_()
    assert "refused (too_few_poses)" in refused
    assert "offset" not in refused


def test_a_terminal_is_sent_no_control_characters(result):
    bad = replace(result, warnings=(Note("a_code", HOSTILE),))
    assert "\x1b" not in str(bad)


def test_figures(folder, recording, result):
    pytest.importorskip("matplotlib", reason="pip install 'carm-kin[figures]'")
    for of in (recording, replace(recording, R_world_sensor=None), result, carm_kin.calibrate(recording)):
        assert of.figure()._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(carm_kin.InputError, match="refused calibration"):
        carm_kin.read_result(folder / "refused.json").figure()
    with pytest.raises(carm_kin.InputError, match="use 'kinematic'"):
        carm_kin.calibrate(recording, "surface").figure()


def test_the_figure_of_a_result_has_the_recorded_positions_in_its_frame(recording):
    """The fitted poses are drawn where the recorded ones lie in the frame of the torus."""
    pytest.importorskip("matplotlib", reason="pip install 'carm-kin[figures]'")
    found = carm_kin.calibrate(recording)
    space = found.figure().axes[0]
    (line,) = (line for line in space.lines if line.get_label() == "fitted poses")
    T = found.placements[0].T_world_torus
    recorded = (recording.p_world_sensor - T[:3, 3]) @ T[:3, :3] * 1e3
    assert np.abs(np.stack(line.get_data_3d(), axis=1) - recorded).max() < 5.0


@pytest.mark.parametrize("of", ["recording", "result"])
def test_a_figure_without_matplotlib_says_how_to_get_it(of, request, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(carm_kin.MissingDependencyError, match=r"pip install 'carm-kin\[figures\]'"):
        request.getfixturevalue(of).figure()


def test_results_are_pickled_and_copied(recording, result):
    centre = carm_kin.RotationCentre(result, sigma_t_m=1e-3)
    for of in (recording, result, centre, carm_kin.check(result, recording), carm_kin.Machine(MACHINE)):
        for again in (pickle.loads(pickle.dumps(of)), copy.deepcopy(of), copy.copy(of)):
            assert repr(again)[:60] == repr(of)[:60]
    assert pickle.loads(pickle.dumps(centre)).sigma == centre.sigma
    assert replace(centre, sigma_t_m=2e-3).sigma[0] == 2e-3
    assert pickle.loads(pickle.dumps(carm_kin.calibrate)) is carm_kin.calibrate


# mistakes

CALIBRATION = r"a calibration \(a CalibrationResult, or the path of its JSON file\) is needed, not "
RECORDING = r"a recording \(a Recording, or the path of its file\) is needed, not "
URDF = r"a URDF \(its path, or the name of a bundled machine\) is needed, not "
MISTAKES = {
    "a recording for a result": (lambda r, c: carm_kin.RotationCentre(r), CALIBRATION + "a Recording"),
    "the two exchanged": (lambda r, c: carm_kin.check(r, c), CALIBRATION + "a Recording"),
    "a result for a recording": (lambda r, c: carm_kin.check(c, c), RECORDING + "a CalibrationResult"),
    "the class itself": (lambda r, c: carm_kin.calibrate(carm_kin.Recording), RECORDING + "the class Recording"),
    "an array": (lambda r, c: carm_kin.calibrate(r.T_world_sensor[:5]), r"shape \(5, 4, 4\); Recording.from_poses"),
    "nothing": (lambda r, c: carm_kin.calibrate(None), RECORDING + "None"),
    "a number": (lambda r, c: carm_kin.calibrate_chain(3, MACHINE), RECORDING + "3"),
    "no recordings": (lambda r, c: carm_kin.calibrate_chain([], MACHINE), "no recording is given"),
    "no URDF": (lambda r, c: carm_kin.calibrate_chain(r, None), URDF + "None"),
    "a list of machines": (lambda r, c: carm_kin.Machine([MACHINE]), URDF + "a list"),
    "an unknown machine": (lambda r, c: carm_kin.simulate("mobile"), "no such file; bundled machines: "),
    "a free joint": (lambda r, c: carm_kin.calibrate_chain(r, MACHINE, free="axis"), "named 'axis'; valid: all, axes"),
    "a free number": (lambda r, c: carm_kin.calibrate_chain(r, MACHINE, free=3), "what is free .* is needed, not 3"),
    "the chain's solver": (lambda r, c: carm_kin.calibrate(r, "chain"), r"calibrate_chain\(recording, urdf\)"),
    "an unknown solver": (lambda r, c: carm_kin.compare(r, "kinematik"), "solver 'kinematik' is unknown"),
    "a missing file": (lambda r, c: carm_kin.RotationCentre("none.json"), "none.json: no such file"),
    "an unknown export": (lambda r, c: carm_kin.export(c, "ros1", "out"), "no export 'ros1'; choose from itk"),
    "an unknown setting": (lambda r, c: carm_kin.batch("a", "b", solvers="x"), "'solvers' is unknown"),
    "no worker": (lambda r, c: carm_kin.batch("a", "b", jobs=0), "jobs must be at least 1, not 0"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_in_a_sentence(recording, result, mistake):
    make, words = MISTAKES[mistake]
    with pytest.raises(carm_kin.InputError, match=words) as caught:
        make(recording, result)
    assert "\n" not in str(caught.value)


def test_a_report_of_another_recording_is_not_written(folder, recording, result, tmp_path):
    out = tmp_path / "report.html"
    for other, words in (
        (folder / "another.csv", "the files' SHA-256 differ; give the one that the result was made from, rec.csv"),
        (recording.select(slice(0, 50)), rf"made from {len(recording)} poses, this has 50"),
    ):
        for write in (carm_kin.write_report, carm_kin.write_figures):
            with pytest.raises(carm_kin.InputError, match=words):
                write(result, other, out)
    assert not out.exists()
