"""The kinematics of any machine: poses and every column of the Jacobian, against SciPy, differences and Pinocchio."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from carm_kin.calibration.chain.model import chain_model
from carm_kin.machine.kinematics import Model
from carm_kin.machine.urdf import read_urdf
from helpers.chained import ARM_ORIGINS, C_ARM, arm, kinematics, random_values, stand, written
from helpers.machines import changed, drawn, hand_made, pose, twist
from solvers.chain.machine import linearise, pose_residual

H = 1e-6
BRANCHES = ((0, 1, 2), (0, 3), (4,))


def branched(seed=0):
    """Three sensors on a tree of five joints, two bases, offsets and gains."""
    machine = hand_made("rprrp", bases=2, paths=BRANCHES, seed=seed)
    for j in range(5):
        machine = changed(machine, "offsets", j, 0.1 * (j + 1))
        machine = changed(machine, "gains", j, 0.02 * (j - 2))
    return machine


@pytest.mark.parametrize("sensor", range(3))
@pytest.mark.parametrize("base", range(2))
def test_poses_are_the_product_of_all_joints(base, sensor):
    machine = branched()
    values = drawn(machine, 5)
    expected = [pose(machine, v, base, sensor) for v in values]
    np.testing.assert_allclose(machine.poses(values, base, sensor), expected, atol=1e-14)


@pytest.mark.parametrize("text, link", [(C_ARM, "sensor"), (arm(), "tool")])
def test_poses_of_a_urdf(tmp_path, text, link):
    model = chain_model(read_urdf(written(tmp_path / "a.urdf", text)), [link])
    q = random_values(model.names, 7, 1)
    values = np.stack([q[name] for name in model.names], axis=1)
    np.testing.assert_allclose(model.machine.poses(values, 0, 0), kinematics(text, link, q), atol=1e-14)


def test_joints_that_stand_still_give_the_same_poses():
    """A joint at one value takes a shorter way than one that moves."""
    machine = branched()
    values = np.tile(drawn(machine, 1), (4, 1))
    values[:, 2] = [0.1, 0.2, 0.3, 0.4]
    expected = [pose(machine, v) for v in values]
    np.testing.assert_allclose(machine.poses(values, 0, 0), expected, atol=1e-14)
    line = linearise(machine, values, np.array(expected), 0, 0)
    for k in range(3):
        apart = [linearise(machine, v[None], np.array(expected[:1]), 0, 0).by_placement(k)[0] for v in values]
        np.testing.assert_allclose(np.broadcast_to(line.by_placement(k), (4, 6, 6)), apart, atol=1e-14)


def columns_by_differences(machine, v, base, sensor, kind, index):
    """(6, 6) or (6, 1) of the sensor's twist."""
    steps = H * np.eye(6) if machine.__dict__[kind].ndim == 3 else [H]
    T = pose(machine, v, base, sensor)
    ahead = [pose(changed(machine, kind, index, step), v, base, sensor) for step in steps]
    behind = [pose(changed(machine, kind, index, -step), v, base, sensor) for step in steps]
    return np.stack([twist(T, a, b, H) for a, b in zip(ahead, behind, strict=True)], axis=1)


@given(st.integers(0, 10_000), st.integers(0, 1), st.integers(0, 2))
def test_columns_by_differences(seed, base, sensor):
    machine = branched(seed)
    values = drawn(machine, 2, seed)
    line = linearise(machine, values, machine.poses(values, base, sensor), base, sensor)
    for n, v in enumerate(values):
        expected = columns_by_differences(machine, v, base, sensor, "T_world_base", base)
        np.testing.assert_allclose(line.by_base()[n], expected, atol=1e-8)
        for k, j in enumerate(BRANCHES[sensor]):
            expected = columns_by_differences(machine, v, base, sensor, "placements", j)
            found = np.broadcast_to(line.by_placement(k), (2, 6, 6))[n]
            np.testing.assert_allclose(found, expected, atol=1e-8)
            expected = columns_by_differences(machine, v, base, sensor, "offsets", j)[:, 0]
            np.testing.assert_allclose(line.by_motion(k)[n], expected, atol=1e-8)
            expected = columns_by_differences(machine, v, base, sensor, "gains", j)[:, 0]
            np.testing.assert_allclose(line.by_motion(k)[n] * v[j], expected, atol=1e-8)
        expected = columns_by_differences(machine, v, base, sensor, "T_last_sensor", sensor)
        np.testing.assert_allclose(np.eye(6), expected, atol=1e-8)


def test_columns_of_placements_and_motions_are_pinocchios(tmp_path):
    pytest.importorskip("pinocchio")
    urdf = read_urdf(written(tmp_path / "arm.urdf", arm()))
    model = chain_model(urdf, ["tool"])
    values = np.stack(list(random_values(model.names, 9, 2).values()), axis=1)
    line = linearise(model.machine, values, model.machine.poses(values, 0, 0), 0, 0)
    library = Model(urdf, model.chains[0])
    K, J = library.placement_regressor(values), library.jacobian(values)
    for k in range(len(ARM_ORIGINS)):
        columns = np.broadcast_to(line.by_placement(k), (9, 6, 6))
        np.testing.assert_allclose(columns, K[:, :, 6 * k : 6 * k + 6], atol=1e-12)
        np.testing.assert_allclose(line.by_motion(k), J[:, :, k], atol=1e-12)


def test_columns_of_a_sliding_joint_are_pinocchios(tmp_path):
    pytest.importorskip("pinocchio")
    urdf = read_urdf(written(tmp_path / "c.urdf", C_ARM))
    model = chain_model(urdf, ["sensor"])
    values = np.stack(list(random_values(model.names, 9, 3, 0.4).values()), axis=1)
    line = linearise(model.machine, values, model.machine.poses(values, 0, 0), 0, 0)
    J = Model(urdf, model.chains[0]).jacobian(values)
    assert model.names[0] == "lift"
    for k in range(3):
        np.testing.assert_allclose(line.by_motion(k), J[:, :, k], atol=1e-12)


def test_residual_is_what_leads_from_the_prediction_to_the_observation():
    predicted, v, w = np.stack([stand(k) for k in range(3)]), np.array([0.1, -0.2, 0.3]), np.array([0.4, 0.1, -0.9])
    observed = predicted.copy()
    observed[:, :3, 3] += predicted[:, :3, :3] @ v
    observed[:, :3, :3] = predicted[:, :3, :3] @ Rotation.from_rotvec(w).as_matrix()
    np.testing.assert_allclose(pose_residual(predicted, observed), np.tile([*v, *w], (3, 1)), atol=1e-12)


@given(st.integers(0, 10_000))
def test_gradient_of_the_squared_residual_is_exact(seed):
    """Half the squares of both parts change by minus the residual times the twist, however large the residual."""
    rng = np.random.default_rng(seed)
    machine = hand_made("rr", seed=seed)
    v = drawn(machine, 1, seed)[0]
    T = pose(machine, v)
    observed = T.copy()
    observed[:3, 3] += rng.normal(size=3)
    observed[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(rng.uniform(-1, 1, 3)).as_matrix()
    line = linearise(machine, v[None], observed[None], 0, 0)

    def half_squares(moved):
        off = moved[:3, 3] - observed[:3, 3]
        turn = Rotation.from_matrix(moved[:3, :3].T @ observed[:3, :3]).as_rotvec()
        return 0.5 * np.array([off @ off, turn @ turn])

    for step in np.eye(6):
        ahead, behind = (half_squares(pose(changed(machine, "placements", 1, s * H * step), v)) for s in (1, -1))
        column, r = line.by_placement(1)[0] @ step, line.residual[0]
        expected = [-(r[:3] @ column[:3]), -(r[3:] @ column[3:])]
        np.testing.assert_allclose((ahead - behind) / (2 * H), expected, atol=1e-7)
