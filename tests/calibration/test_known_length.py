"""A length that is known, against recordings of a tracker whose scale is wrong."""

from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from helpers.command import run
from helpers.pointers import pointer

SCALE = 1 / 1.002


@pytest.fixture(scope="module")
def taken():
    """A recording by a tracker that measures too short by 0.2%, and the truth."""
    recording, truth = carm_kin.simulate(
        "mobile_nonisocentric", sigma_t_m=2e-4, sigma_r_rad=1e-3, T_world_torus=np.eye(4), seed=3
    )
    return replace(recording, p_world_sensor=recording.p_world_sensor * SCALE), truth


def off(result, truth) -> np.ndarray:
    return result.offset_sensor_pivot_m - truth.offset_sensor_pivot_m


def test_without_it_the_offset_is_off_and_nothing_shows(taken):
    recording, truth = taken
    result = carm_kin.calibrate(recording)
    assert result.status == "ok"
    assert np.linalg.norm(off(result, truth)) > 1e-3


@pytest.mark.parametrize("form", ["400:{tracked}", "major_radius:{R}", "minor_radius:{b}"])
def test_each_form_sets_it_right(taken, form):
    recording, truth = taken
    text = form.format(tracked=400 * SCALE, R=truth.major_radius_m * 1e3, b=truth.minor_radius_m * 1e3)
    result = carm_kin.calibrate(recording, known_length=text)
    assert (np.abs(off(result, truth)) < 4 * result.sigma.offset_sensor_pivot_m).all()
    assert result.tracker_scale.scale == pytest.approx(1.002, abs=4 * result.tracker_scale.sigma + 1e-9)
    if "radius" in form:
        name = form.split(":")[0]
        assert getattr(result, f"{name}_m") == pytest.approx(getattr(truth, f"{name}_m"), rel=1e-6)
        assert getattr(result.sigma, f"{name}_m") is None
        assert name in result.fixed


def known(form: str, truth, rng) -> str:
    """A length that is known, drawn about the true one with the uncertainty that is stated."""
    if form == "gauge":
        return f"{400 + 0.2 * rng.normal()}:400+-0.2"
    length = getattr(truth, f"{form}_m") * 1e3
    return f"{form}:{length + 0.3 * rng.normal()}±0.3" if form == "minor_radius" else f"{form}:{length}"


@pytest.mark.parametrize("form", ["gauge", "major_radius", "minor_radius"])
def test_the_uncertainty_is_that_of_repeated_recordings(form):
    """Of 30 recordings: what the offset is off by, over its ±; and the scale, which is 1."""
    ratios, scales = [], []
    for seed in range(30):
        recording, truth = carm_kin.simulate("mobile_nonisocentric", sigma_t_m=5e-4, sigma_r_rad=2e-3, seed=seed)
        some = recording.select(np.arange(len(recording)) % 5 == 0)
        text = known(form, truth, np.random.default_rng(seed))
        result = carm_kin.calibrate(some, known_length=text, systematic="none")
        inverse = np.linalg.inv(result.covariance.block("offset_sensor_pivot"))
        ratios.append(off(result, truth) @ inverse @ off(result, truth) / 3)
        scales.append((result.tracker_scale.scale - 1) / result.tracker_scale.sigma)
    # chi-squares of 90 over 90 and of 30 over 30: 1 within 4 of their standard deviations
    assert 0.4 < np.mean(ratios) < 1.6
    assert 0.2 < np.mean(np.square(scales)) < 2.0


def test_the_parts_of_the_uncertainty_add_up(taken):
    recording, truth = taken
    result = carm_kin.calibrate(recording, known_length=f"major_radius:{truth.major_radius_m * 1e3}+-0.1")
    parts = sum(np.square(part.offset_sensor_pivot_m) for part in result.sigma_parts)
    np.testing.assert_allclose(np.sqrt(parts), result.sigma.offset_sensor_pivot_m, rtol=1e-3)
    assert result.sigma.major_radius_m == pytest.approx(1e-4)
    assert result.sigma_parts[-1].major_radius_m == pytest.approx(1e-4)


def test_what_is_told_in_part_bears_the_uncertainty_of_the_scale():
    spun = pointer("spun", 0)
    plain = carm_kin.calibrate(spun.recording, locus="point")
    result = carm_kin.calibrate(spun.recording, locus="point", known_length="400:400+-4")
    assert result.tracker_scale.sigma == pytest.approx(0.01)
    for one, before in zip(result.told.told, plain.told.told, strict=True):
        assert one.sigma_m == pytest.approx(np.hypot(before.sigma_m, 0.01 * before.offset_m))


def test_a_pointers_tip_by_a_gauge():
    one = pointer("cone", 0)
    short = replace(one.recording, p_world_sensor=one.recording.p_world_sensor / 1.02)
    result = carm_kin.calibrate(short, locus="point", known_length="102:100")
    assert (np.abs(result.offset_sensor_pivot_m - one.tip) < 4 * result.sigma.offset_sensor_pivot_m).all()
    assert [note.code for note in result.warnings] == ["tracker_scale"]


def test_what_is_done_with_such_a_result_is_in_its_scale(taken):
    """Held-out poses, and a check by a recording of the same tracker, miss by no more than without."""
    recording, _ = taken
    text = f"400:{400 * SCALE}"
    plain, known = (carm_kin.cross_validate(recording, 2, known_length=length).overall for length in (None, text))
    assert known.translation_rms_m == pytest.approx(plain.translation_rms_m * 1.002, rel=1e-3)
    result = carm_kin.calibrate(recording, known_length=text)
    assert carm_kin.check(result, recording, tolerance_m=5e-4).status == "passed"


def test_a_centre_is_in_the_scale_of_the_calibration(taken):
    recording, _ = taken
    orbital = next(sweep for sweep in recording.sweeps if sweep.moving == "orbital")
    scan = recording.select(np.isin(np.arange(len(recording)), orbital.poses))
    plain = carm_kin.virtual_centre(carm_kin.calibrate(recording), scan)
    known = carm_kin.virtual_centre(carm_kin.calibrate(recording, known_length="400:500"), scan)
    np.testing.assert_allclose(known.centre_world_m, 0.8 * plain.centre_world_m, atol=1e-4)


@pytest.mark.parametrize(
    "text, words",
    [
        ("400", "must be of the form"),
        ("bar:400", "neither a length nor one of major_radius, minor_radius"),
        (400.0, "must be of the form"),
        ("400:400.8+-", "must be of the form"),
        ("400:-400", "must be of the form"),
        ("0:400", "above 0"),
        ("1e999:400", "finite"),
        ("400:400.8+-x", "must be of the form"),
        ("400:0.4", "a scale that no tracker has"),
        ("major_radius:800", "a scale that no tracker has"),
    ],
)
def test_bad_lengths(taken, text, words):
    with pytest.raises(carm_kin.InputError, match=words):
        carm_kin.calibrate(taken[0], known_length=text)


def test_a_solver_without_an_uncertainty_takes_a_gauge_alone(taken):
    assert carm_kin.calibrate(taken[0], "closed_form", known_length="400:400").tracker_scale.scale == 1
    with pytest.raises(carm_kin.InputError, match="gives the minor radius no uncertainty"):
        carm_kin.calibrate(taken[0], "closed_form", known_length="minor_radius:700")


def test_a_length_that_the_poses_do_not_tell():
    recording, _ = carm_kin.simulate("mobile_isocentric", sigma_t_m=2e-4, sigma_r_rad=1e-3, seed=1)
    with pytest.raises(carm_kin.InputError, match="says nothing of the tracker's scale"):
        carm_kin.calibrate(recording, known_length="major_radius:80")


def test_the_command(taken, tmp_path, capsys):
    carm_kin.write_recording(taken[0], tmp_path / "r.csv")
    ended = run(
        capsys,
        "calibrate",
        tmp_path / "r.csv",
        "--known-length",
        f"400:{400 * SCALE}+-0.1",
        "--json",
        tmp_path / "r.json",
    )
    assert ended.status == 0
    assert "tracker's scale" in ended.out
    read = carm_kin.read_result(tmp_path / "r.json")
    assert read.tracker_scale.sigma == pytest.approx(1.002 * 0.1 / 400)
    assert read.sigma_parts[-1].cause == "scale"
    ended = run(capsys, "calibrate", tmp_path / "r.csv", "--known-length", "400")
    assert (ended.status, ended.err.count("\n")) == (2, 1)
    ended = run(capsys, "calibrate", tmp_path / "r.csv", "--locus", "point", "--known-length", "major_radius:80")
    assert ended.status == 2
    assert "has no major_radius" in ended.err
