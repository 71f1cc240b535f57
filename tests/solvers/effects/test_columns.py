"""What each effect does to a pose, against poses of a machine and a tracker that have it."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.simulated import Machine, machine, problem, sweeps_deg
from solvers.effects.blocks import Blocks
from solvers.effects.columns import EFFECTS, PLAY_RAD, Scene
from solvers.likelihood.covariance import active_unknowns
from solvers.likelihood.linearise import linearise
from solvers.se3 import exp_se3, exp_so3, inverse
from solvers.torus import Torus

SIGMA = (2e-4, 1.4e-3)
MOTION = sweeps_deg((-30, 0, 30), np.arange(0, 115, 5.0), (10, 60), np.arange(-40, 40, 5.0))
N = len(MOTION.angles)
TIME_S = np.arange(N) / 20
TWO = np.arange(N) // 70


def torus_of(truth: Machine) -> Torus:
    placements = len(truth.T_world_torus)
    return Torus(truth.T_world_torus, truth.R, truth.epsilon, truth.T_sensor_carm, np.ones(placements, bool), True)


@pytest.fixture(scope="module")
def scene() -> Scene:
    truth = machine(4, 0.1, np.radians(0.4), placements=2)
    data = replace(problem(truth, replace(MOTION, placement=TWO)), time_s=TIME_S)
    angles = MOTION.angles.T
    blocks = Blocks.at(data, torus_of(truth), angles, SIGMA, active_unknowns(data, False))
    assert len(blocks.middle) == N
    return Scene(data, torus_of(truth), angles, SIGMA, blocks, 0.5)


def shown(scene: Scene, T) -> np.ndarray:
    """(6, B) residuals of poses T (N, 4, 4) to the machine without any effect, block by block."""
    data = replace(scene.problem, p_world_sensor=T[:, :3, 3], R_world_sensor=T[:, :3, :3])
    return linearise(scene.torus, scene.angles, data).residual[:, scene.blocks.middle]


def poses(scene: Scene) -> np.ndarray:
    return scene.torus.poses(scene.angles.T, scene.problem.placement)


def displaced(T, R, xi) -> np.ndarray:
    """Poses shifted and turned by xi (N, 6) in the axes of frames R (N, 3, 3)."""
    T = T.copy()
    T[:, :3, 3] += np.einsum("nij,nj->ni", R, xi[:, :3])
    T[:, :3, :3] = exp_so3(np.einsum("nij,nj->ni", R, xi[:, 3:])) @ T[:, :3, :3]
    return T


def R_carm(scene: Scene) -> np.ndarray:
    return poses(scene)[:, :3, :3] @ scene.torus.T_sensor_carm[:3, :3]


def legendre(time, order: int) -> np.ndarray:
    t = 2 * (time - time[0]) / (time[-1] - time[0]) - 1
    return (t, (3 * t**2 - 1) / 2, (5 * t**3 - 3 * t) / 2)[order - 1] / order


def compared(scene: Scene, name: str, column: int, T, rtol=1e-3, size=1e-5) -> None:
    """Of poses displaced by ``size`` times the column."""
    own = EFFECTS[name](scene).displacement[:, column]
    off = shown(scene, T) / size - own
    assert np.abs(off).max() < rtol * np.abs(own).max() + 1e-12


@pytest.mark.parametrize("axis", range(6))
def test_gravity_is_linear_in_the_vertical(scene, axis):
    """As the C and as the swivel see it; the columns span both, whatever the vertical."""
    up = np.array([0.3, -0.5, 0.8])
    of_swivel = np.einsum("nji,j->ni", exp_so3(np.outer(scene.angles[0], [1.0, 0, 0])), up)
    of_c = np.einsum("nji,nj->ni", exp_so3(np.outer(scene.angles[1], [0, 1.0, 0])), of_swivel)
    xi = np.zeros((N, 6))
    xi[:, axis] = 1e-5 * np.column_stack([of_swivel, of_c]) @ (1.0, -2.0, 0.5, 0.7, 0.1, -1.0)
    moved = shown(scene, displaced(poses(scene), R_carm(scene), xi))
    columns = EFFECTS["gravity"](scene).displacement.transpose(0, 2, 1).reshape(6 * N, -1)
    constants = np.zeros((6, N, 6))
    constants[np.arange(6), :, np.arange(6)] = 1.0  # the mean over the joints' ranges is the mount's
    A = np.column_stack([columns, constants.reshape(6 * N, 6)])
    left = moved.ravel() - A @ np.linalg.lstsq(A, moved.ravel(), rcond=1e-12)[0]
    assert np.abs(left).max() < 1e-4 * np.abs(moved).max()


@pytest.mark.parametrize("column", [0, 4, 9])
def test_deformation_is_a_smooth_twist_of_mean_zero(scene, column):
    own = EFFECTS["deformation"](scene).displacement[:, column]
    xi = np.zeros((N, 6))
    xi[scene.blocks.middle, column % 6] = 1e-5 * own[column % 6]
    compared(scene, "deformation", column, displaced(poses(scene), R_carm(scene), xi))


@pytest.mark.parametrize("name, axis", [("field", 0), ("field", 2), ("field", 4), ("marker", 1)])
def test_distortions_follow_the_place(scene, name, axis):
    """The first basis function, in the tracker's axes or in the C-arm's."""
    xi = np.zeros((N, 6))
    turned = axis if name == "field" else 3 + axis
    xi[scene.blocks.middle, turned] = 1e-5 * scene.over_places[0]
    frames = np.broadcast_to(np.eye(3), (N, 3, 3)) if name == "field" else R_carm(scene)
    compared(scene, name, axis, displaced(poses(scene), frames, xi))


@pytest.mark.parametrize("axis", [0, 5])
def test_backlash_is_taken_up_by_a_reversal(scene, axis):
    angle, state = scene.angles[1], np.zeros(N)
    for k in range(1, N):
        state[k] = np.clip(state[k - 1] + (angle[k] - angle[k - 1]) / (PLAY_RAD / 2), -1, 1)
    xi = np.zeros((N, 6))
    xi[:, axis] = 1e-5 * state
    compared(scene, "backlash", 6 + axis, displaced(poses(scene), R_carm(scene), xi))


@pytest.mark.parametrize("placement, order, axis", [(0, 1, 2), (1, 2, 3), (1, 3, 5)])
def test_drift_moves_the_base(scene, placement, order, axis):
    T_world_torus = np.tile(scene.torus.T_world_torus[scene.problem.placement], (1, 1, 1))
    here = np.flatnonzero(scene.problem.placement == placement)
    step = np.zeros((N, 6))
    step[here, axis] = 1e-5 * legendre(TIME_S[here], order)
    rest = inverse(T_world_torus) @ poses(scene)
    compared(scene, "drift", 24 * placement + 6 * (order - 1) + axis, T_world_torus @ exp_se3(step) @ rest)


@pytest.mark.parametrize("placement, axis", [(0, 1), (1, 3), (1, 4)])
def test_remounting_moves_the_sensor(scene, placement, axis):
    step = np.zeros((N, 6))
    step[scene.problem.placement == placement, axis] = 1e-5
    T_world_carm = poses(scene) @ scene.torus.T_sensor_carm
    T = T_world_carm @ inverse(scene.torus.T_sensor_carm @ exp_se3(step))
    compared(scene, "remounting", 6 * placement + axis, T)


def test_smoothing_cuts_corners():
    """A low pass of 50 ms on a joint that swings: beside the lag it is half its square of the acceleration."""
    rate, tau = 500.0, 0.05
    t = np.arange(0, 8, 1 / rate)
    angles = np.stack([np.full(len(t), 0.3), 0.9 * np.sin(2 * np.pi * t / 8)])
    truth = machine(4, 0.1, np.radians(0.4))
    p, gain = truth.poses(angles.T)[0], 1 - np.exp(-1 / (rate * tau))
    for k in range(1, len(p)):
        p[k] = p[k - 1] + gain * (p[k] - p[k - 1])
    some = np.arange(0, len(t), 25)
    motion = sweeps_deg((0,), np.arange(0, len(some), 1.0), (), np.zeros(0))
    data = replace(problem(truth, replace(motion, angles=angles[:, some].T)), time_s=t[some])
    torus = torus_of(truth)
    blocks = Blocks.at(data, torus, angles[:, some], SIGMA, active_unknowns(data, False))
    scene = Scene(data, torus, angles[:, some], SIGMA, blocks, 0.5)
    late = np.stack([angles[0, some], 0.9 * np.sin(2 * np.pi * (t[some] - tau) / 8)])
    column = EFFECTS["smoothing"](scene).displacement[:3, 0]
    line = linearise(torus, late, replace(data, p_world_sensor=p[some]))
    along = line.by_angle[:3, 1] / np.linalg.norm(line.by_angle[:3, 1], axis=0)
    across = [x - along * (along * x).sum(axis=0) for x in (line.residual[:3], tau**2 * column)]
    inner = slice(20, -20)
    assert np.abs(across[0] - across[1])[:, inner].max() < 0.1 * np.abs(across[1]).max()


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect(scene, name):
    found = EFFECTS[name](scene)
    assert found.displacement.shape == (6, len(found.kinds), len(scene.blocks.middle))
    assert np.isfinite(found.displacement).all()
    assert EFFECTS[name].__doc__
