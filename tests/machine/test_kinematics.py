"""Pinocchio's kinematics against the closed form written out here, the chain, and finite differences."""

import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from carm_kin.errors import InputError, MissingDependencyError
from carm_kin.machine.chain import chain_of, nominal_geometry
from carm_kin.machine.kinematics import Model
from carm_kin.machine.urdf import read_urdf
from helpers.family import BRANCHES, IDS
from solvers.se3 import exp_se3, inverse, log_se3

MIXED = """<robot name="mixed">
  <link name="base"/> <link name="cart"/> <link name="universe"/> <link name="c"/> <link name="angular"/>
  <link name="branch"/>
  <joint name="cart" type="planar"><parent link="base"/><child link="cart"/><origin xyz="0.2 0.1 0" rpy="0.1 0.2 0.3"/>
    <axis xyz="0 0.6 0.8"/></joint>
  <joint name="angular" type="continuous"><parent link="cart"/><child link="universe"/><origin xyz="0 0 1"/>
    <axis xyz="0.8 0 0.6"/></joint>
  <joint name="shim" type="fixed"><parent link="universe"/><child link="c"/><origin xyz="0 0 0.1" rpy="1 0 0"/></joint>
  <joint name="orbital" type="continuous"><parent link="c"/><child link="angular"/><origin xyz="0.1 0 0"/>
    <axis xyz="0 1 0"/></joint>
  <joint name="branch" type="revolute"><parent link="cart"/><child link="branch"/><limit lower="0" upper="1"/></joint>
</robot>
"""


@pytest.fixture(params=[*BRANCHES, ("mixed", "angular")], ids=[*IDS, "mixed"])
def machine(request, tmp_path):
    pytest.importorskip("pinocchio")
    name, link = request.param
    if name != "mixed":
        urdf = read_urdf(name)
        return urdf, chain_of(urdf, link)
    (tmp_path / "mixed.urdf").write_text(MIXED)
    urdf = read_urdf(tmp_path / "mixed.urdf")
    return urdf, chain_of(urdf, "angular")


def configurations(chain, count, seed=0):
    """Random values of all joints, uniform in their ranges."""
    lower, upper = np.clip(chain.lower, -np.pi, None), np.clip(chain.upper, None, np.pi)
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(chain.names)))


def closed_form(T_base_torus, R, epsilon, T_sensor_carm, alpha, beta):
    """T_base_sensor, every matrix written out: Rx(alpha) Tz(R) Rz(epsilon) Ry(beta) inv(T_sensor_carm)."""
    ca, sa, cb, sb, ce, se = (f(x) for x in (alpha, beta, epsilon) for f in (np.cos, np.sin))
    swivel = np.array([[1, 0, 0, 0], [0, ca, -sa, 0], [0, sa, ca, 0], [0, 0, 0, 1]])
    shift = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, R], [0, 0, 0, 1]])
    skew = np.array([[ce, -se, 0, 0], [se, ce, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    slide = np.array([[cb, 0, sb, 0], [0, 1, 0, 0], [-sb, 0, cb, 0], [0, 0, 0, 1]])
    return T_base_torus @ swivel @ shift @ skew @ slide @ np.linalg.inv(T_sensor_carm)


def test_poses_equal_the_closed_form(machine):
    """One nominal geometry; the torus is carried along by the joints before the angular one."""
    urdf, chain = machine
    first = chain.angular
    geometry = nominal_geometry(chain)
    q = configurations(chain, 50)
    T = Model(urdf, chain).forward_kinematics(q)
    T_base_before, T_base_before_zero = np.broadcast_to(np.eye(4), (50, 4, 4)), np.eye(4)
    if first > 0:
        T_base_before = chain.joint_frames(q)[:, first - 1]
        T_base_before_zero = chain.joint_frames(np.zeros(len(chain.names)))[first - 1]
    T_before_torus = inverse(T_base_before_zero) @ geometry.T_base_torus
    for row, actual, T_base_torus in zip(q, T, T_base_before @ T_before_torus, strict=True):
        alpha, beta = row[chain.angular], row[chain.orbital]
        expected = closed_form(
            T_base_torus, geometry.major_radius, geometry.non_orthogonality, geometry.T_sensor_carm, alpha, beta
        )
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-12)


def test_poses_equal_the_chain(machine):
    urdf, chain = machine
    q = 3 * configurations(chain, 50, seed=1)
    np.testing.assert_allclose(
        Model(urdf, chain).forward_kinematics(q), chain.forward_kinematics(q), rtol=0, atol=1e-12
    )


def test_jacobian_equals_finite_differences(machine):
    urdf, chain = machine
    model = Model(urdf, chain)
    q, h = configurations(chain, 10, seed=2), 1e-5
    J = model.jacobian(q)
    assert J.shape == (10, 6, len(chain.names))
    T_inverse = inverse(model.forward_kinematics(q))
    for j, step in enumerate(h * np.eye(len(chain.names))):
        after, before = (log_se3(T_inverse @ model.forward_kinematics(q + s * step)) for s in (1, -1))
        np.testing.assert_allclose(J[:, :, j], (after - before) / (2 * h), rtol=0, atol=1e-9)


def test_placement_regressor_equals_finite_differences(machine):
    urdf, chain = machine
    q, h = configurations(chain, 10, seed=3), 1e-5
    K = Model(urdf, chain).placement_regressor(q)
    assert K.shape == (10, 6, 6 * len(chain.names))
    T_inverse = inverse(chain.forward_kinematics(q))
    for j in range(len(chain.names)):
        for k, xi in enumerate(h * np.eye(6)):
            ends = []
            for sign in (1, -1):
                placements = chain.placements.copy()
                placements[j] = placements[j] @ exp_se3(sign * xi)
                ends.append(log_se3(T_inverse @ replace(chain, placements=placements).forward_kinematics(q)))
            np.testing.assert_allclose(K[:, :, 6 * j + k], (ends[0] - ends[1]) / (2 * h), rtol=0, atol=1e-9)


def test_wrong_configurations_are_refused(machine):
    urdf, chain = machine
    model = Model(urdf, chain)
    for method in (model.forward_kinematics, model.jacobian, model.placement_regressor):
        with pytest.raises(InputError, match=f"7 joint values for {len(chain.names)} joints"):
            method(np.zeros((2, 7)))
    assert model.forward_kinematics(np.zeros(len(chain.names))).shape == (1, 4, 4)


def test_a_chain_of_another_file_is_refused(machine):
    urdf, chain = machine
    with pytest.raises(InputError, match="no link is named 'nowhere'; valid: "):
        Model(urdf, replace(chain, sensor_link="nowhere"))
    with pytest.raises(InputError, match="make the chain of this file"):
        Model(urdf, replace(chain, names=("other", *chain.names[1:])))


def test_a_missing_library_is_named(monkeypatch):
    urdf = read_urdf("mobile_skewed")
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    with pytest.raises(MissingDependencyError, match="pip install pin"):
        Model(urdf, chain_of(urdf))
    monkeypatch.setitem(sys.modules, "pinocchio", ModuleType("pinocchio"))
    with pytest.raises(MissingDependencyError, match="is not the kinematics library"):
        Model(urdf, chain_of(urdf))
