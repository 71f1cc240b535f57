"""Noise that differs by the tracker's axes: weights against a cost written out, shapes against the simulated ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carm_kin
from helpers.simulated import machine, problem, sweeps_deg
from solvers import kinematic
from solvers.likelihood.bound import cramer_rao
from solvers.likelihood.elimination import normal_equations
from solvers.likelihood.linearise import AngleModel, retract
from solvers.problem import NoiseShape
from solvers.torus import Torus

SIGMA = (2e-4, 1e-3)
MOTION = sweeps_deg((-30, -10, 10, 30), np.arange(0, 115, 1.5), (10, 50, 90), np.arange(-40, 40, 1.5))


def torus_of(truth) -> Torus:
    return Torus(truth.T_world_torus, truth.R, truth.epsilon, truth.T_sensor_carm, np.ones(1, bool), True)


def covariances(ratio: float, seed: int = 0) -> NoiseShape:
    """Along a random axis ``ratio`` times the noise across it; turns about it so much surer."""
    R = Rotation.random(random_state=seed).as_matrix()
    shapes = []
    for one in (ratio, 1 / ratio):
        variance = np.array([1.0, 1.0, one**2])
        shapes.append((R * (3 * variance / variance.sum())) @ R.T)
    return NoiseShape(*shapes)


def taken(seed: int, shape: NoiseShape, motion=MOTION):
    """A machine and poses with noise of the shape, which is of the tracker's frame."""
    truth = machine(seed, 0.1, np.radians(0.4))
    data = problem(truth, motion)
    rng = np.random.default_rng([seed, 3])
    shift, turn = (s * rng.normal(size=(len(data), 3)) for s in SIGMA)
    shift, turn = shift @ np.linalg.cholesky(shape.position).T, turn @ np.linalg.cholesky(shape.rotation).T
    R = Rotation.from_rotvec(turn).as_matrix() @ data.R_world_sensor
    blank = np.full_like(data.label, np.nan)
    return truth, replace(data, p_world_sensor=data.p_world_sensor + shift, R_world_sensor=R, label=blank)


def test_the_cost_and_its_gradient_are_those_of_the_covariances():
    shape = covariances(4.0)
    truth, data = taken(1, shape)
    data = replace(data, shape=shape, label=MOTION.angles, held=np.zeros_like(data.held))  # every angle is known
    torus, angles = torus_of(truth), MOTION.angles.T

    def cost(at: Torus) -> float:
        T = at.poses(angles.T, data.placement)
        e = data.p_world_sensor - T[:, :3, 3]
        w = Rotation.from_matrix(data.R_world_sensor @ T[:, :3, :3].swapaxes(1, 2)).as_rotvec()
        squares = [
            np.einsum("ni,ij,nj->", x, np.linalg.inv(S), x) / s**2
            for x, S, s in ((e, shape.position, SIGMA[0]), (w, shape.rotation, SIGMA[1]))
        ]
        return float(sum(squares))

    at = normal_equations(torus, angles, data, AngleModel.of(data), SIGMA)
    assert at.cost == pytest.approx(cost(torus), rel=1e-6)
    for k in range(14):
        step = 1e-6 * (np.arange(14) == k)
        slope = (cost(retract(torus, step)) - cost(retract(torus, -step))) / 4e-6
        assert at.g[k] == pytest.approx(slope, rel=2e-3, abs=0.02 * np.sqrt(at.H[k, k]))


def test_the_shape_is_found_and_the_estimate_gains():
    """Of eight machines: variances within a fifth, some 700 poses; error within the bound's, and less than without."""
    shape = covariances(5.0)
    found, blind, ratios = [], [], []
    for seed in range(8):
        truth, data = taken(seed, shape)
        estimate = kinematic.solve(data)
        assert estimate.shape is not None
        for S, true in ((estimate.shape.position, shape.position), (estimate.shape.rotation, shape.rotation)):
            assert np.linalg.eigvalsh(S)[[0, 2]] == pytest.approx(np.linalg.eigvalsh(true)[[0, 2]], rel=0.35)
            assert np.trace(S) == pytest.approx(3)
        assert estimate.sigma_t == pytest.approx(SIGMA[0], rel=0.1)
        bound = cramer_rao(torus_of(truth), MOTION.angles, replace(data, shape=shape), *SIGMA)
        off = estimate.offset - truth.offset
        found.append(off)
        ratios.append(off / np.sqrt(np.diag(bound.block("offset"))))
        rigid = kinematic.refine(data, estimate.torus, kinematic.Options(), False)
        blind.append(rigid.offset - truth.offset)
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.4  # 24 values: 1 within 2.8 of its standard errors
    assert np.linalg.norm(found) < np.linalg.norm(blind)


def test_isotropic_noise_stays_so():
    shape = NoiseShape(np.eye(3), np.eye(3))
    assert all(kinematic.solve(taken(seed, shape)[1]).shape is None for seed in range(12))


def test_few_poses_tell_no_shape():
    motion = sweeps_deg((-30, 30), np.arange(0, 115, 20), (50,), np.arange(-40, 40, 20))
    _, data = taken(2, covariances(2.0), motion)
    assert kinematic.solve(data).shape is None


def test_given_noise_is_taken_as_it_is():
    _, data = taken(3, covariances(5.0))
    assert kinematic.solve(replace(data, sigma_t=SIGMA[0], sigma_r=SIGMA[1])).shape is None


def test_a_result_tells_the_axes(tmp_path):
    recording, _ = carm_kin.simulate("mobile_nonisocentric", sigma_t_m=2e-4, sigma_r_rad=1e-3, anisotropy=4.0, seed=2)
    result = carm_kin.calibrate(recording)
    axes = result.noise.axes
    assert axes.translation_m[2] / axes.translation_m[0] == pytest.approx(4, rel=0.3)
    assert abs(axes.translation_axes_world[2][2]) > 0.98
    assert axes.rotation_rad[2] / axes.rotation_rad[0] == pytest.approx(4, rel=0.4)
    assert abs(axes.rotation_axes_world[0][2]) > 0.98
    result.to_json(tmp_path / "r.json")
    assert carm_kin.read_result(tmp_path / "r.json").to_json() == result.to_json()
    assert "along the tracker's axes" in str(result)


def test_simulated_noise_has_the_ratio():
    clean, _ = carm_kin.simulate("mobile_nonisocentric", "paper", seed=1)
    noisy, _ = carm_kin.simulate(
        "mobile_nonisocentric", "paper", sigma_t_m=1e-3, sigma_r_rad=1e-3, anisotropy=3.0, seed=1
    )
    off = (noisy.p_world_sensor - clean.p_world_sensor).std(axis=0)
    assert off[2] / off[:2] == pytest.approx([3, 3], rel=0.05)
    assert np.sqrt((off**2).mean()) == pytest.approx(1e-3, rel=0.03)
    turned = Rotation.from_matrix(noisy.R_world_sensor @ clean.R_world_sensor.swapaxes(1, 2)).as_rotvec().std(axis=0)
    assert turned[:2] / turned[2] == pytest.approx([3, 3], rel=0.05)
