"""Recordings in which one axis or none turned: every way to a number says what is told, and gives none that is not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.calibrated.check import check
from carm_kin.calibration.chain.calibrate import calibrate_chain
from carm_kin.results.result import CalibrationResult
from carm_kin.streams.estimate import current
from carm_kin.streams.live import Pose
from carm_kin.streams.marks import Marks
from helpers.chained import C_ARM, kinematics, parsed
from helpers.still import BOTH, UNTOLD, base, poses, recording

NUMBERS = (
    "offset_sensor_pivot_m",
    "major_radius_m",
    "minor_radius_m",
    "axis_non_orthogonality_rad",
    "orbital_axis_sensor",
    "T_sensor_carm",
    "covariance",
)
ALONE = [kind for kind in UNTOLD if "short arcs" not in kind and kind != "rest"]
SEEDS = range(10)
every_kind, every_seed = pytest.mark.parametrize("kind", UNTOLD), pytest.mark.parametrize("seed", SEEDS)


@pytest.fixture(scope="module")
def saved() -> CalibrationResult:
    return carm_kin.calibrate(recording(BOTH, 99))


def assert_nothing(result: CalibrationResult) -> None:
    assert result.refusal is not None
    assert [name for name in NUMBERS if getattr(result, name) is not None] == []
    assert result.placements == ()
    assert result.chain is None


def axis_of(kind: str, seed: int) -> np.ndarray:
    """(3,) the axis that turns, in the world, from a turn about it by half a radian."""
    turning = "angular" if kind.startswith("angular") else "orbital"
    R = kinematics(C_ARM, "sensor", {turning: np.array([0.0, 0.5])})[:, :3, :3]
    return 2 * base(seed)[:3, :3] @ Rotation.from_matrix(R[1] @ R[0].T).as_rotvec()


def stated(message: str, before: str) -> np.ndarray:
    """The direction (3,) whose words stand before ``before``."""
    words = message.split(f") {before}")[0].rsplit("(", 1)[1]
    found = np.array([float(x) for x in words.split(",")])
    return found / np.linalg.norm(found)


@every_kind
@every_seed
def test_a_chain_names_the_axis_that_turned(kind, seed):
    result = calibrate_chain(recording(kind, seed, read=seed % 2 == 0), parsed(C_ARM), free="axes")
    assert_nothing(result)
    assert result.refusal.code == "one_axis_only"
    if kind in ALONE:
        assert abs(stated(result.refusal.message, "in the world") @ axis_of(kind, seed)) > np.cos(np.radians(1.5))
    else:
        assert "no motion about any axis beyond 5 deg" in result.refusal.message


@every_kind
@every_seed
def test_a_surface_names_the_circle(kind, seed):
    result = carm_kin.calibrate(recording(kind, seed), "surface", max_iterations=20)
    assert_nothing(result)
    if kind in ALONE:
        assert "the positions lie on one circle" in result.refusal.message
        assert abs(stated(result.refusal.message, "in the world") @ axis_of(kind, seed)) > np.cos(np.radians(1.5))


@pytest.mark.parametrize("seed", SEEDS)
def test_two_axes_are_a_surface_and_a_chain(seed):
    given = recording(BOTH, seed, read=True)
    chain, surface = calibrate_chain(given, parsed(C_ARM), free="axes"), carm_kin.calibrate(given, "surface")
    assert (chain.status, surface.status) == ("ok", "ok")
    assert chain.major_radius_m == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize("kind", [*UNTOLD, BOTH])
def test_the_live_view_shows_numbers_of_what_is_told_alone(kind):
    for seed in SEEDS if kind == BOTH else (0, 5):
        now = current([Pose(T, Marks()) for T in poses(kind, seed)], 1000)
        assert (now.offset_m is None) == (now.swept_rad is None) == (now.refusal != "") == (kind != BOTH)
        assert kind not in ALONE or "one axis turned" in now.refusal or "one direction only" in now.refusal


@every_kind
@every_seed
def test_a_centre_is_given_where_the_orbital_axis_turned_alone(saved, kind, seed):
    """Beside a wobble or sag of the angular axis as well; not where that swept an arc of its own."""
    found = carm_kin.virtual_centre(saved, recording(kind, seed))
    if kind in ("orbital alone", "orbital, wobble", "orbital, jitter"):
        assert found.status == "fixed"
        assert np.linalg.norm(found.centre_carm_m) < 1e-3
        assert "0.000 mm (fixed)" in str(found)
    else:
        assert found.status == "refused"
        assert found.centre_carm_m is found.centre_sensor_m is found.centre_world_m is found.path_radius_m is None


def test_a_centre_counts_copies_once_and_refuses_two_units(saved):
    scan = recording("orbital alone", 0)
    p, R = scan.p_world_sensor, scan.R_world_sensor
    once = carm_kin.virtual_centre(saved, scan)
    twice = carm_kin.virtual_centre(saved, carm_kin.Recording(np.concatenate([p, p]), np.concatenate([R, R])))
    assert twice.used == once.used
    assert "copied_poses" in {note.code for note in twice.warnings}
    np.testing.assert_allclose(twice.sigma.centre_carm_m, once.sigma.centre_carm_m)
    p = p.copy()
    p[:40] /= 10
    assert carm_kin.virtual_centre(saved, carm_kin.Recording(p, R)).refusal.code == "mixed_units"


@pytest.mark.parametrize("seed", SEEDS)
def test_a_check_says_what_it_could_see(saved, seed):
    kind = UNTOLD[seed % len(UNTOLD)]
    found = check(saved, recording(kind, seed))
    assert found.status == "refused"
    assert found.unseen
    compared = {
        name for name in ("offset", "orbital_axis", "major_radius", "non_orthogonality") if getattr(found, name)
    }
    if kind not in ALONE:
        assert compared == set()
    elif kind.startswith("angular"):
        assert compared == {"major_radius", "non_orthogonality"}
        assert "the angular axis turned alone" in found.refusal.message
    else:
        assert compared == {"offset", "orbital_axis"}
        assert "the orbital axis turned alone" in found.refusal.message
        assert found.offset.difference_m < 1e-3


@pytest.mark.parametrize("kind", ["orbital alone", "angular alone"])
def test_a_check_fails_by_what_one_axis_tells(saved, kind):
    """The sensor was moved by 5 mm across the orbital axis, which moves the angular one as well, or turned."""
    T = poses(kind, 3)
    y = saved.orbital_axis_sensor
    bump = np.eye(4)
    bump[:3, 3] = 5e-3 * np.cross(y, [0, 0, 1]) / np.linalg.norm(np.cross(y, [0, 0, 1]))
    T = T @ bump
    found = check(saved, carm_kin.Recording(T[:, :3, 3], T[:, :3, :3]))
    assert found.status == ("failed" if kind.startswith("orbital") else "refused")
    assert (found.offset is None) == kind.startswith("angular")
