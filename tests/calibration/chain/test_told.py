"""Joints of a chain that hardly moved are named and have no number; poses that are none of their own do not count."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carm_kin.calibration.chain.calibrate import calibrate_chain
from carm_kin.calibration.chain.told import at_rest
from carm_kin.recording.duplicates import COPIED
from helpers.chained import ARM_AXES, ARM_JOINTS, C_ARM, arm, kinematics, noisy, parsed, random_values, recorded, stand
from helpers.still import BOTH, poses
from solvers.chain.problem import ChainProblem

SIGMA_T, SIGMA_R = 0.2e-3, np.radians(0.1)
LITTLE = {"rest": 0.0, "wobble": np.radians(0.1), "short arc": np.radians(2.0)}


def of_arm(seed: int, arc: float, noise: float = np.radians(0.1)):
    """An arm whose third joint spans the ``arc``, all joints read with ``noise``, rad."""
    rng, q = np.random.default_rng([seed, 41]), random_values(ARM_JOINTS, 60, seed)
    q["j3"] = arc * (rng.random(60) - 0.5)
    T = noisy(stand(seed) @ kinematics(arm(), "tool", q), SIGMA_T, SIGMA_R, seed)
    return recorded(T, joints={name: v + noise * rng.normal(size=60) for name, v in q.items()})


@pytest.mark.parametrize("seed", range(10))
def test_a_joint_that_hardly_moves_is_named_and_has_no_number(seed):
    kind = list(LITTLE)[seed % 3]
    result = calibrate_chain(of_arm(seed, LITTLE[kind]), parsed(arm()), **ARM_AXES)
    assert result.status == "ok"
    assert "j3: at rest or hardly moved in all poses" in result.chain.not_identifiable
    names = {joint.joint for joint in result.chain.joints}
    assert "j3" not in names
    assert "j5" in names
    assert "change of j3" not in str(result)


def resting(q: np.ndarray, sigma_reading_deg: float | None = None) -> bool:
    """Whether a joint that is read as ``q`` (N,) counts as at rest, beside poses that turn at random."""
    n = len(q)
    T = noisy(np.tile(np.eye(4), (n, 1, 1)), 0.1, 1.0, 0)
    zeros, sigma = np.zeros(n, dtype=int), sigma_reading_deg and np.radians(sigma_reading_deg)
    held = np.full((n, 1), -1)
    problem = ChainProblem(T, zeros, zeros, held, q[:, None], np.array([False]), (None, None, sigma, None))
    return bool(at_rest(problem, q[:, None])[0])


def test_an_arc_is_held_against_the_noise_of_the_readings():
    """8 degrees are more than 10 times 0.3, and less than 10 times 1."""
    arc = np.radians(np.linspace(0, 8, 60))
    assert [resting(arc, sigma) for sigma in (None, 0.3, 1.0)] == [False, False, True]


def test_the_noise_of_readings_is_that_of_a_stream():
    """A joint at rest whose readings scatter by 0.45 deg does not span 4.5 deg; one that turns slowly by 6 deg does,
    with a noise of 0.3."""
    white = np.random.default_rng(0).normal(size=300)
    assert resting(np.radians(0.45) * white)
    assert not resting(np.radians(np.linspace(0, 6, 300) + 0.3 * white))
    assert resting(np.radians(np.linspace(0, 3, 300) + 0.3 * white))


def test_a_slide_that_travels_by_play_is_named():
    rng, q = np.random.default_rng(0), random_values(("angular", "orbital"), 80, 0)
    q["lift"] = 5e-3 * rng.random(80)
    T = noisy(stand(0) @ kinematics(C_ARM, "sensor", q), SIGMA_T, SIGMA_R, 0)
    given = recorded(T, joints=q, prismatic=frozenset({"lift"}))
    result = calibrate_chain(given, parsed(C_ARM), sigma_reading_m=0.0)
    assert "lift: at rest or hardly moved in all poses" in result.chain.not_identifiable
    assert "lift" not in {joint.joint for joint in result.chain.joints}


def test_copies_count_once():
    T = poses(BOTH, 0)
    once, twice = (calibrate_chain(recorded(part), parsed(C_ARM), free="axes") for part in (T, np.concatenate([T, T])))
    assert (twice.poses, twice.used) == (2 * len(T), once.used)
    assert [reason.reason for reason in twice.outliers.reasons] == [COPIED]
    assert "copied_poses" in {note.code for note in twice.warnings}
    np.testing.assert_allclose(twice.sigma.offset_sensor_pivot_m, once.sigma.offset_sensor_pivot_m)


def test_two_units_in_one_recording_are_refused():
    T = poses(BOTH, 0)
    T[:40, :3, 3] /= 10
    assert calibrate_chain(recorded(T), parsed(C_ARM), free="axes").refusal.code == "mixed_units"


def test_numbers_of_the_urdf_are_fixed():
    """R is the distance of the x axis from the line along the orbital axis, by the origin in the URDF's text."""
    result = calibrate_chain(recorded(poses(BOTH, 0)), parsed(C_ARM), free="none")
    across = np.cross([1, 0, 0], Rotation.from_euler("xyz", [0.01, 0, 0.005]).as_matrix()[:, 1])
    radius = abs(across @ [0.8, 0.02, 0.1]) / np.linalg.norm(across)
    assert {"major_radius", "axis_non_orthogonality"} <= set(result.fixed)
    assert result.sigma.major_radius_m is None
    assert f"{radius * 1e3:.3f} mm (fixed)" in str(result)
