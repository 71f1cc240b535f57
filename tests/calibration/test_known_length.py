"""A length that is known, against recordings of a tracker whose scale is wrong."""

from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from helpers.command import run

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
        assert getattr(result, f"{name}_m") == pytest.approx(getattr(truth, f"{name}_m"), rel=1e-4)
        assert getattr(result.sigma, f"{name}_m") is None
        assert name in result.fixed


def test_the_uncertainty_is_that_of_repeated_recordings():
    """By the machine's major radius, which is known to 0.3 mm: error over ± of 24 recordings."""
    ratios = []
    for seed in range(24):
        recording, truth = carm_kin.simulate("mobile_nonisocentric", sigma_t_m=5e-4, sigma_r_rad=2e-3, seed=seed)
        R = truth.major_radius_m * 1e3 + 0.3 * np.random.default_rng(seed).normal()
        result = carm_kin.calibrate(recording, known_length=f"major_radius:{R}+-0.3")
        inverse = np.linalg.inv(result.covariance.block("offset_sensor_pivot"))
        ratios.append(off(result, truth) @ inverse @ off(result, truth) / 3)
    assert 0.5 < np.mean(ratios) < 1.7  # chi-square of 72 over 72: 1 within 4 of its standard deviations


@pytest.mark.parametrize(
    "text, words",
    [
        ("400", "must be of the form"),
        ("bar:400", "neither a length nor one of major_radius, minor_radius"),
        ("0:400", "above 0"),
        ("400:400.8+-x", "must be of the form"),
        ("400:0.4", "a scale that no tracker has"),
        ("major_radius:800", "a scale that no tracker has"),
    ],
)
def test_bad_lengths(taken, text, words):
    with pytest.raises(carm_kin.InputError, match=words):
        carm_kin.calibrate(taken[0], known_length=text)


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
