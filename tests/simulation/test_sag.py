"""The sag of whole machines, from recordings with and without it: its size, its gauge, its form."""

from pathlib import Path

import numpy as np
import pytest

import carm_kin
from carm_kin.errors import InputError
from carm_kin.machine.chain import chain_of, nominal_geometry
from carm_kin.machine.urdf import read_urdf
from carm_kin.simulation.sag import sag_of
from carm_kin.simulation.simulate import simulate
from solvers.se3 import exp_so3, inverse, log_so3, transform

MACHINE = "mini_boom"
ALPHA, BETA = np.linspace(-180, 180, 13), np.linspace(-75, 75, 13)
"""The joints' ranges, deg."""
PEAK_M = 2e-3


@pytest.fixture
def everywhere(tmp_path: Path) -> Path:
    """A protocol over a grid of the joints' ranges."""
    sweep = (
        '[[sweep]]\nmoving = "angular"\nfrom_deg = -180\nto_deg = 180\nstep_deg = 30\nheld_deg = {{ orbital = {} }}\n'
    )
    file = tmp_path / "everywhere.toml"
    file.write_text("".join(sweep.format(beta) for beta in BETA))
    return file


def seen_from_the_c(protocol: Path | str, machine: str = MACHINE, **sag: float) -> np.ndarray:
    """(N, 6) shift and turn of the sensor by the sag, in the C's frame."""
    rigid, truth = simulate(machine, protocol)
    bent, _ = simulate(machine, protocol, **sag)
    R = rigid.R_world_sensor @ truth.T_sensor_carm[:3, :3]
    shift = np.einsum("nji,nj->ni", R, bent.p_world_sensor - rigid.p_world_sensor)
    turn = log_so3(bent.R_world_sensor @ np.swapaxes(rigid.R_world_sensor, 1, 2))
    return np.hstack([shift, np.einsum("nji,nj->ni", R, turn)])


def test_the_greatest_shift_between_two_poses_is_the_peak(everywhere):
    shift = seen_from_the_c(everywhere, sag_m=PEAK_M)[:, :3]
    between = np.linalg.norm(shift[:, None] - shift, axis=-1)
    assert between.max() == pytest.approx(PEAK_M, rel=1e-9)


def test_a_part_of_the_range_has_a_part_of_the_sag(tmp_path):
    file = tmp_path / "part.toml"
    file.write_text('[[sweep]]\nmoving = "orbital"\nfrom_deg = -10\nto_deg = 10\n')
    shift = seen_from_the_c(file, sag_m=PEAK_M)[:, :3]
    between = np.linalg.norm(shift[:, None] - shift, axis=-1)
    assert 0.01 * PEAK_M < between.max() < 0.3 * PEAK_M


def test_the_mean_over_the_range_is_zero(everywhere):
    twist = seen_from_the_c(everywhere, sag_m=PEAK_M)
    assert np.abs(twist).max(axis=0).min() > 1e-5
    np.testing.assert_allclose(twist.mean(axis=0), 0, atol=1e-12)


def test_the_truth_is_that_of_the_mean_and_says_the_rest(everywhere):
    """Every pose from the truth's own numbers, by the formula of the design."""
    recording, truth = simulate(MACHINE, everywhere, sag_m=PEAK_M)
    _, rigid_truth = simulate(MACHINE, everywhere)
    np.testing.assert_array_equal(truth.T_sensor_carm, rigid_truth.T_sensor_carm)
    assert rigid_truth.deformation is None
    beta, alpha = (np.radians(x).ravel() for x in np.meshgrid(BETA, ALPHA, indexing="ij"))
    x, y, z = np.eye(3)
    R = exp_so3(alpha[:, None] * x)
    R_carm = R @ exp_so3(z * truth.axis_non_orthogonality_rad) @ exp_so3(beta[:, None] * y)
    carm = truth.placements[0].T_world_torus @ transform(R_carm, R @ (z * truth.major_radius_signed_m))
    T = carm @ inverse(truth.deformation.T_sensor_carm(truth.T_sensor_carm, alpha, beta))
    np.testing.assert_allclose(recording.p_world_sensor, T[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(recording.R_world_sensor, T[:, :3, :3], atol=1e-12)
    shifts = np.array([node.shift_sensor_pivot_m for node in truth.deformation.nodes])
    assert np.abs(shifts.mean(axis=0)).max() < 1e-3 * PEAK_M
    assert np.abs(shifts).max() > 0.1 * PEAK_M


def fourier(alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """(N, 9) products of 1, cos and sin: all that is linear in the vertical as seen from the C and from its swivel."""
    of_alpha, of_beta = ((np.ones_like(a), np.cos(a), np.sin(a)) for a in (alpha, beta))
    return np.stack([a * b for a in of_alpha for b in of_beta], axis=1)


@pytest.mark.parametrize("machine, sliding", [("mobile_3d", True), ("ring_gantry", False)])
def test_a_c_that_slides_in_its_carrier_is_not_linear_in_the_vertical(machine, sliding):
    recording, truth = simulate(machine, "free")
    twist = seen_from_the_c("free", machine, sag_m=PEAK_M)
    R = truth.placements[0].T_world_torus[:3, :3].T @ recording.R_world_sensor @ truth.T_sensor_carm[:3, :3]
    alpha, beta = np.arctan2(R[:, 2, 1], R[:, 1, 1]), np.arctan2(R[:, 0, 2], R[:, 0, 0])
    basis = fourier(alpha, beta)
    left = twist - basis @ np.linalg.lstsq(basis, twist, rcond=None)[0]
    share = np.linalg.norm(left[:, :3]) / np.linalg.norm(twist[:, :3])
    assert share > 0.03 if sliding else share < 1e-2


def test_a_machine_whose_other_joints_move_sags_too():
    """The cart turns and the lift rises, which the vertical does not see."""
    twist = seen_from_the_c("joints", "mobile_skewed", sag_m=PEAK_M)
    assert PEAK_M / 4 < np.linalg.norm(twist[:, :3], axis=1).max() < PEAK_M


def test_the_sag_scales_with_its_size(everywhere):
    one, three = (seen_from_the_c(everywhere, sag_m=size) for size in (1e-3, 3e-3))
    np.testing.assert_allclose(three, 3 * one, atol=1e-12)


def test_a_sensor_on_the_orbital_axis_rides_on_no_arc():
    mount = nominal_geometry(chain_of(read_urdf(MACHINE))).T_sensor_carm
    with pytest.raises(InputError, match="sag_m: the sensor is 0 mm from the axis"):
        simulate(MACHINE, sag_m=1e-3, T_sensor_mount=mount)


def test_virtual_axes_do_not_sag():
    with pytest.raises(InputError, match="sag_m and backlash_rad cannot be simulated with protocol 'virtual'"):
        simulate("robot_held", "virtual", sag_m=1e-3, backlash_rad=1e-3)


def test_the_isocentre_of_the_truth_wanders(tmp_path):
    _, truth = carm_kin.simulate(MACHINE, sag_m=PEAK_M)
    truth.to_json(tmp_path / "rec.truth.json")
    balls = carm_kin.isocentre(tmp_path / "rec.truth.json").balls
    assert 0.1 * PEAK_M < balls[-1].diameter_m < 2 * PEAK_M


def test_the_detector_hangs_down():
    """Whichever way up the C is, its weight moves the sensor's foot downwards, in the mean over all ways."""
    chain = chain_of(read_urdf(MACHINE))
    angles = np.radians([[-180.0, -75.0], [180.0, 75.0]])
    sag = sag_of(chain, [nominal_geometry(chain)], np.eye(4), angles, PEAK_M)
    up, across = np.vstack([np.eye(3), -np.eye(3)]), sag.sensor * (0.0, 1.0, 0.0)
    for beta in np.radians([-75.0, 0.0, 75.0]):
        shift, turn = np.split(sag.twist(up, np.full(6, beta)) + sag.mean, 2, axis=1)
        foot = shift - np.cross(turn, across)
        assert (foot * up).sum(axis=1).mean() < -1e-3 * PEAK_M
