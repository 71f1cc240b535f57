"""Exports: read back by other programs' readers, the same facts in all of them, and what is not exported."""

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import lxml.etree as etree
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.calibration.chain.calibrate import FreeJoints, calibrate_chain
from carm_kin.errors import InputError, RefusedError
from carm_kin.exports import TRANSFORMS, export, exports
from carm_kin.machine.urdf import find_urdf
from carm_kin.recording.recording import Recording
from carm_kin.results.parts import Provenance
from carm_kin.results.result import CalibrationResult
from carm_kin.testing import export as contract
from helpers import bending
from helpers.command import fails, run

NAMES = sorted(exports())
OF_A_TRANSFORM = [name for name in NAMES if "transform" in exports()[name].takes]
DATE, SHA = "2031-02-03T04:05:06+00:00", "5c" * 32


@pytest.fixture(scope="module")
def recording() -> Recording:
    found, _ = carm_kin.simulate("mobile_skewed", "minimal", sigma_t_m=1e-9, sigma_r_rad=1e-9, seed=3)
    return found.select(slice(None, None, 20))


@pytest.fixture(scope="module")
def result(recording) -> CalibrationResult:
    found = carm_kin.calibrate(recording)
    versions = {"carm-kin": "9.8.7", "numpy": "1"}
    return replace(found, provenance=Provenance(versions, "a -- b\n<c>.csv", SHA, None, None, DATE))


@pytest.fixture(scope="module")
def result_file(result, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("result") / "result.json"
    result.to_json(path)
    return path


@pytest.fixture(scope="module")
def refused(recording) -> CalibrationResult:
    found = carm_kin.calibrate(recording.select(recording.sweep == recording.sweeps[0].label))
    assert found.refusal is not None
    return found


def written(result, name, tmp_path, **wanted) -> str:
    out = tmp_path / f"out{exports()[name].ending}"
    export(result, name, out, **wanted)
    return out.read_text(encoding="utf-8")


def transform_of(result, which):
    return result.T_sensor_carm if which == "sensor-carm" else result.placements[0].T_world_torus


def matrix(R, p):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def test_they_are_found_by_name():
    assert NAMES == ["itk", "json", "plus", "ros2", "urdf"]


@pytest.mark.parametrize("name", NAMES)
def test_every_export_says_what_it_is(name):
    contract.says_what_it_is(name)


@pytest.mark.parametrize("name", NAMES)
def test_the_facts_are_in_every_file(name):
    contract.facts_are_in_the_file(name)


@pytest.mark.parametrize("name", NAMES)
def test_hostile_provenance_stays_a_comment(name, result, tmp_path):
    contract.hostile_provenance_stays_a_comment(name)
    if name in ("plus", "urdf"):
        hostile = contract.HOSTILE
        origin = replace(result.provenance, input_sha256=hostile, date=hostile, versions={"carm-kin": hostile})
        root = etree.fromstring(written(replace(result, provenance=origin), name, tmp_path).encode())
        assert "c" not in {element.tag for element in root.iter()}


@pytest.mark.parametrize("name", NAMES)
def test_a_refused_calibration_is_not_exported(name, refused, tmp_path, capsys):
    refused.to_json(tmp_path / "refused.json")
    contract.refused_calibration_is_not_exported(name)
    with pytest.raises(RefusedError, match="not exported"):
        export(refused, name, tmp_path / "out")
    ended = run(capsys, "export", tmp_path / "refused.json", "--to", name, "-o", tmp_path / "out")
    assert ended.status == 3
    assert len(ended.err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", NAMES)
def test_a_result_without_a_chain_is_not_exported(name, recording, tmp_path):
    contract.result_without_a_chain_is_not_exported(name)
    with pytest.raises(InputError, match="'surface'"):
        export(carm_kin.calibrate(recording, "surface"), name, tmp_path / "out")


@pytest.mark.parametrize("name", NAMES)
def test_without_a_sigma_it_says_so(name):
    contract.without_a_sigma_it_says_so(name)


@pytest.mark.parametrize("which", TRANSFORMS)
def test_itk_maps_points_from_the_parent_in_lps(which, result, tmp_path):
    sitk = pytest.importorskip("SimpleITK", reason="SimpleITK is not installed here; pip install 'carm-kin[test]'")
    export(result, "itk", tmp_path / "out.tfm", transform=which)
    read = sitk.ReadTransform(str(tmp_path / "out.tfm"))
    flip = np.array([-1, -1, 1])
    for child_mm in np.array([[0, 0, 0], [100.0, 0, 0], [-20, 30, 700]]):
        parent_mm = (transform_of(result, which) @ [*child_mm / 1e3, 1])[:3] * 1e3
        np.testing.assert_allclose(read.TransformPoint((parent_mm * flip).tolist()), child_mm * flip, atol=1e-8)


@pytest.mark.parametrize("which", TRANSFORMS)
def test_plus_has_the_matrix_in_mm(which, result, tmp_path):
    (found,) = etree.fromstring(written(result, "plus", tmp_path, transform=which).encode()).iter("Transform")
    T = np.array(found.get("Matrix").split(), dtype=float).reshape(4, 4)
    expected = transform_of(result, which)
    np.testing.assert_allclose(T, matrix(expected[:3, :3], expected[:3, 3] * 1e3), atol=1e-12)
    assert (found.get("From"), found.get("To")) == {"sensor-carm": ("Carm", "Sensor")}.get(which, ("Torus", "World"))
    assert found.get("Date") == "020331_040506"
    assert float(found.get("Error")) == pytest.approx(result.residuals.translation_rms_m * 1e3, rel=1e-6)


@pytest.mark.parametrize("which", TRANSFORMS)
def test_ros2_has_parameters_and_a_command_in_metres_and_xyzw(which, result, tmp_path):
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed here; pip install 'carm-kin[test]'")
    text = written(result, "ros2", tmp_path, transform=which, parent_frame="marker", child_frame="c_arm")
    parameters = yaml.safe_load(text)["/**"]["ros__parameters"]
    numbers = [parameters["translation"][axis] for axis in "xyz"] + [parameters["rotation"][axis] for axis in "xyzw"]
    assert all(isinstance(number, float) for number in numbers)
    T = matrix(Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3])
    np.testing.assert_allclose(T, transform_of(result, which), atol=1e-12)
    assert (parameters["frame_id"], parameters["child_frame_id"]) == ("marker", "c_arm")
    words = shlex.split(next(line for line in text.splitlines() if line.startswith("# command: "))[11:])
    assert words[:4] == ["ros2", "run", "tf2_ros", "static_transform_publisher"]
    given = dict(zip(words[4::2], words[5::2], strict=True))
    assert [float(given[f"--{name}"]) for name in ("x", "y", "z", "qx", "qy", "qz", "qw")] == numbers
    assert (given["--frame-id"], given["--child-frame-id"]) == ("marker", "c_arm")


@pytest.mark.parametrize("which", TRANSFORMS)
def test_json_has_the_matrix_the_quaternion_and_the_result(which, result, tmp_path):
    data = json.loads(written(result, "json", tmp_path, transform=which))
    T = np.array(data["T_parent_child"])
    np.testing.assert_allclose(T[:3, 3], transform_of(result, which)[:3, 3] * 1e3, rtol=1e-14)
    np.testing.assert_allclose(Rotation.from_quat(data["quat_xyzw"]).as_matrix(), T[:3, :3], atol=1e-12)
    np.testing.assert_allclose(data["translation_mm"], T[:3, 3])
    sigma = result.sigma if which == "sensor-carm" else result.sigma.placements[0]
    expected = sigma.offset_sensor_pivot_m if which == "sensor-carm" else sigma.torus_center_world_m
    np.testing.assert_allclose(data["sigma_translation_mm"], expected * 1e3)
    assert data["result"]["major_radius_mm"] == pytest.approx(60, abs=1e-3)


def test_the_urdf_of_the_two_axes_moves_as_recorded(recording, result, tmp_path):
    yourdfpy = pytest.importorskip("yourdfpy")
    export(result, "urdf", tmp_path / "out.urdf")
    robot = yourdfpy.URDF.load(str(tmp_path / "out.urdf"), build_scene_graph=True)
    for k in range(0, len(recording), 7):
        robot.update_cfg(dict(zip(("angular", "orbital"), result.angles_rad[k], strict=True)))
        T = result.placements[0].T_world_torus @ robot.get_transform("sensor", "torus")
        expected = matrix(recording.R_world_sensor[k], recording.p_world_sensor[k])
        np.testing.assert_allclose(T, expected, atol=1e-7)


def test_the_urdf_that_was_calibrated_comes_back_calibrated(tmp_path):
    yourdfpy = pytest.importorskip("yourdfpy")
    whole, _ = carm_kin.simulate("mobile_skewed", "minimal", sigma_t_m=1e-4, sigma_r_rad=1e-4, seed=4)
    found = calibrate_chain(whole.select(slice(None, None, 20)), "mobile_skewed", free=FreeJoints(("axes",)))
    assert found.chain is not None
    original = find_urdf("mobile_skewed")
    text = written(found, "urdf", tmp_path, urdf=original)
    assert re.search(r"sigma of joint orbital: .*\d mm", text)
    robot = yourdfpy.URDF.load(str(tmp_path / "out.urdf"), build_scene_graph=False)
    origins = {origin.joint: origin.T_parent_joint for origin in found.chain.origins}
    assert "orbital" in origins
    for joint, T in origins.items():
        np.testing.assert_allclose(robot.joint_map[joint].origin, T, atol=1e-9)
    untouched = original.read_text().split("<!-- Source")[1].split("<!-- Sensor")[0]
    assert untouched in text
    with pytest.raises(InputError, match="--urdf"):
        export(found, "urdf", tmp_path / "out.urdf")


def test_a_pointer_has_a_tip_but_no_axes(tmp_path):
    rng = np.random.default_rng(5)
    R = Rotation.random(40, random_state=6).as_matrix()
    tip, divot = np.array([0.01, -0.02, 0.15]), np.array([0.3, 0.1, -0.9])
    pointer = Recording(divot - R @ tip + 1e-6 * rng.normal(size=(40, 3)), R)
    found = carm_kin.calibrate(pointer, locus="point")
    (it,) = etree.fromstring(written(found, "plus", tmp_path).encode()).iter("Transform")
    T = np.array(it.get("Matrix").split(), dtype=float).reshape(4, 4)
    np.testing.assert_allclose(T, matrix(np.eye(3), tip * 1e3), atol=0.01)
    assert (it.get("From"), it.get("To")) == ("Pivot", "Sensor")


@pytest.mark.parametrize("name", OF_A_TRANSFORM)
def test_the_placement_must_be_told_where_there_are_several(name, result, tmp_path):
    two = replace(
        result,
        placements=(result.placements[0], replace(result.placements[0], label="B")),
        sigma=replace(result.sigma, placements=(*result.sigma.placements, *result.sigma.placements)),
    )
    with pytest.raises(InputError, match="'', 'B'"):
        written(two, name, tmp_path, transform="world-torus")
    written(two, name, tmp_path, transform="world-torus", placement="B")
    with pytest.raises(InputError, match="no placement 'C'"):
        written(two, name, tmp_path, transform="world-torus", placement="C")


@pytest.mark.parametrize(
    "arguments, words",
    {
        ("--to", "bogus"): "no export 'bogus'; choose from itk, json, plus, ros2, urdf",
        ("--to", "itk", "--transform", "x"): "no transform 'x'; choose from sensor-carm, world-torus",
        ("--to", "itk", "--placement", "A"): "a placement belongs to the transform 'world-torus'",
        ("--to", "itk", "--urdf", "mobile_skewed"): "the export 'itk' has no use for 'urdf'",
        ("--to", "urdf", "--child-frame", "x"): "the export 'urdf' has no use for 'child-frame'",
        ("--to", "urdf", "--urdf", "mobile_skewed"): "mobile_skewed was not calibrated",
        ("--to", "ros2", "--child-frame", "a b"): "'a b' is no name of a frame",
        ("--to", "ros2", "--child-frame", 'x"\ny: 1'): "is no name of a frame",
        ("--to", "ros2", "--child-frame", "sensor"): "both named 'sensor'",
        ("--to", "plus", "--child-frame", "ProbeToTracker"): "is no name of a frame for PLUS",
        ("--to", "plus", "--child-frame", "c_arm"): "is no name of a frame for PLUS",
    }.items(),
)
def test_bad_usage_is_one_line(arguments, words, result_file, tmp_path, capsys):
    assert words in fails(capsys, "export", result_file, "-o", tmp_path / "out", *arguments)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", NAMES)
def test_the_command_writes_the_file(name, result_file, tmp_path, capsys):
    out = tmp_path / "out"
    ended = run(capsys, "export", result_file, "--to", name, "-o", out)
    assert (ended.status, ended.out) == (0, "")
    assert ended.err == f"written: {out}\n"
    assert out.stat().st_size > 500
    assert "does not exist" in fails(capsys, "export", result_file, "--to", name, "-o", tmp_path / "no" / "out")


def test_a_deformation_is_told_by_every_export_and_held_by_json(result, tmp_path):
    """The mount at every pair of angles is the mean one moved by what the nodes say."""
    bent = bending.deformation(2e-4)
    moved = replace(result, deformation=bent)
    walk = np.array([node.shift_sensor_pivot_m for node in bent.nodes]) * 1e3
    walk_mm = np.linalg.norm(walk[:, None] - walk, axis=2).max()
    for name in NAMES:
        text = written(moved, name, tmp_path)
        assert f"rotation centre walks up to {walk_mm:.2f} mm" in " ".join(text.split())
        assert "the C bends" not in written(result, name, tmp_path)
    found = json.loads(written(moved, "json", tmp_path))
    grid = found["deformation"]["grid"]
    assert found["deformation"]["alpha_range_deg"] == pytest.approx([-60, 60])
    angles = np.radians([[row["alpha_deg"], row["beta_deg"]] for row in grid])
    expected = (result.offset_sensor_pivot_m + bending.shift_m(angles)) * 1e3
    np.testing.assert_allclose([row["translation_mm"] for row in grid], expected, atol=1e-9)
    np.testing.assert_allclose([row["sigma_translation_mm"] for row in grid], 0.2)
    turn = Rotation.from_quat([row["quat_xyzw"] for row in grid]).as_matrix()
    np.testing.assert_allclose(turn, np.tile(result.T_sensor_carm[:3, :3], (len(grid), 1, 1)), atol=1e-12)
    assert not any(row["extrapolated"] for row in grid)
    read = json.loads(written(moved, "json", tmp_path, transform="world-torus"))
    assert read["deformation"] is None
    assert len(read["result"]["deformation"]["nodes"]) == len(grid)
