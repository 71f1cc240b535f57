"""Labels of held joints as a user has them: a display's digits, flips, and displays that are off."""

from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.calibration.settings import Settings
from carm_kin.errors import InputError
from helpers.places import DATA

NOISE = {"sigma_t_m": 2e-4, "sigma_r_rad": 1.4e-3}
WRONG = DATA / "mutations" / "wrong_labels05.csv"
POSITIONER = DATA / "two-axis" / "positioner_readings.csv"


@pytest.fixture(scope="module")
def recording():
    return carm_kin.simulate("mobile_skewed", "clinical", seed=3, **NOISE)[0]


def test_a_display_that_flips_by_a_step_is_no_error(recording):
    flips = np.random.default_rng(1).integers(0, 2, len(recording))
    joints = {joint: np.radians(np.floor(np.degrees(v)) + flips) for joint, v in recording.joints.items()}
    found = carm_kin.calibrate(replace(recording, joints=joints))
    plain = carm_kin.calibrate(replace(recording, joints={}))
    off = np.abs(found.offset_sensor_pivot_m - plain.offset_sensor_pivot_m)
    assert (off < 0.1 * plain.sigma.offset_sensor_pivot_m).all()
    assert found.orbital_referenced


def test_labels_are_exact_on_request(recording):
    off = replace(recording, joints={j: v + np.radians(0.3) * np.sin(9 * v) for j, v in recording.joints.items()})
    exact, read = (carm_kin.calibrate(off, sigma_label_rad=sigma) for sigma in (0.0, None))
    assert exact.noise.translation_m > 1.5 * read.noise.translation_m
    assert {"labels_disagree"} & {note.code for note in read.warnings}


def test_what_goes_together():
    assert Settings(labels_exact=True).sigma_label_rad == 0
    assert Settings(sigma_label_deg=0.5).sigma_label_rad == pytest.approx(np.radians(0.5))
    assert Settings(labels_exact=True).command("a.csv").endswith("--labels-exact")
    with pytest.raises(InputError, match="contradict each other"):
        Settings(labels_exact=True, sigma_label_deg=0.5).check()
    with pytest.raises(InputError, match="chain takes labels as exact"):
        Settings(sigma_label_deg=0.5, urdf="mobile_skewed").check()


@pytest.mark.skipif(not WRONG.exists(), reason="the recordings of real trackers are not here")
def test_labels_that_are_all_off_by_half_a_degree():
    recording = carm_kin.read_recording(WRONG)
    found = carm_kin.calibrate(recording)
    plain = carm_kin.calibrate(replace(recording, joints={}))
    sigma = plain.sigma.offset_sensor_pivot_m
    assert (np.abs(found.offset_sensor_pivot_m - plain.offset_sensor_pivot_m) < 0.05 * sigma).all()
    off = found.offset_sensor_pivot_m - (0.13, 0.08, -0.7)
    inverse = np.linalg.inv(found.covariance.block("offset_sensor_pivot"))
    assert off @ inverse @ off < 16.3  # chi-square of three, exceeded once in a thousand
    assert "labels_disagree" in {note.code for note in found.warnings}


@pytest.mark.skipif(not POSITIONER.exists(), reason="the recordings of real trackers are not here")
def test_a_positioner_whose_readings_wander_within_its_sweeps():
    recording = carm_kin.read_recording(POSITIONER)
    stand = np.round(np.degrees(recording.joints["angular"]), 2).astype(str)
    swept = replace(recording, sweep=stand, moving=np.full(len(recording), "orbital"))
    assert np.ptp(recording.joints["angular"][stand == stand[0]]) > 0
    label = swept.sweep_labels["angular"]
    assert np.isfinite(label).all()
    found = carm_kin.calibrate(replace(recording, joints={}))
    read = carm_kin.calibrate(swept)
    assert (found.status, read.status) == ("ok", "ok")
    assert found.major_radius_interval_95_m[0] <= 0.58e-3 <= found.major_radius_interval_95_m[1]
    assert read.major_radius_interval_95_m[0] <= 0.58e-3 <= read.major_radius_interval_95_m[1]
    assert read.major_radius_m == pytest.approx(found.major_radius_m, abs=4 * found.sigma.major_radius_m)
