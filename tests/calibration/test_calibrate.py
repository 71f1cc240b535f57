"""From a recording to a result: exact on exact data, the same whatever the labels, refused where it must be."""

from dataclasses import replace

import numpy as np
import pytest

import carm_kin
import solvers
from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from carm_kin.results.result import CalibrationResult
from solvers.se3 import exp_so3

MACHINES = "mobile_isocentric", "mobile_nonisocentric", "mobile_skewed"
EXACT_M = 1e-9
"""1e-6 mm."""
TAKES_ANY_MOTION = ("closed_form", "direct", "kinematic")
NOISE = {"sigma_t_m": 3e-4, "sigma_r_rad": 1e-3}


def options_for(solver: str, machine: str) -> dict[str, bool]:
    """What a solver must be told to model the machine."""
    return (
        {"fix_non_orthogonality": False}
        if machine == "mobile_skewed" and solver not in ("kinematic", "surface")
        else {}
    )


@pytest.fixture(scope="module")
def paper(tmp_path_factory) -> dict[str, tuple[Recording, CalibrationResult]]:
    """The paper's protocol without noise, each machine's recording once written and read."""
    folder, found = tmp_path_factory.mktemp("paper"), {}
    for k, machine in enumerate(MACHINES):
        recording, truth = carm_kin.simulate(machine, "paper", seed=k)
        carm_kin.write_recording(recording, folder / f"{machine}.csv")
        found[machine] = carm_kin.read_recording(folder / f"{machine}.csv"), truth
    return found


@pytest.fixture(scope="module")
def noisy() -> Recording:
    recording, _ = carm_kin.simulate("mobile_nonisocentric", "minimal", **NOISE, seed=5)
    return recording


def bare(recording: Recording, poses=slice(None), scale: float = 1.0) -> Recording:
    """Poses alone: no sweeps, no labels."""
    assert recording.R_world_sensor is not None
    return Recording(recording.p_world_sensor[poses] * scale, recording.R_world_sensor[poses])


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("solver", ["closed_form", "decomposed", "direct", "kinematic"])
def test_exact_data_give_the_exact_answer(solver, machine, paper):
    recording, truth = paper[machine]
    result = carm_kin.calibrate(recording, solver, **options_for(solver, machine))
    assert result.status == "ok"
    np.testing.assert_allclose(result.offset_sensor_pivot_m, truth.offset_sensor_pivot_m, rtol=0, atol=EXACT_M)
    assert result.major_radius_m == pytest.approx(truth.major_radius_m, abs=EXACT_M)
    assert result.minor_radius_m == pytest.approx(truth.minor_radius_m, abs=EXACT_M)
    assert result.axis_non_orthogonality_rad == pytest.approx(truth.axis_non_orthogonality_rad, abs=1e-8)
    np.testing.assert_allclose(result.orbital_axis_sensor, truth.orbital_axis_sensor, rtol=0, atol=1e-8)
    found, true = result.placements[0], truth.placements[0]
    np.testing.assert_allclose(found.torus_center_world_m, true.torus_center_world_m, rtol=0, atol=EXACT_M)
    np.testing.assert_allclose(found.angular_axis_world, true.angular_axis_world, rtol=0, atol=1e-8)


@pytest.mark.parametrize("machine", ["mobile_nonisocentric", "mobile_skewed"])
def test_labels_give_the_zeros_of_the_angles(machine, paper):
    recording, truth = paper[machine]
    result = carm_kin.calibrate(recording)
    assert result.orbital_referenced
    assert result.placements[0].referenced
    np.testing.assert_allclose(result.placements[0].T_world_torus, truth.placements[0].T_world_torus, atol=1e-8)
    np.testing.assert_allclose(result.T_sensor_carm, truth.T_sensor_carm, atol=1e-8)


@pytest.mark.parametrize("machine", ["mobile_isocentric", "mobile_nonisocentric"])
def test_the_surface_gives_the_radii_of_perpendicular_axes(machine, paper):
    recording, truth = paper[machine]
    result = carm_kin.calibrate(replace(recording, R_world_sensor=None), "surface")
    assert result.major_radius_m == pytest.approx(
        truth.major_radius_m, abs=1e-7 if machine == "mobile_isocentric" else EXACT_M
    )
    assert result.offset_sensor_pivot_m is None
    assert result.T_sensor_carm is None


@pytest.mark.parametrize("machine", MACHINES)
def test_neither_labels_nor_sweeps_nor_order_are_needed(machine, paper):
    recording, truth = paper[machine]
    shuffled = bare(recording, np.random.default_rng(0).permutation(len(recording))[:2000])
    for solver in TAKES_ANY_MOTION:
        result = carm_kin.calibrate(shuffled, solver, **options_for(solver, machine))
        np.testing.assert_allclose(result.offset_sensor_pivot_m, truth.offset_sensor_pivot_m, rtol=0, atol=EXACT_M)
        codes = [note.code for note in result.warnings]
        assert {"angular_zero_convention", "orbital_zero_convention"} <= set(codes)
        assert not result.orbital_referenced


@pytest.mark.parametrize("solver", solvers.solver_names())
def test_metres_and_millimetres_are_the_same(solver, noisy, tmp_path):
    text = {}
    for unit, scale in (("mm", 1000.0), ("m", 1.0)):
        file = tmp_path / f"{unit}.csv"
        carm_kin.write_recording(noisy, file)
        lines = file.read_text().splitlines()
        header, rows = lines[0].split(","), [line.split(",") for line in lines[1:]]
        given = 1.0 if "x_m" in header else 1e-3
        header = [
            f"{name[0]}_{unit}" if name in ("x_m", "y_m", "z_m", "x_mm", "y_mm", "z_mm") else name for name in header
        ]
        for row in rows:
            row[:3] = [repr(float(x) * given * scale) for x in row[:3]]
        file.write_text("\n".join(map(",".join, [header, *rows])) + "\n")
        text[unit] = carm_kin.calibrate(carm_kin.read_recording(file), solver)
    for name in ("offset_sensor_pivot_m", "major_radius_m", "minor_radius_m"):
        one, other = (getattr(result, name) for result in text.values())
        if one is None:
            assert other is None
        else:
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-8)


REFUSALS = {
    "orbital only": (lambda r: bare(r, slice(0, 360)), "one_axis_only"),
    "angular only": (lambda r: bare(r, slice(1080, 1440)), "one_axis_only"),
    "static": (lambda r: bare(r, np.zeros(50, dtype=int)), "one_axis_only"),
    "static with noise": (lambda r: _static(r), "one_axis_only"),
    "five poses": (lambda r: bare(r, slice(0, 1440, 300)), "too_few_poses"),
    "one pose": (lambda r: bare(r, slice(0, 1)), "too_few_poses"),
    "metres as millimetres": (lambda r: bare(r, scale=1e3), "misfit"),
    "base moved": (lambda r: _moved(r), "misfit"),
}


def _static(recording: Recording) -> Recording:
    rng = np.random.default_rng(0)
    one = bare(recording, np.zeros(50, dtype=int))
    return replace(one, p_world_sensor=one.p_world_sensor + 3e-4 * rng.normal(size=(50, 3)))


def _moved(recording: Recording) -> Recording:
    moved = bare(recording)
    shift = np.where(np.arange(len(moved)) < 720, 0.0, 0.1)[:, None]
    return replace(moved, p_world_sensor=moved.p_world_sensor + shift)


@pytest.mark.parametrize("solver", TAKES_ANY_MOTION)
@pytest.mark.parametrize("kind", REFUSALS)
def test_a_refusal_has_a_code_and_no_numbers(kind, solver, noisy):
    change, code = REFUSALS[kind]
    result = carm_kin.calibrate(change(noisy), solver)
    assert result.status == "refused"
    assert result.refusal is not None
    assert result.refusal.code == code
    assert result.refusal.message
    data = result.to_dict()
    for name in ("offset_sensor_pivot_mm", "major_radius_mm", "minor_radius_mm", "axis_non_orthogonality_deg"):
        assert data[name] is None
    assert data["orbital_axis_sensor"] is data["T_sensor_carm"] is data["covariance"] is None
    assert data["placements"] == []
    assert all(value in (None, []) for value in data["sigma"].values())


def test_a_refusal_says_what_is_unknown(noisy):
    words = carm_kin.calibrate(bare(noisy, slice(0, 360))).refusal
    assert words is not None
    assert "motion" in words.message
    assert "offset along the other axis" in words.message


def test_which_axis_did_not_move_is_named_where_the_labels_tell(noisy):
    words = carm_kin.calibrate(noisy.select(slice(0, 360))).refusal
    assert words is not None
    assert words.message.startswith("no angular motion")


def test_the_result_says_where_it_comes_from(tmp_path, noisy):
    carm_kin.write_recording(noisy, tmp_path / "rec.csv")
    recording = carm_kin.read_recording(tmp_path / "rec.csv")
    result = carm_kin.calibrate(recording, "decomposed", seed=4, command="carm-kin calibrate rec.csv")
    provenance = result.provenance
    assert (provenance.input_name, provenance.command, provenance.seed) == ("rec.csv", "carm-kin calibrate rec.csv", 4)
    assert recording.source is not None
    assert provenance.input_sha256 == recording.source.sha256
    assert {"python", "carm-kin", "numpy"} <= provenance.versions.keys()
    assert str(tmp_path) not in result.to_json()
    assert carm_kin.calibrate(noisy).provenance.input_sha256 is None


def test_residuals_stand_overall_and_per_sweep(noisy):
    result = carm_kin.calibrate(noisy)
    assert 3e-4 * np.sqrt(2) < result.residuals.translation_rms_m < 3e-4 * np.sqrt(3)
    assert [sweep.label for sweep in result.residuals_per_sweep] == [sweep.label for sweep in noisy.sweeps]
    assert all(sweep.poses == 360 for sweep in result.residuals_per_sweep)
    mean = np.mean([sweep.translation_rms_m**2 for sweep in result.residuals_per_sweep])
    assert np.sqrt(mean) == pytest.approx(result.residuals.translation_rms_m)
    assert result.noise.translation_m == pytest.approx(3e-4, rel=0.05)
    assert result.noise.rotation_rad == pytest.approx(1e-3, rel=0.05)
    assert result.noise.estimated


def test_given_noise_is_kept_and_misfit_to_it_refused(noisy):
    result = carm_kin.calibrate(noisy, sigma_t_m=3e-4, sigma_r_rad=1e-3)
    assert (result.status, result.noise.estimated) == ("ok", False)
    assert result.residuals.chi2_per_dof == pytest.approx(1, abs=0.1)
    refused = carm_kin.calibrate(noisy, sigma_t_m=3e-5, sigma_r_rad=1e-4)
    assert refused.refusal is not None
    assert refused.refusal.code == "misfit"


@pytest.mark.parametrize("solver", [name for name in solvers.solver_names() if name != "surface"])
def test_positions_alone_name_the_solver_that_takes_them(solver, noisy):
    with pytest.raises(InputError, match=r"no orientations.*use 'surface'"):
        carm_kin.calibrate(Recording(noisy.p_world_sensor), solver)


def test_unknown_names_come_with_the_valid_ones(noisy):
    with pytest.raises(InputError, match="it is one of chain, closed_form, decomposed, direct, kinematic"):
        carm_kin.calibrate(noisy, "bogus")
    with pytest.raises(InputError, match="needs the solver 'direct', not 'kinematic'"):
        carm_kin.calibrate(noisy, "kinematic", locus="point")
    with pytest.raises(InputError, match="no option 'bogus'; it has"):
        carm_kin.calibrate(noisy, "direct", bogus=1)


def test_a_placement_that_tells_nothing_is_left_out_and_listed():
    recording, _ = carm_kin.simulate("mobile_skewed", "clinical", seed=4, sigma_t_m=2e-4, sigma_r_rad=1.4e-3)
    orbital = next(sweep for sweep in recording.sweeps if sweep.moving == "orbital")
    alone = np.zeros(len(recording), dtype=bool)
    alone[orbital.poses] = True
    placement = np.where(alone, "elsewhere", "here")
    turned = exp_so3(np.array([0.0, 0.3, 0.0]))
    p = np.where(alone[:, None], recording.p_world_sensor @ turned.T, recording.p_world_sensor)
    R = np.where(alone[:, None, None], turned @ recording.R_world_sensor, recording.R_world_sensor)
    T = np.tile(np.eye(4), (len(recording), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, p
    found = carm_kin.calibrate(Recording.from_poses(T, placement=placement))
    rest = carm_kin.calibrate(Recording.from_poses(T[~alone], placement=placement[~alone]))
    assert found.status == "ok"
    np.testing.assert_array_equal(found.offset_sensor_pivot_m, rest.offset_sensor_pivot_m)
    assert [placement.label for placement in found.placements] == ["here"]
    assert found.poses == len(recording)
    assert set(np.flatnonzero(alone)) <= set(found.outliers.indices)
    assert np.isnan(found.angles_rad[alone]).all()
    assert np.isfinite(found.angles_rad[~alone]).all()
    assert "placement_left_out" in {note.code for note in found.warnings}
