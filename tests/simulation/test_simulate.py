"""Simulated recordings: seeds, noise, outliers, missing frames, mounts, and the truth beside them."""

import json

import numpy as np
import pytest

import carm_kin
from carm_kin.errors import InputError
from carm_kin.machine.chain import chain_of, nominal_geometry
from carm_kin.machine.kinematics import Model
from carm_kin.machine.urdf import bundled_urdfs, parse_urdf, read_urdf
from carm_kin.simulation.noise import OUTLIER_M
from carm_kin.simulation.simulate import simulate
from carm_kin.simulation.truth import chain_ends
from helpers.family import BRANCHES, IDS
from solvers.se3 import exp_so3, inverse, log_so3, transform

NOISE = {"sigma_t_m": 1e-3, "sigma_r_rad": 2e-3}
SWEEP = '[[sweep]]\nmoving = "{}"\nfrom_deg = -30\nto_deg = 30\nheld_mm = {{lift = {}}}\nheld_deg = {{{} = 10}}\n'


def truth_bytes(truth: carm_kin.CalibrationResult) -> str:
    data = truth.to_dict()
    del data["provenance"]["date"]
    return json.dumps(data)


@pytest.mark.parametrize("protocol", ["clinical", "free"])
def test_the_same_seed_gives_the_same_bytes(protocol, tmp_path):
    seen = []
    for name, seed in (("a", 7), ("b", 7), ("c", 8)):
        recording, truth = simulate("mobile_skewed", protocol, **NOISE, outliers=0.05, missing=0.05, seed=seed)
        carm_kin.write_recording(recording, tmp_path / f"{name}.csv")
        seen.append(((tmp_path / f"{name}.csv").read_bytes(), truth_bytes(truth)))
    assert seen[0] == seen[1]
    assert seen[0][0] != seen[2][0]
    assert seen[0][1] != seen[2][1]


def test_noise_has_the_size_that_was_asked_for():
    clean, _ = simulate("mobile_nonisocentric", "minimal", seed=2)
    noisy, _ = simulate("mobile_nonisocentric", "minimal", **NOISE, seed=2)
    shift = noisy.p_world_sensor - clean.p_world_sensor
    turn = log_so3(np.swapaxes(clean.R_world_sensor, 1, 2) @ noisy.R_world_sensor)
    for error, sigma in ((shift, 1e-3), (turn, 2e-3)):
        n = len(error)
        assert np.abs(error.mean(axis=0)).max() < 4.5 * sigma / np.sqrt(n)
        assert np.abs(error.std(axis=0) / sigma - 1).max() < 4.5 / np.sqrt(2 * n)
        assert np.abs(np.corrcoef(error.T) - np.eye(3)).max() < 4.5 / np.sqrt(n)
    assert np.abs(np.corrcoef(np.concatenate([shift, turn], axis=1).T)[:3, 3:]).max() < 4.5 / np.sqrt(len(shift))


def test_position_noise_alone_leaves_the_orientations():
    clean, _ = simulate("mobile_nonisocentric", "minimal", seed=2)
    noisy, _ = simulate("mobile_nonisocentric", "minimal", sigma_t_m=1e-3, seed=2)
    np.testing.assert_allclose(noisy.R_world_sensor, clean.R_world_sensor, atol=1e-15)


def test_the_outliers_of_the_truth_are_the_poses_that_are_off():
    clean, _ = simulate("mobile_nonisocentric", seed=4)
    dirty, truth = simulate("mobile_nonisocentric", outliers=0.3, seed=4)
    off = np.linalg.norm(dirty.p_world_sensor - clean.p_world_sensor, axis=1)
    assert truth.outliers.indices == tuple(np.flatnonzero(off > 1e-9))
    assert truth.outliers.count == round(0.3 * len(dirty))
    assert truth.used == len(dirty) - truth.outliers.count
    assert np.all((off[off > 1e-9] >= OUTLIER_M[0]) & (off[off > 1e-9] <= OUTLIER_M[1]))
    turned = np.linalg.norm(log_so3(np.swapaxes(clean.R_world_sensor, 1, 2) @ dirty.R_world_sensor), axis=1)
    assert truth.outliers.indices == tuple(np.flatnonzero(turned > 1e-6))


def test_missing_frames_keep_their_place_in_the_file(tmp_path):
    whole, _ = simulate("mobile_nonisocentric", outliers=0.1, seed=5)
    recording, truth = simulate("mobile_nonisocentric", outliers=0.1, missing=0.25, seed=5)
    assert recording.missing + len(recording) == len(whole)
    assert abs(recording.missing / len(whole) - 0.25) < 4.5 * np.sqrt(0.25 * 0.75 / len(whole))
    np.testing.assert_array_equal(recording.p_world_sensor, whole.p_world_sensor[recording.pose_number])
    assert set(truth.outliers.indices) <= set(recording.pose_number.tolist())
    assert truth.poses == len(recording)
    carm_kin.write_recording(recording, tmp_path / "rec.csv")
    back = carm_kin.read_recording(tmp_path / "rec.csv")
    assert back.missing == recording.missing
    np.testing.assert_array_equal(back.pose_number, recording.pose_number)
    assert len((tmp_path / "rec.csv").read_text().splitlines()) == len(whole) + 1


@pytest.mark.parametrize("machine, sensor", BRANCHES, ids=IDS)
def test_poses_follow_the_chain_and_the_truth(machine, sensor):
    """Pinocchio's poses against the formula of the design, with the truth's own numbers."""
    recording, truth = simulate(machine, "minimal", sensor_link=sensor, seed=6)
    alpha, beta = np.radians([-90.0] * 360), np.radians(np.arange(360.0))
    placement, mount = truth.placements[0].T_world_torus, truth.T_sensor_carm
    assert placement is not None
    assert mount is not None
    x, y, z = np.eye(3)
    R = exp_so3(alpha[:, None] * x)
    R_carm = R @ exp_so3(z * truth.axis_non_orthogonality_rad) @ exp_so3(beta[:, None] * y)
    T = placement @ transform(R_carm, R @ (z * truth.major_radius_signed_m)) @ inverse(mount)
    assert recording.R_world_sensor is not None
    np.testing.assert_allclose(recording.p_world_sensor[:360], T[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(recording.R_world_sensor[:360], T[:, :3, :3], atol=1e-12)


def test_the_truth_is_that_of_the_urdf():
    geometry = nominal_geometry(chain_of(read_urdf("mobile_skewed")))
    _, truth = simulate("mobile_skewed", **NOISE, seed=1)
    np.testing.assert_allclose(truth.offset_sensor_pivot_m, geometry.offset, atol=1e-15)
    assert truth.major_radius_m == pytest.approx(0.06)
    assert np.degrees(truth.axis_non_orthogonality_rad) == pytest.approx(0.7)
    assert truth.minor_radius_m == pytest.approx(geometry.minor_radius)
    assert (truth.solver, truth.status, truth.provenance.seed) == ("truth", "ok", 1)
    assert (truth.noise.translation_m, truth.noise.rotation_rad, truth.noise.estimated) == (1e-3, 2e-3, False)


def test_the_world_is_drawn_from_the_seed_unless_given():
    T = transform(exp_so3(np.array([0.1, 0.2, 0.3])), np.array([1.0, 2.0, 3.0]))
    worlds = [simulate("mobile_skewed", "free", seed=seed)[1].placements[0].T_world_torus for seed in range(3)]
    assert np.abs(worlds[0] - worlds[1]).max() > 0.1
    assert np.abs(worlds[1] - worlds[2]).max() > 0.1
    _, truth = simulate("mobile_skewed", "free", T_world_torus=T)
    np.testing.assert_allclose(truth.placements[0].T_world_torus, T, atol=1e-12)


def test_a_mount_turns_and_moves_the_sensor():
    mount = transform(exp_so3(np.array([0.5, -0.2, 0.1])), np.array([0.01, 0.02, -0.03]))
    plain, truth = simulate("mobile_skewed", "free", seed=1)
    mounted, moved = simulate("mobile_skewed", "free", T_sensor_mount=mount, seed=1)
    T = transform(plain.R_world_sensor, plain.p_world_sensor) @ mount
    np.testing.assert_allclose(mounted.p_world_sensor, T[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(mounted.R_world_sensor, T[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(moved.T_sensor_carm, inverse(mount) @ truth.T_sensor_carm, atol=1e-12)
    np.testing.assert_allclose(moved.offset_sensor_pivot_m, moved.T_sensor_carm[:3, 3], atol=1e-15)


def test_labels_may_be_dropped():
    kept, _ = simulate("mobile_skewed", seed=1)
    bare, _ = simulate("mobile_skewed", labels=False, seed=1)
    np.testing.assert_array_equal(kept.p_world_sensor, bare.p_world_sensor)
    assert (bare.sweep, bare.moving, dict(bare.joints)) == (None, None, {})
    assert len(kept.sweeps) == 8
    assert [np.degrees(sweep.held["angular"]) for sweep in kept.sweeps[:5]] == pytest.approx([-90, -45, 0, 45, 90])
    assert all(np.isnan(kept.joints["orbital"][sweep.poses]).all() for sweep in kept.sweeps[:5])


def test_joints_gives_all_readings_and_a_truth_with_the_others_at_zero():
    urdf = read_urdf("mobile_skewed")
    chain = chain_of(urdf)
    mount = transform(exp_so3(np.array([0.5, -0.2, 0.1])), np.array([0.01, 0.02, -0.03]))
    recording, truth = simulate(urdf, "joints", T_sensor_mount=mount, seed=3)
    assert tuple(recording.joints) == chain.names
    assert recording.prismatic == {"cart_x", "cart_y", "lift", "horizontal"}
    assert (recording.placements, recording.sweeps) == (("",), [])
    assert [note.code for note in truth.warnings] == ["truth_at_zero"]
    assert len(truth.placements) == 1
    T_world_base, T_link_sensor = chain_ends(truth, chain)
    np.testing.assert_allclose(T_link_sensor, mount, atol=1e-12)
    q = np.stack(list(recording.joints.values()), axis=1)
    T = T_world_base @ chain.forward_kinematics(q) @ mount
    np.testing.assert_allclose(recording.p_world_sensor, T[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(recording.R_world_sensor, T[:, :3, :3], atol=1e-12)
    torus = nominal_geometry(chain).T_base_torus
    np.testing.assert_allclose(truth.placements[0].T_world_torus, T_world_base @ torus, atol=1e-12)


def test_readings_have_the_noise_that_was_asked_for(tmp_path):
    exact, _ = simulate("mobile_skewed", "joints", seed=3)
    read, truth = simulate("mobile_skewed", "joints", sigma_reading_rad=1e-3, sigma_reading_m=2e-4, seed=3)
    np.testing.assert_array_equal(read.p_world_sensor, exact.p_world_sensor)
    assert (truth.options["sigma_reading_rad"], truth.options["sigma_reading_m"]) == (1e-3, 2e-4)
    errors = np.stack([read.joints[name] - exact.joints[name] for name in exact.joints])
    sigma = np.array([2e-4 if name in exact.prismatic else 1e-3 for name in exact.joints])
    n = errors.shape[1]
    assert np.abs(errors.mean(axis=1) / sigma).max() < 4.5 / np.sqrt(n)
    assert np.abs(errors.std(axis=1) / sigma - 1).max() < 4.5 / np.sqrt(2 * n)
    assert np.abs(np.corrcoef(errors) - np.eye(len(sigma))).max() < 4.5 / np.sqrt(n)
    carm_kin.write_recording(read, tmp_path / "rec.csv")
    back = carm_kin.read_recording(tmp_path / "rec.csv")
    assert back.prismatic == read.prismatic
    for name, values in read.joints.items():
        np.testing.assert_allclose(back.joints[name], values, atol=1e-12)


def test_a_joint_that_is_held_has_one_error():
    exact, _ = simulate("mobile_skewed", seed=3)
    read, _ = simulate("mobile_skewed", sigma_reading_rad=1e-3, seed=3)
    held = [(sweep.held, other.held) for sweep, other in zip(read.sweeps, exact.sweeps, strict=True)]
    errors = [value - truth[name] for found, truth in held for name, value in found.items()]
    assert len(set(errors)) == len(errors) == 8
    assert 0 < np.abs(errors).max() < 5e-3


def test_the_ends_of_the_chain_need_a_truth():
    recording, truth = simulate("mobile_skewed", "minimal", seed=1)
    with pytest.raises(InputError, match="no complete chain"):
        chain_ends(carm_kin.calibrate(recording, "surface"), chain_of(read_urdf("mobile_skewed")))
    assert chain_ends(truth, chain_of(read_urdf("mobile_skewed")))[1] == pytest.approx(np.eye(4), abs=1e-12)


def test_lift_positions_are_placements(tmp_path):
    file = tmp_path / "lifted.toml"
    text = "".join(
        SWEEP.format(m, lift, h) for lift in (0, 200) for m, h in (("orbital", "angular"), ("angular", "orbital"))
    )
    file.write_text(text)
    recording, truth = simulate("mobile_skewed", file, seed=3)
    assert recording.placements == ("1", "2")
    assert [len(sweep.poses) for sweep in recording.sweeps] == [61] * 4
    assert [sweep.placement for sweep in recording.sweeps] == ["1", "1", "2", "2"]
    assert [placement.label for placement in truth.placements] == ["1", "2"]
    assert [sweep.held["lift"] for sweep in recording.sweeps] == [0, 0, 0.2, 0.2]
    assert recording.prismatic == {"lift"}
    assert recording.warnings == ()
    rise = truth.placements[1].torus_center_world_m - truth.placements[0].torus_center_world_m
    assert np.linalg.norm(rise) == pytest.approx(0.2)
    result = carm_kin.calibrate(recording)
    np.testing.assert_allclose(result.offset_sensor_pivot_m, truth.offset_sensor_pivot_m, atol=1e-9)
    np.testing.assert_allclose(
        result.placements[1].torus_center_world_m, truth.placements[1].torus_center_world_m, atol=1e-9
    )


def test_positions_follow_the_lift(tmp_path):
    """The first pose, from the joint values alone."""
    file = tmp_path / "lifted.toml"
    file.write_text(SWEEP.format("orbital", 200, "angular"))
    urdf = read_urdf("mobile_skewed")
    chain = chain_of(urdf)
    q = np.zeros((2, len(chain.names)))
    q[:, chain.orbital], q[:, chain.angular], q[:, chain.index("lift")] = np.radians([-30, 30]), np.radians(10), 0.2
    recording, _ = simulate(urdf, file, seed=3)
    T = Model(urdf, chain).forward_kinematics(q)
    distance = np.linalg.norm(T[1, :3, 3] - T[0, :3, 3])
    assert np.linalg.norm(recording.p_world_sensor[-1] - recording.p_world_sensor[0]) == pytest.approx(distance)


def test_remarks_on_the_urdf_reach_the_truth():
    text = read_urdf("mobile_skewed").data.replace(b'<axis xyz="1 0 0"/>', b'<axis xyz="1.0005 0 0"/>', 1)
    _, truth = simulate(parse_urdf(text, bundled_urdfs()["mobile_skewed"]))
    assert [note.code for note in truth.warnings] == ["urdf"]


@pytest.mark.parametrize(
    "bad",
    [
        {"sigma_t_m": -1e-3},
        {"sigma_t_m": float("nan")},
        {"sigma_t_m": float("inf")},
        {"sigma_t_m": 1000.0},
        {"sigma_r_rad": -1.0},
        {"sigma_r_rad": 10.0},
        {"sigma_reading_rad": -1e-3},
        {"sigma_reading_rad": float("nan")},
        {"sigma_reading_m": float("inf")},
        {"label_resolution_rad": -1e-3},
        {"anisotropy": 0.0},
        {"anisotropy": float("nan")},
        {"correlation": 1.0},
        {"correlation": -0.1},
        {"correlation": float("nan")},
        {"sag_m": -1e-3},
        {"sag_m": float("nan")},
        {"field_m": float("inf")},
        {"creep_m": 1.0},
        {"backlash_rad": -1e-3},
        {"smoothing_s": 100.0},
        {"rate_hz": 0.0},
        {"rate_hz": float("nan")},
        {"outliers": 1.0},
        {"outliers": -0.1},
        {"outliers": float("nan")},
        {"missing": 1.5},
        {"missing": float("nan")},
        {"seed": -1},
        {"T_world_torus": np.eye(3)},
        {"T_world_torus": 2 * np.eye(4)},
        {"T_world_torus": np.diag([1.0, 1.0, -1.0, 1.0])},
        {"T_sensor_mount": np.full((4, 4), np.nan)},
        {"T_sensor_mount": np.diag([2.0, 2.0, 2.0, 1.0])},
    ],
)
def test_bad_arguments_name_themselves(bad):
    with pytest.raises(InputError, match=next(iter(bad))):
        simulate("mobile_skewed", **bad)
