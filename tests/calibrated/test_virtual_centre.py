"""Coupled scans made by Pinocchio from the URDF: the fixed point comes back within the bound, and none is made up."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.calibrated.virtual_centre import virtual_centre
from carm_kin.errors import InputError
from carm_kin.machine.chain import chain_of
from carm_kin.machine.kinematics import Model
from carm_kin.machine.urdf import read_urdf
from carm_kin.recording.recording import Recording
from carm_kin.results.parts import NoiseLevel
from carm_kin.results.result import CalibrationResult
from carm_kin.results.virtual_centre_result import VirtualCentre
from helpers.command import fails, run
from helpers.simulated import frame

MACHINE = "mobile_nonisocentric"
V = np.array([0.06, 0.0, 0.04])
SIGMA = (3e-4, 1e-3)
NOISE = {"sigma_t_m": SIGMA[0], "sigma_r_rad": SIGMA[1]}
FILE = read_urdf(MACHINE)
CHAIN = chain_of(FILE)
MODEL = Model(FILE, CHAIN)


def about_y(beta: np.ndarray) -> Rotation:
    return Rotation.from_rotvec(np.outer(beta, [0.0, 1.0, 0.0]))


def coupled(beta: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(N, 2) horizontal travel and lift, m: -(Ry(beta) v)_{x,z} + const."""
    turned = about_y(beta).apply(v)
    return np.array([0.0, 0.2]) - turned[:, [0, 2]]


def joints(beta: np.ndarray, travel: np.ndarray, alpha: float = 0.0) -> np.ndarray:
    q = np.zeros((len(beta), len(CHAIN.names)))
    q[:, CHAIN.index("angular")], q[:, CHAIN.index("orbital")] = alpha, beta
    q[:, [CHAIN.index("horizontal"), CHAIN.index("lift")]] = travel
    return q


def degrees(low: float, high: float, n: int) -> np.ndarray:
    return np.radians(np.linspace(low, high, n))


ARC = degrees(-40, 110, 76)


def recorded(
    q: np.ndarray, T_world_base: np.ndarray, seed: int | None = 0, mount: np.ndarray = np.eye(4), share: float = 1.0
) -> Recording:
    """With a share of the noise of `SIGMA`, without any where the seed is None."""
    T = T_world_base @ MODEL.forward_kinematics(q) @ mount
    p, R = T[:, :3, 3], T[:, :3, :3]
    if seed is not None:
        rng = np.random.default_rng([seed, 4])
        p = p + share * SIGMA[0] * rng.normal(size=p.shape)
        R = R @ Rotation.from_rotvec(share * SIGMA[1] * rng.normal(size=p.shape)).as_matrix()
    return Recording(p, R)


@pytest.fixture(scope="module")
def exact() -> CalibrationResult:
    """The truth as a calibration, world and base the same."""
    found = carm_kin.simulate(MACHINE, "minimal", T_world_torus=at_zero())[1]
    return replace(found, noise=NoiseLevel(*SIGMA, estimated=False))


def at_zero() -> np.ndarray:
    """T_base_torus of urdf/README.md: the axes' centre in the floor's frame, the C upright."""
    T = np.eye(4)
    T[:3, 3] = 1.4, 0.0, 0.95
    return T


def codes(found: VirtualCentre) -> list[str]:
    """Of the warnings; the truth has no covariance, which is always one of them."""
    (known, *rest) = [note.code for note in found.warnings]
    assert known == "no_saved_covariance"
    return rest


@pytest.mark.parametrize("beta", [ARC, degrees(-160, 160, 40)], ids=["150 deg", "320 deg"])
def test_a_scan_without_noise(exact, beta):
    travel = coupled(beta, V)
    scan = recorded(joints(beta, travel), np.eye(4), None)
    found = virtual_centre(exact, scan)
    assert found.status == "fixed"
    np.testing.assert_allclose(found.centre_carm_m, V, atol=1e-12)
    pivot = np.array([1.4, 0, 1.05]) + np.array([travel[0, 0], 0, travel[0, 1]])
    np.testing.assert_allclose(found.pivots_world_m[0], pivot, atol=1e-12)
    c = pivot + Rotation.from_euler("y", beta[0]).apply(V)
    np.testing.assert_allclose(found.centre_world_m, c, atol=1e-12)
    np.testing.assert_allclose(found.centres_world_m, np.tile(c, (len(beta), 1)), atol=1e-12)
    sensor = scan.R_world_sensor[5] @ found.centre_sensor_m + scan.p_world_sensor[5]
    np.testing.assert_allclose(sensor, c, atol=1e-12)
    np.testing.assert_allclose(found.beta_rad, beta, atol=1e-12)
    assert found.alpha_rad == pytest.approx(0, abs=1e-12)
    assert found.turn_rad == pytest.approx(np.ptp(beta), abs=1e-12)
    assert found.spread.rms_m < 1e-12


def test_the_path_of_the_rotation_centre(exact):
    """A circle about the virtual centre, and by its travel the joints that were moved."""
    travel = coupled(ARC, V)
    found = virtual_centre(exact, recorded(joints(ARC, travel), np.eye(4), None))
    assert found.path_radius_m == pytest.approx(np.hypot(0.06, 0.04))
    assert found.path_rms_m < 1e-12
    moved = found.travel_torus_m - found.travel_torus_m.mean(axis=0)
    np.testing.assert_allclose(moved[:, [0, 2]], travel - travel.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(moved[:, 1], 0, atol=1e-12)
    np.testing.assert_allclose(found.travel_torus_m[:, [0, 2]], travel - [0, 0.2], atol=1e-12)


def bound(beta: np.ndarray) -> np.ndarray:
    """Covariance (2, 2) of v_x, v_z by the Cramer-Rao bound, brute force: T_world_scan, T_sensor_scan and every
    beta_i unknown, derivatives by central differences; the pseudo-inverse passes over the conventions."""
    mount = np.linalg.inv(MODEL.forward_kinematics(np.zeros((1, len(CHAIN.names))))[0]) @ carm_at_zero()
    scan = mount.copy()
    scan[:3, 3] += mount[:3, :3] @ V

    def poses(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angles = beta + x[12:]
        where, inside = Rotation.from_rotvec(x[3:6]), Rotation.from_rotvec(x[9:12])
        turn = where * about_y(angles)
        R_sensor_scan = Rotation.from_matrix(scan[:3, :3]) * inside
        origin = scan[:3, 3] + scan[:3, :3] @ x[6:9]
        R = turn * R_sensor_scan.inv()
        return x[:3] - R.apply(origin), R.as_matrix()

    R0, h, columns = poses(np.zeros(12 + len(beta)))[1], 1e-6, []
    for e in np.eye(12 + len(beta)):
        (p1, R1), (p2, R2) = poses(h * e), poses(-h * e)
        turn = [Rotation.from_matrix(np.swapaxes(R0, 1, 2) @ R).as_rotvec() for R in (R1, R2)]
        rows = np.concatenate([(p1 - p2) / SIGMA[0], (turn[0] - turn[1]) / SIGMA[1]], axis=1)
        columns.append(rows.ravel() / (2 * h))
    J = np.stack(columns, axis=1)
    scale = np.linalg.norm(J, axis=0)
    C = np.linalg.pinv((J / scale).T @ (J / scale), rcond=1e-9, hermitian=True) / np.outer(scale, scale)
    return C[np.ix_([6, 8], [6, 8])]


def carm_at_zero() -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = 1.4, 0.0, 1.05
    return T


@pytest.mark.parametrize("beta", [ARC, degrees(-20, 40, 40)], ids=["150 deg", "60 deg"])
def test_the_error_is_that_of_the_bound(exact, beta):
    """400 scans: the mean square over the bound, of two components that hardly correlate, has the standard deviation
    sqrt(2 / 400) = 0.07 at most; bound at 3.5 of these. The sigmas are those of the bound to 3%."""
    C = bound(beta)
    q = joints(beta, coupled(beta, V))
    errors, sigmas = [], []
    for seed in range(400):
        found = virtual_centre(exact, recorded(q, np.eye(4), seed))
        errors.append((found.centre_carm_m - V)[[0, 2]])
        sigmas.append(found.sigma.centre_carm_m[[0, 2]])
        assert found.centre_carm_m[1] == found.sigma.centre_carm_m[1] == 0
    z2 = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(C), errors)
    assert z2.mean() / 2 == pytest.approx(1, abs=0.25)
    np.testing.assert_allclose(np.mean(sigmas, axis=0), np.sqrt(np.diagonal(C)), rtol=0.03)


@pytest.mark.parametrize("share", [1.0, 0.02])
def test_sigmas_include_the_calibration(share):
    """60 calibrations and scans, the scan's noise a ``share`` of the calibration's: the mean square of an error over
    its sigma has a standard deviation of sqrt(2 / 60) = 0.18; bound at 3.5 of these."""
    q, z = joints(ARC[::4], coupled(ARC[::4], V)), []
    for seed in range(60):
        recording, truth = carm_kin.simulate(MACHINE, "minimal", seed=seed, **NOISE)
        T_world_base = truth.placements[0].T_world_torus @ np.linalg.inv(at_zero())
        result = carm_kin.calibrate(recording.select(slice(None, None, 40)), systematic="none")
        scan = recorded(q, T_world_base, seed, share=share)
        found = virtual_centre(result, scan, sigma_t_m=share * SIGMA[0], sigma_r_rad=share * SIGMA[1])
        c = (T_world_base @ MODEL.forward_kinematics(q[:1])[0] @ truth.T_sensor_carm @ np.append(V, 1))[:3]
        s, sigma = (truth.T_sensor_carm @ np.append(V, 1))[:3], found.sigma
        z.append(
            np.concatenate(
                [
                    (found.centre_carm_m - V)[[0, 2]] / sigma.centre_carm_m[[0, 2]],
                    (found.centre_sensor_m - s) / sigma.centre_sensor_m,
                    (found.centre_world_m - c) / sigma.centre_world_m,
                    [(found.path_radius_m - np.linalg.norm(V)) / sigma.path_radius_m],
                ]
            )
        )
    np.testing.assert_allclose((np.array(z) ** 2).mean(axis=0), 1, atol=0.64)


def least_spread(alpha: float, v: np.ndarray) -> float:
    """Root mean square distance of the stillest point of the C when the travel of alpha = 0 is made at ``alpha``."""
    swivel = Rotation.from_euler("x", alpha)
    travel = coupled(ARC, v)
    pivot = np.stack([travel[:, 0], np.zeros(len(ARC)), travel[:, 1]], axis=1)

    def spread(x: np.ndarray) -> float:
        places = pivot + swivel.apply(about_y(ARC).apply([x[0], 0.0, x[1]]))
        return float(((places - places.mean(axis=0)) ** 2).sum(axis=1).mean())

    return float(np.sqrt(minimize(spread, v[[0, 2]], tol=1e-14).fun))


@pytest.mark.parametrize("seed", [None, 0, 1])
def test_where_the_coupling_does_not_hold(exact, seed):
    """At alpha = 30 deg the lift moves the C out of the plane of the orbit: told in mm, with every pose."""
    alpha = np.radians(30)
    found = virtual_centre(exact, recorded(joints(ARC, coupled(ARC, V), alpha), np.eye(4), seed))
    expected = least_spread(alpha, V)
    assert expected > 0.015
    assert found.status == "not_fixed"
    assert found.refusal is None
    assert found.sigma is None
    assert found.spread.probability < 1e-12
    off = np.linalg.norm(found.centres_world_m - found.centres_world_m.mean(axis=0), axis=1)
    assert found.spread.rms_m == pytest.approx(np.sqrt((off**2).mean()))
    assert found.spread.largest_m == pytest.approx(off.max())
    assert found.spread.largest_pose == off.argmax()
    if seed is None:
        assert found.spread.rms_m == pytest.approx(expected, rel=1e-5)
    else:
        assert found.spread.beyond_noise_m == pytest.approx(expected, rel=0.02)
    assert found.alpha_rad == pytest.approx(alpha, abs=1e-3)
    assert found.path_rms_m > 0.01
    moved = coupled(ARC, V) - coupled(ARC, V).mean(axis=0)
    told = found.travel_torus_m - found.travel_torus_m.mean(axis=0)
    np.testing.assert_allclose(
        told[:, [0, 2]], moved, atol=0 if seed is None else 5e-3, rtol=1e-9 if seed is None else 0
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_noise_alone_is_no_spread(exact, seed):
    found = virtual_centre(exact, recorded(joints(ARC, coupled(ARC, V)), np.eye(4), seed))
    assert found.status == "fixed"
    assert found.spread.probability > 1e-4
    assert found.spread.rms_m == pytest.approx(found.spread.noise_m, rel=0.2)
    assert codes(found) == []


def test_a_spread_within_the_tolerance(exact):
    """The lift is off by 1 mm at most: tolerated, warned of, and in the standard deviations."""
    travel = coupled(ARC, V)
    travel[:, 1] += 1e-3 * np.sin(4 * ARC)
    scan = recorded(joints(ARC, travel), np.eye(4))
    loose, strict = virtual_centre(exact, scan), virtual_centre(exact, scan, tolerance_m=1e-4)
    assert (loose.status, strict.status) == ("fixed", "not_fixed")
    assert codes(loose) == ["spread_beyond_noise"]
    assert loose.spread.beyond_noise_m == pytest.approx(1e-3 / np.sqrt(2), rel=0.3)
    clean = virtual_centre(exact, recorded(joints(ARC, coupled(ARC, V)), np.eye(4)))
    ratio = loose.sigma.centre_carm_m[0] / clean.sigma.centre_carm_m[0]
    assert ratio == pytest.approx(np.sqrt(loose.spread.chi2_per_dof), rel=1e-2)


@given(st.integers(0, 1000), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
@settings(max_examples=20)
def test_nothing_depends_on_the_frames(seed, x, z):
    """World and sensor moved, calibration and scan alike."""
    rng = np.random.default_rng(seed)
    M, X, v = frame(rng, 2.0), frame(rng, 0.3), np.array([x, 0.0, z])
    _, truth = carm_kin.simulate(MACHINE, "minimal", T_world_torus=M @ at_zero(), T_sensor_mount=X)
    scan = recorded(joints(ARC, coupled(ARC, v)), M, None, X)
    found = virtual_centre(truth, scan, **NOISE)
    np.testing.assert_allclose(found.centre_carm_m, v, atol=1e-10)
    place = M @ MODEL.forward_kinematics(joints(ARC[:1], coupled(ARC, v)[:1]))[0]
    carm = place @ X @ truth.T_sensor_carm
    np.testing.assert_allclose(found.centre_world_m, (carm @ np.append(v, 1))[:3], atol=1e-10)
    assert found.status == "fixed"
    np.testing.assert_allclose(found.travel_torus_m[:, [0, 2]], coupled(ARC, v) - [0, 0.2], atol=1e-10)


def test_the_base_may_have_moved(exact):
    """Travelled: nothing changes. Turned: the centre in the C-arm is the same, the angles are not told."""
    q = joints(ARC, coupled(ARC, V))
    shifted, turned = np.eye(4), np.eye(4)
    shifted[:3, 3] = 1.0, 2.0, 0.0
    turned[:3, :3] = Rotation.from_euler("z", 20, degrees=True).as_matrix()
    here, there, askew = (virtual_centre(exact, recorded(q, T, None)) for T in (np.eye(4), shifted, turned))
    np.testing.assert_allclose(there.beta_rad, here.beta_rad, atol=1e-12)
    np.testing.assert_allclose(there.travel_torus_m, here.travel_torus_m, atol=1e-9)
    np.testing.assert_allclose(askew.centre_carm_m, here.centre_carm_m, atol=1e-9)
    assert codes(askew) == ["base_turned"]
    assert askew.alpha_rad is askew.beta_rad is askew.travel_torus_m is None
    assert askew.status == "fixed"


def test_poses_that_are_left_out(exact):
    scan = recorded(joints(ARC, coupled(ARC, V)), np.eye(4))
    p, R = scan.p_world_sensor.copy(), scan.R_world_sensor.copy()
    p[20], R[20] = p[19], R[19]
    p[40] += 0.3
    R[40] = R[40] @ Rotation.from_euler("z", 20, degrees=True).as_matrix()
    found = virtual_centre(exact, Recording(p, R))
    assert found.status == "fixed"
    assert (found.poses, found.used) == (76, 74)
    assert {reason.indices for reason in found.outliers.reasons} == {(20,), (40,)}
    assert len(found.beta_rad) == len(found.used_poses) == 74
    assert {20, 40}.isdisjoint(found.used_poses)


def code(exact: CalibrationResult, scan: Recording) -> str:
    found = virtual_centre(exact, scan)
    assert (found.status, found.centre_carm_m, found.sigma, found.spread) == ("refused", None, None, None)
    return found.refusal.code


def test_scans_that_are_refused(exact):
    still, turned = np.zeros(76), degrees(-60, 60, 76)
    angular = joints(still, coupled(still, V))
    angular[:, CHAIN.index("angular")] = turned
    short = degrees(0, 0.5, 20)
    bumped = np.eye(4)
    bumped[:3, :3] = Rotation.from_euler("z", 5, degrees=True).as_matrix()
    scan = recorded(joints(ARC, coupled(ARC, V)), np.eye(4))
    assert code(exact, recorded(angular, np.eye(4))) == "axis_moves"
    assert code(exact, recorded(joints(ARC, coupled(ARC, V)), np.eye(4), 0, bumped)) == "axis_moves"
    assert code(exact, recorded(joints(still[:40], coupled(still[:40], V)), np.eye(4))) == "too_uncertain"
    assert code(exact, recorded(joints(short, coupled(short, V)), np.eye(4))) == "too_uncertain"
    assert code(exact, scan.select(slice(0, 5))) == "too_few_poses"
    assert code(exact, scan.select(slice(0, 0))) == "too_few_poses"


def test_what_cannot_be_asked(exact):
    scan = recorded(joints(ARC, coupled(ARC, V)), np.eye(4))
    for tolerance in (0.0, np.nan):
        with pytest.raises(InputError, match="tolerance_m must be"):
            virtual_centre(exact, scan, tolerance_m=tolerance)
    with pytest.raises(InputError, match="no placement 'x'"):
        virtual_centre(exact, scan, placement="x")
    with pytest.raises(InputError, match="has no orientations"):
        virtual_centre(exact, Recording(scan.p_world_sensor))
    with pytest.raises(InputError, match="at one placement of the base, not at a, b"):
        virtual_centre(exact, replace(scan, placement=["a", "b"] * 38))
    with pytest.raises(InputError, match="no complete chain"):
        virtual_centre(replace(exact, T_sensor_carm=None, solver="surface"), scan)


def test_the_placement_of_the_scan_is_its_own_label(exact):
    (one,) = exact.placements
    other = np.eye(4)
    other[:3, :3] = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    elsewhere = other @ one.T_world_torus
    two = replace(
        exact,
        placements=(
            replace(one, label="a"),
            replace(one, label="b", T_world_torus=elsewhere, angular_axis_world=elsewhere[:3, 0]),
        ),
    )
    scan = recorded(joints(ARC, coupled(ARC, V)), other)
    labelled = replace(scan, placement=["b"] * 76)
    assert virtual_centre(two, labelled).alpha_rad == pytest.approx(0, abs=1e-3)
    assert virtual_centre(two, labelled, placement="a").alpha_rad is None
    with pytest.raises(InputError, match="name a placement; the calibration has 'a', 'b'"):
        virtual_centre(two, scan)


def test_conventions_are_passed_on():
    recording, truth = carm_kin.simulate(MACHINE, "clinical", labels=False, **NOISE)
    T_world_base = truth.placements[0].T_world_torus @ np.linalg.inv(at_zero())
    found = virtual_centre(carm_kin.calibrate(recording), recorded(joints(ARC, coupled(ARC, V)), T_world_base))
    assert {note.code for note in found.warnings} == {"angular_zero_convention", "orbital_zero_convention"}
    assert found.path_radius_m == pytest.approx(np.linalg.norm(V), abs=5e-4)
    s = (truth.T_sensor_carm @ np.append(V, 1))[:3]
    np.testing.assert_allclose(found.centre_sensor_m, s, atol=1e-3)
    exact = replace(truth, noise=NoiseLevel(*SIGMA, False))
    assert virtual_centre(exact, recorded(joints(ARC, coupled(ARC, V)), T_world_base)).warnings[0].code == (
        "no_saved_covariance"
    )


def test_the_command(exact, tmp_path, capsys):
    result, good, bad, none = (tmp_path / name for name in ("result.json", "good.csv", "bad.csv", "none.csv"))
    exact.to_json(result)
    carm_kin.write_recording(recorded(joints(ARC, coupled(ARC, V)), np.eye(4)), good)
    carm_kin.write_recording(recorded(joints(ARC, coupled(ARC, V), 0.5), np.eye(4)), bad)
    carm_kin.write_recording(recorded(joints(ARC, coupled(ARC, V)), np.eye(4)).select(slice(0, 4)), none)
    fixed = run(capsys, "centre", result, good, "--json", "-")
    assert fixed.status == 0
    assert fixed.err.splitlines()[-1].startswith("fixed: ")
    data = json.loads(fixed.out)
    assert (data["schema"], data["status"]) == ("carm-kin/virtual-centre/1", "fixed")
    np.testing.assert_allclose(data["centre_carm_mm"], 1e3 * V, atol=0.5)
    assert len(data["centres_world_mm"]) == len(data["beta_deg"]) == 76
    assert data["turn_deg"] == pytest.approx(150, abs=1)
    moving = run(capsys, "centre", result, bad, "--json", tmp_path / "centre.json")
    assert moving.status == 3
    assert moving.out.splitlines()[-1] == "not fixed: no point of the C-arm stands still"
    assert moving.err.splitlines()[-1].startswith("not fixed: no point stands still: ")
    assert json.loads((tmp_path / "centre.json").read_text())["status"] == "not_fixed"
    refused = run(capsys, "centre", result, none)
    assert refused.status == 3
    assert refused.out.splitlines()[-1].startswith("refused: ")
    assert refused.err.splitlines()[-1].startswith("refused (too_few_poses)")
    assert run(capsys, "centre", result, good).out.splitlines()[-1].startswith("fixed: ")
    assert "tolerance_m must be" in fails(capsys, "centre", result, good, "--tolerance-mm", 0)
    assert "no placement 'b'" in fails(capsys, "centre", result, good, "--placement", "b")
    assert "--sigma-t-mm must be" in fails(capsys, "centre", result, good, "--sigma-t-mm", -1)
