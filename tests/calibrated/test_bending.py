"""A C that bends by a known function of its angles: what is said of a new recording, and of a scan."""

from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.calibrated.check import check
from carm_kin.results.parts import NoiseLevel, Placement
from helpers import bending
from helpers.command import run
from solvers.se3 import exp_se3

MM = 1e-3


@pytest.fixture(scope="module")
def exact():
    """The calibration without an error, its ± 0.1 mm an axis."""
    blank = carm_kin.calibrate(bending.recorded(bending.sweeps(), 1), systematic="none")
    T = bending.MACHINE.T_world_torus[0]
    known = replace(blank.covariance, matrix=1e-8 * np.eye(len(blank.covariance.names)))
    return replace(
        blank,
        T_sensor_carm=bending.mean_mount(),
        offset_sensor_pivot_m=bending.mean_mount()[:3, 3],
        major_radius_signed_m=bending.MACHINE.R,
        axis_non_orthogonality_rad=bending.MACHINE.epsilon,
        placements=(Placement("", T[:3, 3], T[:3, 0], T, True),),
        noise=NoiseLevel(bending.SIGMA_T, bending.SIGMA_R, estimated=False),
        covariance=known,
        deformation=bending.deformation(),
    )


def rigid(result):
    return replace(result, deformation=None)


@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_check_takes_the_deformation_out(exact, elsewhere):
    """Over half of the range the mean of the sag is another one; the saved numbers hold all the same."""
    again = bending.recorded(bending.sweeps((0, 55), (-55, 55)), 2, elsewhere)
    bent, stiff = check(exact, again), check(rigid(exact), again)
    assert bent.status == "passed", bent
    assert bent.offset.difference_m < 0.1 * MM
    assert bent.pose_position.difference_m < 0.3 * stiff.pose_position.difference_m
    assert stiff.offset.difference_m > 3 * bent.offset.difference_m
    assert bent.extrapolated == 0


def test_a_bumped_sensor_fails_beside_the_deformation(exact):
    poses = bending.recorded(bending.sweeps(), 3, elsewhere=True)
    T = poses.T_world_sensor @ exp_se3(np.array([3 * MM, 0, 0, 0, 0, 0]))
    found = check(exact, replace(poses, p_world_sensor=T[:, :3, 3]))
    assert found.status == "failed"
    assert found.offset.difference_m == pytest.approx(3 * MM, abs=0.2 * MM)


def test_poses_beyond_the_calibrated_angles_are_told(exact):
    """Held angles of 0, 22.5, 45 are within -60..60, those of 67.5 and 90 are not; of the moving ones a third."""
    within = check(exact, bending.recorded(bending.sweeps((0, 55)), 4), tolerance_m=3 * MM)
    motion = bending.sweeps((0, 90))
    beyond = check(exact, bending.recorded(motion, 4), tolerance_m=3 * MM)
    assert beyond.extrapolated == (motion.angles[:, 0] > np.radians(61)).sum()
    assert "extrapolated" in {note.code for note in beyond.warnings}
    assert "alpha -60 to 60 deg, beta -60 to 60 deg" in str(beyond)
    assert beyond.to_dict()["extrapolated"] == beyond.extrapolated
    assert beyond.pose_position.limit_m > within.pose_position.limit_m + 0.1 * MM
    assert "extrapolated" not in {note.code for note in within.warnings}


def test_without_a_zero_of_alpha_it_is_allowed_for(exact):
    """Where the base stood before, its zero is that of the calibration; elsewhere nothing tells it."""
    motion = bending.sweeps((0, 55), (-55, 55))
    here, there = (check(exact, bending.recorded(motion, 5, place, labels=False)) for place in (False, True))
    assert here.status == "passed"
    assert here.offset.difference_m < 0.1 * MM
    assert "deformation_not_applied" in {note.code for note in there.warnings}
    size = np.sqrt(
        (bending.shift_m(np.array([[n.alpha_rad, n.beta_rad] for n in exact.deformation.nodes])) ** 2).mean(0)
    )
    assert there.pose_position.limit_m == pytest.approx(MM + np.linalg.norm(size), abs=0.1 * MM)
    assert there.offset.sigma_m > size.max() / 3


def test_the_sigma_grows_beyond_the_nodes():
    bent = bending.deformation()
    middle, edge, near, far = (bent.sigma_m(np.radians([a]), np.zeros(1)) for a in (0.0, 60.0, 90.0, 170.0))
    np.testing.assert_allclose(edge, middle)
    assert (near > 1.5 * edge).all()
    assert (far > near).all()
    size = (np.array([node.shift_sensor_pivot_m for node in bent.nodes]) ** 2).mean(axis=0)
    np.testing.assert_allclose(near[0], np.sqrt(1e-8 + 2 * size * (1 - np.exp(-(np.radians(30) ** 2) / 4.5))))


def test_a_calibration_of_it_passes_its_own_check():
    """From poses to a saved calibration to a check, without a truth in between."""
    saved = carm_kin.calibrate(bending.recorded(bending.sweeps(), 1))
    again = bending.recorded(bending.sweeps((0, 55), (-55, 55)), 2, elsewhere=True)
    bent, stiff = (check(one, again, tolerance_m=3 * MM) for one in (saved, rigid(saved)))
    assert bent.status == "passed"
    assert bent.pose_position.difference_m < 0.7 * stiff.pose_position.difference_m
    assert bent.offset.difference_m < 0.7 * stiff.offset.difference_m


def test_the_virtual_centre_of_a_scan(exact):
    """alpha at 30 deg, the base at rest: the rotation centre stands still, on a stiff C by the sag it does not."""
    motion = bending.sweeps_deg((30,), np.linspace(-55, 55, 60), (), ())
    scan = bending.recorded(motion, 6)
    bent, stiff = (carm_kin.virtual_centre(one, scan) for one in (exact, rigid(exact)))
    assert bent.status == "fixed"
    assert (np.abs(bent.centre_carm_m) <= 4 * bent.sigma.centre_carm_m).all()
    assert np.linalg.norm(stiff.centre_carm_m) > 0.6 * MM
    assert bent.spread.beyond_noise_m < 0.3 * stiff.spread.beyond_noise_m
    pivot = bending.MACHINE.center[0] + bending.MACHINE.R * turned(np.radians(30), bending.MACHINE.T_world_torus[0])
    assert (np.abs(bent.centre_world_m - pivot) <= 4 * bent.sigma.centre_world_m).all()
    assert bent.sigma.centre_world_m.max() < 0.2 * MM
    far = carm_kin.virtual_centre(
        exact, bending.recorded(bending.sweeps_deg((80,), np.linspace(-55, 55, 60), (), ()), 7)
    )
    assert "extrapolated" in {note.code for note in far.warnings}


def turned(alpha: float, T: np.ndarray) -> np.ndarray:
    """The z axis of the swivel in the world."""
    return np.cos(alpha) * T[:3, 2] - np.sin(alpha) * T[:3, 1]


def test_the_command_tells_it(exact, tmp_path, capsys):
    exact.to_json(tmp_path / "r.json")
    carm_kin.write_recording(bending.recorded(bending.sweeps((0, 90)), 4), tmp_path / "new.csv")
    ended = run(capsys, "check", tmp_path / "r.json", tmp_path / "new.csv", "--tolerance-mm", 3)
    assert ended.status == 0, ended.err
    assert "warning (extrapolated): " in ended.err
