"""What holds for every machine in urdf/ and each of its sensors. A file that is put there is tested the same day."""

import json
import re
import runpy

import numpy as np
import pytest

import carm_kin
from carm_kin.machine.chain import chain_of, nominal_geometry
from carm_kin.machine.kinematics import Model
from carm_kin.machine.urdf import bundled_urdfs, patch_origins, read_urdf, write_urdf
from carm_kin.simulation.truth import chain_ends
from helpers.command import run
from helpers.family import BRANCHES, FILES, IDS, link_pose, sensors
from helpers.places import ROOT
from solvers.se3 import exp_so3, transform

every_sensor = pytest.mark.parametrize("name, link", BRANCHES, ids=IDS)
every_file = pytest.mark.parametrize("name", FILES)


def test_the_files_are_those_that_the_description_gives(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["make_urdf.py", str(tmp_path)])
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    runpy.run_path(str(ROOT / "tools" / "make_urdf.py"), run_name="__main__")
    made = {path.stem: path.read_bytes() for path in tmp_path.iterdir()}
    assert len(made) >= 12
    assert set(made) <= set(FILES)
    for name, data in made.items():
        assert FILES[name].read_bytes() == data, name


def test_every_file_comes_with_the_package():
    assert list(bundled_urdfs()) == list(FILES)


@every_file
def test_a_file_loads_without_a_remark_and_says_where_its_numbers_come_from(name):
    urdf = read_urdf(name)
    assert (urdf.name, urdf.notes) == (name, ())
    head = " ".join(FILES[name].read_text(encoding="utf-8").split("<robot")[0].split())
    assert any(word in head for word in ("typical", "estimate", "published"))
    assert sensors(FILES[name])
    for sensor in sensors(FILES[name]):
        for part in ("source", "detector"):
            assert sensor.replace("sensor", part) in urdf.links


@every_sensor
def test_the_beam_runs_along_z_from_source_to_detector(name, link):
    source, detector = (link_pose(FILES[name], link.replace("sensor", part), {}) for part in ("source", "detector"))
    x, y, z = (np.linalg.inv(source) @ detector)[:3, 3]
    assert (x, y) == pytest.approx((0, 0), abs=1e-12)
    assert 0.4 < z < 1.3
    np.testing.assert_allclose(source[:3, :3], detector[:3, :3], atol=1e-12)
    assert source[2, 3] > 0.1


@every_sensor
def test_poses_equal_a_chain_of_scipy_rotations(name, link):
    urdf = read_urdf(name)
    chain = chain_of(urdf, link)
    low, high = np.maximum(chain.lower, -3), np.minimum(chain.upper, 3)
    q = np.random.default_rng(0).uniform(low, high, (20, len(chain.names)))
    expected = [link_pose(FILES[name], link, dict(zip(chain.names, row, strict=True))) for row in q]
    np.testing.assert_allclose(chain.forward_kinematics(q), expected, atol=1e-12)
    np.testing.assert_allclose(Model(urdf, chain).forward_kinematics(q), expected, atol=1e-12)


@every_sensor
def test_a_machine_is_inspected(name, link, capsys):
    ended = run(capsys, "inspect", name, "--sensor-link", link, "--json")
    found = json.loads(ended.out)
    assert (ended.status, found["sensor_link"], found["isocentric"]) == (0, link, found["major_radius_mm"] < 0.5)
    assert {found["angular"], found["orbital"]} <= {joint["name"] for joint in found["joints"]}
    assert run(capsys, "inspect", name, "--sensor-link", link).status == 0


@every_sensor
def test_a_machine_is_simulated_and_calibrated_by_the_command(name, link, tmp_path, capsys):
    """With noise. A right program exceeds 4.5 standard deviations once in some 10,000 of these tests."""
    file, saved = tmp_path / "rec.csv", tmp_path / "result.json"
    noise = ("--sigma-t-mm", 0.3, "--sigma-r-deg", 0.05)
    assert run(capsys, "simulate", name, "-o", file, "--sensor-link", link, *noise, "--seed", 4).status == 0
    ended = run(capsys, "calibrate", file, "--urdf", name, "--sensor-link", link, "--json", saved)
    assert ended.status == 0, ended.err
    result = carm_kin.CalibrationResult.from_json(saved)
    truth = carm_kin.CalibrationResult.from_json(tmp_path / "rec.truth.json")
    assert result.outliers.count <= 0.01 * result.poses
    for part in ("offset_sensor_pivot_m", "major_radius_m", "minor_radius_m", "axis_non_orthogonality_rad"):
        error = np.abs(getattr(result, part) - getattr(truth, part))
        assert np.all(error < 4.5 * getattr(result.sigma, part)), part
    assert np.max(result.sigma.offset_sensor_pivot_m) < 1e-4
    found, expected, sigma = result.placements[0], truth.placements[0], result.sigma.placements[0]
    assert np.all(np.abs(found.torus_center_world_m - expected.torus_center_world_m) < 4.5 * sigma.torus_center_world_m)
    turned = np.linalg.norm(np.cross(found.angular_axis_world, expected.angular_axis_world))
    assert turned < 4.5 * np.linalg.norm(sigma.angular_axis_world)


@every_sensor
@pytest.mark.parametrize("solver", ["closed_form", "decomposed", "direct", "kinematic"])
def test_exact_poses_of_a_machine_give_the_exact_answer(solver, name, link):
    recording, truth = carm_kin.simulate(name, "clinical", sensor_link=link, seed=3)
    axes = nominal_geometry(chain_of(read_urdf(name), link)).axes
    skewed = abs(truth.axis_non_orthogonality_rad) > 1e-9 and solver != "kinematic"
    options = {"fix_non_orthogonality": False} if skewed else {}
    result = carm_kin.calibrate(recording, solver, angular=axes[0], orbital=axes[1], **options)
    assert result.status == "ok"
    for part in ("offset_sensor_pivot_m", "major_radius_m", "minor_radius_m", "axis_non_orthogonality_rad"):
        np.testing.assert_allclose(getattr(result, part), getattr(truth, part), rtol=0, atol=1e-8)
    found, expected = result.placements[0], truth.placements[0]
    np.testing.assert_allclose(found.torus_center_world_m, expected.torus_center_world_m, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.angular_axis_world, expected.angular_axis_world, rtol=0, atol=1e-8)


@every_sensor
def test_every_joint_of_a_machine_is_moved_and_read(name, link):
    urdf = read_urdf(name)
    chain = chain_of(urdf, link)
    recording, truth = carm_kin.simulate(urdf, "joints", sensor_link=link, seed=2)
    q = np.stack([recording.joints[joint] for joint in chain.names], axis=1)
    low, high = q.min(axis=0), q.max(axis=0)
    assert np.all(low >= chain.lower - 1e-9)
    assert np.all(high <= chain.upper + 1e-9)
    slides = np.array(chain.types) == "prismatic"
    assert np.all(high - low > np.where(slides, 0.15, np.radians(20)))
    T_world_base, T_link_sensor = chain_ends(truth, chain)
    np.testing.assert_allclose(T_link_sensor, np.eye(4), atol=1e-12)
    for pose in range(0, len(recording), 100):
        T = T_world_base @ link_pose(FILES[name], link, dict(zip(chain.names, q[pose], strict=True)))
        np.testing.assert_allclose(recording.p_world_sensor[pose], T[:3, 3], atol=1e-12)


@every_file
def test_a_file_that_is_patched_and_patched_back_has_the_same_numbers(name, tmp_path):
    urdf = read_urdf(name)
    rng = np.random.default_rng(0)
    changed = {joint.name: transform(exp_so3(rng.normal(size=3)), rng.normal(size=3)) for joint in urdf.joints}
    write_urdf(patch_origins(urdf, changed), tmp_path / "patched.urdf")
    patched = read_urdf(tmp_path / "patched.urdf")
    assert patched.data != urdf.data
    for joint in patched.joints:
        np.testing.assert_allclose(joint.origin, changed[joint.name], atol=1e-15)
    back = patch_origins(patched, {joint.name: joint.origin for joint in urdf.joints})
    for old, new in zip(urdf.joints, back.joints, strict=True):
        np.testing.assert_allclose(new.origin, old.origin, atol=1e-15)
        assert (new.name, new.type, new.parent, new.child) == (old.name, old.type, old.parent, old.child)
        assert (new.lower, new.upper, new.axis.tolist()) == (old.lower, old.upper, old.axis.tolist())
    origin = re.compile(rb"\s*<origin[^>]*/>")
    assert origin.sub(b"", back.data) == origin.sub(b"", urdf.data)
