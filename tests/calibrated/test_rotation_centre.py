"""The calibrated C-arm in use against poses written out as rotations about two lines, brute force and Monte Carlo."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.calibrated.rotation_centre import RotationCentre
from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from carm_kin.results.parts import NoiseLevel, Placement
from carm_kin.results.result import CalibrationResult
from helpers.simulated import Machine, frame, machine, problem, small
from solvers.estimate import Covariance, Note

SIGMA = (3e-4, 1e-3)
SHAPES = st.sampled_from([(0.1, 0.0), (0.1, 0.012), (-0.1, 0.012), (0.0, 0.0), (0.0, -0.01), (1.2, 0.01)])
"""Spindle tori of either sign, spheres, a ring torus: R, epsilon."""


BLANK = carm_kin.simulate("mobile_skewed", "minimal")[1]


def calibrated(truth: Machine, labels: tuple[str, ...] = ("",)) -> CalibrationResult:
    """A calibration that is exact, its noise that of `SIGMA`."""
    return replace(
        BLANK,
        T_sensor_carm=truth.T_sensor_carm,
        major_radius_signed_m=truth.R,
        axis_non_orthogonality_rad=truth.epsilon,
        placements=tuple(
            Placement(label, T[:3, 3], T[:3, 0], T, True) for label, T in zip(labels, truth.T_world_torus, strict=True)
        ),
        noise=NoiseLevel(*SIGMA, estimated=False),
    )


def stacked(p: np.ndarray, R: np.ndarray) -> np.ndarray:
    T = np.tile(np.eye(4), (len(p), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, p
    return T


def some_angles(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (n, 2))


def disturbed(T: np.ndarray, size_m: float, size_rad: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng([seed, 8])
    turn = Rotation.from_rotvec(size_rad * rng.normal(size=(len(T), 3))).as_matrix()
    return stacked(T[:, :3, 3] + size_m * rng.normal(size=(len(T), 3)), T[:, :3, :3] @ turn)


def same_angles(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    assert np.abs(np.angle(np.exp(1j * (found - expected)))).max() < tolerance


@given(st.integers(0, 1000), SHAPES)
def test_exact_poses(seed, shape):
    truth, angles = machine(seed, *shape), some_angles(12, seed)
    T = stacked(*truth.poses(angles))
    found = RotationCentre(calibrated(truth)).locate(T)
    turn = Rotation.from_rotvec(angles[:, :1] * truth.n[0])
    pivot = truth.center[0] + turn.apply(truth.R * truth.T_world_torus[0, :3, 2])
    for pivots in (found.pivot_world_m, found.nearest.pivot_world_m):
        np.testing.assert_allclose(pivots, pivot, atol=1e-12)
    np.testing.assert_allclose(found.T_world_carm[:, :3, 1], T[:, :3, :3] @ truth.a, atol=1e-12)
    z = turn.apply(truth.T_world_torus[0, :3, 2])
    x = np.cross(found.T_world_carm[:, :3, 1], z)
    expected = np.cos(angles[:, 1:]) * z + np.sin(angles[:, 1:]) * x
    np.testing.assert_allclose(found.T_world_carm[:, :3, 2], expected, atol=1e-12)
    same_angles(found.nearest.alpha_rad, angles[:, 0], 1e-9)
    same_angles(found.nearest.beta_rad, angles[:, 1], 1e-9)
    np.testing.assert_allclose(found.nearest.T_world_sensor, T, atol=1e-10)
    assert max(found.nearest.distance_m.max(), found.nearest.distance_rad.max()) < 1e-9


def chi2_of(truth: Machine, T: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """(M,) for one pose T (4, 4) at angles (M, 2)."""
    p, R = truth.poses(angles)
    turn = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ T[:3, :3]).magnitude()
    return ((p - T[:3, 3]) ** 2).sum(axis=1) / SIGMA[0] ** 2 + (2 * np.sin(turn / 2)) ** 2 / SIGMA[1] ** 2


@pytest.mark.parametrize("shape", [(0.1, 0.012), (0.0, 0.0), (-0.1, 0.3), (1.2, 0.01)])
@pytest.mark.parametrize("off", [(0.01, 0.02), (0.5, 0.5), (1.0, 2.0)])
def test_a_pose_off_the_torus_goes_to_the_nearest_one(shape, off):
    """From a little to anywhere: nowhere on a grid of both angles is a nearer pose."""
    truth = machine(3, *shape)
    T = disturbed(stacked(*truth.poses(some_angles(6, 1))), *off)
    near = RotationCentre(calibrated(truth)).locate(T).nearest
    grid = np.stack(np.meshgrid(*[np.radians(np.arange(-180, 180, 3.0))] * 2), axis=-1).reshape(-1, 2)
    for k, pose in enumerate(T):
        at = np.array([near.alpha_rad[k], near.beta_rad[k]])
        assert near.chi2[k] == pytest.approx(chi2_of(truth, pose, at[None])[0], rel=1e-9)
        assert near.chi2[k] <= chi2_of(truth, pose, grid).min()
        step = 1e-4 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]])
        assert (chi2_of(truth, pose, at + step) > near.chi2[k]).all()
        p, R = truth.poses(at[None])
        assert near.distance_m[k] == pytest.approx(np.linalg.norm(p - pose[:3, 3]), rel=1e-9)
        turn = Rotation.from_matrix(R[0].T @ pose[:3, :3]).magnitude()
        assert near.distance_rad[k] == pytest.approx(turn, rel=1e-9)


def test_the_noise_decides_between_position_and_orientation():
    truth = machine(4, 0.1, 0.01)
    T = disturbed(stacked(*truth.poses(some_angles(20, 2))), 0.01, 0.01)
    result = calibrated(truth)
    coarse = RotationCentre(result, sigma_t_m=1.0, sigma_r_rad=1e-4).locate(T).nearest
    fine = RotationCentre(result, sigma_t_m=1e-5, sigma_r_rad=1.0).locate(T).nearest
    assert (coarse.distance_rad < fine.distance_rad).all()
    assert (coarse.distance_m > fine.distance_m).all()


def test_chi2_of_noise_has_four_degrees_of_freedom():
    """Mean of 4000 chi-squares: 4 with a standard deviation of sqrt(8 / 4000) = 0.045; bound at 5 of these."""
    truth = machine(5, 0.1, 0.01)
    T = disturbed(stacked(*truth.poses(some_angles(4000, 3))), *SIGMA)
    centre = RotationCentre(calibrated(truth))
    assert centre.locate(T).nearest.chi2.mean() == pytest.approx(4.0, abs=0.22)
    assert centre.locate_positions(T[:, :3, 3])[0].chi2.mean() == pytest.approx(1.0, abs=5 * np.sqrt(2 / 4000))


@given(st.integers(0, 1000), SHAPES)
@settings(max_examples=25)
def test_nothing_depends_on_the_frames(seed, shape):
    """The world moved, the sensor turned in its mount (noise is isotropic, so that no distance changes)."""
    truth = machine(seed, *shape)
    T = disturbed(stacked(*truth.poses(some_angles(8, seed))), 0.003, 0.01, seed)
    rng = np.random.default_rng(seed)
    M, X = frame(rng, 2.0), frame(rng, 0.0)
    moved = Machine(M @ truth.T_world_torus, truth.R, truth.epsilon, np.linalg.inv(X) @ truth.T_sensor_carm)
    here, there = RotationCentre(calibrated(truth)).locate(T), RotationCentre(calibrated(moved)).locate(M @ T @ X)
    np.testing.assert_allclose(M @ here.T_world_carm, there.T_world_carm, atol=1e-9)
    np.testing.assert_allclose(M @ here.nearest.T_world_carm, there.nearest.T_world_carm, atol=1e-7)
    same_angles(here.nearest.alpha_rad, there.nearest.alpha_rad, 1e-7)
    same_angles(here.nearest.beta_rad, there.nearest.beta_rad, 1e-7)
    np.testing.assert_allclose(here.nearest.chi2, there.nearest.chi2, rtol=1e-6)


@given(st.integers(0, 1000), SHAPES)
@settings(max_examples=25)
def test_the_sensor_may_be_moved_in_its_mount(seed, shape):
    """On the torus: the pivot is the same for every sensor."""
    truth = machine(seed, *shape)
    T, X = stacked(*truth.poses(some_angles(8, seed))), frame(np.random.default_rng(seed), 0.3)
    moved = replace(truth, T_sensor_carm=np.linalg.inv(X) @ truth.T_sensor_carm)
    found = RotationCentre(calibrated(moved)).locate(T @ X)
    np.testing.assert_allclose(
        found.nearest.T_world_carm, RotationCentre(calibrated(truth)).locate(T).T_world_carm, atol=1e-9
    )


def sensor_in_carm(truth: Machine) -> np.ndarray:
    return np.linalg.inv(truth.T_sensor_carm)[:3, 3]


@given(st.integers(0, 1000), st.sampled_from([0.1, -0.1, 0.0, 1.2]))
def test_the_second_solution_of_a_position(seed, R):
    """epsilon = 0: the two points of the profile circle at one x have u = R +- s and the distances sqrt(t_y^2 + u^2)
    from the angular axis."""
    truth, angles = machine(seed, R, 0.0), some_angles(12, seed)
    p, orientation = truth.poses(angles)
    first, second = RotationCentre(calibrated(truth)).locate_positions(p)
    found = RotationCentre(calibrated(truth)).locate(stacked(p, orientation))
    q = sensor_in_carm(truth)
    s = np.hypot(q[0], q[2]) * np.cos(angles[:, 1] + np.arctan2(q[0], q[2]))
    gap = np.abs(np.hypot(q[1], R + s) - np.hypot(q[1], R - s))
    assert first.distance_m.max() < 1e-7
    np.testing.assert_allclose(second.distance_m, gap, atol=1e-6)
    np.testing.assert_allclose(found.other.distance_m, gap, atol=1e-7)
    x = (found.other.T_world_sensor[:, :3, 3] - p) @ truth.n[0]
    assert np.abs(x).max() < 1e-12
    assert first.distance_rad is None


def test_an_isocentric_machine():
    """The zone |x| <= b of a sphere: the distance of a position is known in closed form, also where the two solutions
    meet at its edges, and the orientation chooses between them, however poor it is."""
    truth, angles = machine(3, 0.0, 0.0), some_angles(3000, 1)
    q = sensor_in_carm(truth)
    angles[:1000, 1] = np.pi / 2 - np.arctan2(q[0], q[2]) + 1e-4 * np.random.default_rng(1).normal(size=1000)
    T = stacked(*truth.poses(angles))
    p = disturbed(T, *SIGMA)[:, :3, 3]
    centre = RotationCentre(calibrated(truth), sigma_t_m=1e-4, sigma_r_rad=0.1)
    from_centre = p - truth.center[0]
    x, radius = from_centre @ truth.n[0], np.linalg.norm(from_centre, axis=1)
    edge = np.hypot(np.abs(x) - truth.b, np.linalg.norm(np.cross(from_centre, truth.n[0]), axis=1) - abs(q[1]))
    within = np.abs(x) * np.linalg.norm(q) / radius < truth.b
    expected = np.where(within, np.abs(radius - np.linalg.norm(q)), edge)
    assert 300 < (~within).sum() < 700
    first, second = centre.locate_positions(p)
    np.testing.assert_allclose(first.distance_m, expected, rtol=0, atol=3e-7)
    np.testing.assert_allclose(second.distance_m[within], expected[within], rtol=0, atol=1e-6)
    near = centre.locate(T[1000:]).nearest
    same_angles(near.alpha_rad, angles[1000:, 0], 1e-6)
    same_angles(near.beta_rad, angles[1000:, 1], 1e-6)


@pytest.mark.parametrize("epsilon", [0.0, 0.3])
def test_near_where_the_two_solutions_meet(epsilon):
    """A saddle lies between them, and the curvature is almost 0: the search gets there all the same."""
    truth, angles = machine(3, 0.0, epsilon), some_angles(2000, 2)
    q = sensor_in_carm(truth)
    angles[:, 1] = np.pi / 2 - np.arctan2(q[0], q[2]) + 0.03 * np.random.default_rng(0).normal(size=2000)
    first, second = RotationCentre(calibrated(truth)).locate_positions(truth.poses(angles)[0])
    assert max(first.distance_m.max(), second.distance_m.max()) < 1e-6


def test_positions_alone_find_the_pose():
    """Where R tells the two solutions apart, away from the circles x = +-b where they meet."""
    truth, angles = machine(6, 0.1, 0.01), some_angles(200, 6)
    p, R = truth.poses(angles)
    first, second = RotationCentre(calibrated(truth)).locate_positions(p)
    clear = second.distance_m > 1e-3
    assert clear.sum() > 150
    np.testing.assert_allclose(first.T_world_sensor[clear], stacked(p, R)[clear], atol=1e-7)


@pytest.mark.parametrize("R", [0.1, 0.0])
@pytest.mark.parametrize("sigma", [SIGMA, (3e-4, 2e-2)])
def test_sigmas_are_those_of_the_noise(R, sigma):
    """Standard deviations of 4000 draws: 1.1% uncertain themselves; bound at 5 of these. Where the positions tell the
    angles, the two are correlated."""
    truth = machine(7, R, 0.01)
    p, R_world_sensor = truth.poses(np.array([[-1.0216, 1.7306]]))
    pivot = p[0] + R_world_sensor[0] @ truth.offset
    T = disturbed(np.repeat(stacked(p, R_world_sensor), 4000, axis=0), *sigma)
    found = RotationCentre(calibrated(truth), sigma_t_m=sigma[0], sigma_r_rad=sigma[1]).locate(T)
    nearest = found.nearest.pivot_world_m - pivot
    for values, sigma in (
        (found.pivot_world_m - pivot, found.sigma_pivot_world_m),
        (found.nearest.alpha_rad[:, None], found.sigma_alpha_rad[:, None]),
        (found.nearest.beta_rad[:, None], found.sigma_beta_rad[:, None]),
    ):
        np.testing.assert_allclose(values.std(axis=0), sigma.mean(axis=0), rtol=0.056)
    if R == 0:
        assert np.abs(nearest).max() < 1e-12
        assert found.sigma_nearest_pivot_world_m.max() < 1e-12
    else:
        np.testing.assert_allclose(nearest.std(axis=0), found.sigma_nearest_pivot_world_m.mean(axis=0), rtol=0.056)


def test_sigmas_include_the_calibration():
    """Mean square of the pivot's error over its sigma, 200 calibrations with three correlated components each: the
    standard deviation of the mean is at most sqrt(2 / 200) = 0.1; bound at 4 of these."""
    truth = machine(8, 0.1, 0.01)
    at = np.array([[0.4, 0.9], [-1.1, 2.0]])
    exact, pivots = stacked(*truth.poses(at)), []
    measured, nearest = [], []
    for seed in range(200):
        data = problem(truth, small(), 1e-3, 2e-3, seed)
        result = carm_kin.calibrate(Recording(data.p_world_sensor, data.R_world_sensor), systematic="none")
        found = RotationCentre(result, sigma_t_m=1e-6, sigma_r_rad=2e-6).locate(exact)
        pivots = exact[:, :3, 3] + exact[:, :3, :3] @ truth.offset
        measured.append((found.pivot_world_m - pivots) / found.sigma_pivot_world_m)
        nearest.append((found.nearest.pivot_world_m - pivots) / found.sigma_nearest_pivot_world_m)
    for z in (measured, nearest):
        mean = (np.array(z) ** 2).mean(axis=(0, 2))
        assert (np.abs(mean - 1) < 0.4).all(), mean


def test_sigmas_of_a_calibration_are_those_of_finite_differences():
    """Any covariance of the unknowns (not of the zeros of the angles): what changes of the machine do to the pivots."""
    truth, h = machine(8, 0.1, 0.01), 1e-6
    T = stacked(*truth.poses(some_angles(4, 3)))
    root = 1e-3 * np.random.default_rng(3).normal(size=(14, 14))
    root[[3, 12]] = 0
    K = difference(lambda x: truth.moved(x).reported(), 14, h)
    names = [*xyz("offset_sensor_pivot"), "major_radius", "minor_radius", "axis_non_orthogonality"]
    names += [*xyz("orbital_axis_sensor"), *xyz("torus_center_world[0]"), *xyz("angular_axis_world[0]")]
    covariance = Covariance(tuple(names), K @ root @ root.T @ K.T)
    result = replace(calibrated(truth), covariance=covariance)
    found = RotationCentre(result, sigma_t_m=3e-8, sigma_r_rad=1e-7).locate(T)

    def pivots(x: np.ndarray) -> np.ndarray:
        here = RotationCentre(calibrated(truth.moved(x))).locate(T)
        return np.stack([here.pivot_world_m, here.nearest.pivot_world_m])

    J = difference(pivots, 14, h)
    expected = np.sqrt(((J @ root) ** 2).sum(axis=-1))
    np.testing.assert_allclose(found.sigma_pivot_world_m, expected[0], rtol=1e-3)
    np.testing.assert_allclose(found.sigma_nearest_pivot_world_m, expected[1], rtol=1e-3)


def difference(function: Callable[[np.ndarray], np.ndarray], size: int, h: float) -> np.ndarray:
    """Derivative by central differences at 0, the unknown last."""
    columns = [(function(h * e) - function(-h * e)) / (2 * h) for e in np.eye(size)]
    return np.stack(columns, axis=-1)


def xyz(name: str) -> list[str]:
    return [f"{name}_{axis}" for axis in "xyz"]


def test_the_placement_chooses_the_torus():
    truth = machine(9, 0.1, 0.01, placements=2)
    result = calibrated(truth, ("A", "B"))
    T = stacked(*truth.poses(some_angles(5, 1), 1))
    assert RotationCentre(result, "B").locate(T).nearest.distance_m.max() < 1e-9
    assert RotationCentre(result, "A").locate(T).nearest.distance_m.min() > 1e-2
    with pytest.raises(InputError, match="name a placement; the calibration has 'A', 'B'"):
        RotationCentre(result)
    with pytest.raises(InputError, match="no placement 'C'; the calibration has 'A', 'B'"):
        RotationCentre(result, "C")
    with pytest.raises(InputError, match="no placement 'C'; the calibration has one without a label"):
        RotationCentre(calibrated(machine()), "C")


def test_covariance_of_the_second_placement():
    """Nothing but the placement's own rows may enter: the first one's centre is made unknown."""
    recording, _ = carm_kin.simulate("mobile_skewed", "clinical", sigma_t_m=1e-3, sigma_r_rad=1e-3)
    two = Recording(
        recording.p_world_sensor, recording.R_world_sensor, placement=np.where(np.arange(len(recording)) % 2, "B", "A")
    )
    result = carm_kin.calibrate(two)
    C = result.covariance.matrix.copy()
    k = [result.covariance.names.index(f"torus_center_world[0]_{axis}") for axis in "xyz"]
    C[k, k] += 1.0
    vague = replace(result, covariance=replace(result.covariance, matrix=C))
    T = two.T_world_sensor[:3]
    sigma = {label: RotationCentre(vague, label).locate(T).sigma_nearest_pivot_world_m.max() for label in "AB"}
    assert sigma["B"] < 1e-3
    assert sigma["A"] > 0.5


def test_shapes():
    truth = machine(10)
    centre, T = RotationCentre(calibrated(truth)), stacked(*truth.poses(some_angles(3, 1)))
    assert centre.locate(T[0]).pivot_world_m.shape == (1, 3)
    assert centre.locate(T[:0]).nearest.chi2.shape == (0,)
    assert centre.locate_positions(T[0, :3, 3])[1].alpha_rad.shape == (1,)


@pytest.mark.parametrize(
    "T, words",
    [
        (np.full((2, 4, 4), np.nan), "not finite"),
        (np.eye(3), "is needed"),
        (np.stack([np.eye(4), np.diag([1, 1, -1, 1])]), "pose 1.*a reflection"),
        (np.stack([np.eye(4), np.diag([1, 1, 1, 2])]), "last row"),
        (np.diag([1, 2, 1, 1])[None], "not a rotation"),
        ([["a"]], "no array of numbers|not an array"),
        (0.0, "is needed"),
    ],
)
def test_poses_that_are_none(T, words):
    with pytest.raises(InputError, match=words):
        RotationCentre(calibrated(machine())).locate(T)


def test_calibrations_that_cannot_be_used():
    good = calibrated(machine())
    refused = replace(good, status="refused", refusal=Note("misfit", "it is none"))
    for result, words in (
        (refused, r"refused \(misfit\)"),
        (replace(good, T_sensor_carm=None, solver="surface"), "no complete chain"),
        (replace(good, noise=NoiseLevel(None, 1e-3, False)), "tells no noise: give sigma_t_m"),
    ):
        with pytest.raises(InputError, match=words):
            RotationCentre(result)
    for value in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="sigma_r_rad must be"):
            RotationCentre(good, sigma_r_rad=value)
    with pytest.raises(InputError, match="not finite"):
        RotationCentre(good).locate_positions([[0, 0, np.inf]])
