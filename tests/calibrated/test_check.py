"""A saved calibration on a new recording: it passes, a bumped sensor fails, too little motion is refused."""

import json

import numpy as np
import pytest

import carm_kin
from carm_kin.calibrated.check import check
from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from carm_kin.results.result import CalibrationResult
from helpers.command import fails, run
from solvers.se3 import exp_se3

NOISE = {"sigma_t_m": 3e-4, "sigma_r_rad": 1e-3}
MM, DEG = 1e-3, np.radians(1.0)
BUMPS = {
    "3 mm along x": (3 * MM, 0, 0, 0, 0, 0),
    "3 mm along y": (0, 3 * MM, 0, 0, 0, 0),
    "3 mm along z": (0, 0, 3 * MM, 0, 0, 0),
    "1 deg about x": (0, 0, 0, DEG, 0, 0),
    "1 deg about y": (0, 0, 0, 0, DEG, 0),
    "1 deg about z": (0, 0, 0, 0, 0, DEG),
}


def recorded(machine: str = "mobile_skewed", bump=(0.0,) * 6, seed: int = 5, every: int = 8, **more) -> Recording:
    """A short recording: 180 poses, the base elsewhere."""
    mount = {"T_sensor_mount": exp_se3(np.array(bump, dtype=float))}
    recording, _ = carm_kin.simulate(machine, "minimal", seed=seed, **NOISE | mount | more)
    return recording.select(slice(None, None, every))


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> CalibrationResult:
    """As it comes back from its file."""
    path = tmp_path_factory.mktemp("saved") / "result.json"
    carm_kin.calibrate(carm_kin.simulate("mobile_skewed", "clinical", seed=1, **NOISE)[0]).to_json(path)
    return CalibrationResult.from_json(path)


@pytest.mark.parametrize("labels", [True, False])
@pytest.mark.parametrize("seed", range(5, 10))
def test_an_unchanged_machine_passes(saved, seed, labels):
    found = check(saved, recorded(seed=seed, labels=labels))
    assert found.status == "passed", found
    assert found.offset.difference_m < 4 * found.offset.sigma_m < 1e-3
    assert found.pose_position.difference_m < 3e-4
    assert (found.orbital_zero is None) == (not labels)
    assert [("slip" in words) for words in found.unseen] == ([] if labels else [True])


@pytest.mark.parametrize("labels", [True, False])
@pytest.mark.parametrize("bump", BUMPS)
def test_a_bumped_sensor_fails(saved, bump, labels):
    found = check(saved, recorded(bump=BUMPS[bump], labels=labels))
    assert found.status == "failed", found
    assert not found.offset.within
    assert found.failures[0].startswith("the offset differs by")


def test_the_tolerance_decides(saved):
    bumped = recorded(bump=BUMPS["3 mm along y"])
    assert check(saved, bumped, tolerance_m=5e-3).status == "passed"
    assert check(saved, bumped, tolerance_m=2e-3).status == "failed"


def test_another_machine_fails(saved):
    found = check(saved, recorded("mobile_nonisocentric"))
    assert found.status == "failed"
    assert not found.non_orthogonality.within


def test_a_slip_about_the_orbital_axis_is_seen_with_labels_alone(saved):
    """The carm frame turned about its y axis, 1 deg: neither the offset nor the axes change."""
    slip = saved.T_sensor_carm @ exp_se3(np.array([0, 0, 0, 0, DEG, 0])) @ np.linalg.inv(saved.T_sensor_carm)
    labelled, bare = (
        check(saved, recorded(T_sensor_mount=slip, labels=labels), sigma_label_rad=0.0) for labels in (True, False)
    )
    assert labelled.status == "failed"
    assert len(labelled.failures) == 1
    assert labelled.orbital_zero.difference_rad == pytest.approx(DEG, rel=0.05)
    assert bare.status == "passed"
    # whole degrees tell a zero to some 0.2 deg
    read = check(saved, recorded(T_sensor_mount=slip)).orbital_zero
    assert read.difference_rad == pytest.approx(DEG, rel=0.05)
    assert read.sigma_rad > 10 * labelled.orbital_zero.sigma_rad


def test_too_short_a_recording_is_refused(saved):
    whole = recorded(every=1)
    few = check(saved, whole.select(slice(0, 5)))
    orbital = check(saved, whole.select(whole.moving == "orbital").select(slice(0, 360)))
    short = check(saved, recorded(every=60, labels=False, sigma_t_m=2e-3))
    assert (few.status, few.refusal.code) == ("refused", "too_few_poses")
    assert (orbital.status, orbital.refusal.code) == ("refused", "one_axis_only")
    assert "both axes" in orbital.refusal.message
    assert (short.status, short.refusal.code) == ("refused", "too_uncertain"), short
    assert short.offset.within
    assert "the tolerance is 1 mm" in short.refusal.message


def test_outliers_do_not_fail_it(saved):
    found = check(saved, recorded(outliers=0.1))
    assert found.status == "passed"
    assert found.used < found.poses


def test_what_cannot_be_checked(saved):
    recording = recorded()
    for tolerance in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="tolerance_m must be"):
            check(saved, recording, tolerance_m=tolerance)
    with pytest.raises(InputError, match="no complete chain"):
        check(carm_kin.calibrate(recording, "surface"), recording)
    with pytest.raises(InputError, match="is refused"):
        check(carm_kin.calibrate(recording.select(slice(0, 4))), recording)


def test_the_command(saved, tmp_path, capsys):
    result, good, bad = (tmp_path / name for name in ("result.json", "good.csv", "bad.csv"))
    saved.to_json(result)
    carm_kin.write_recording(recorded(), good)
    carm_kin.write_recording(recorded(bump=BUMPS["3 mm along z"]), bad)
    passed = run(capsys, "check", result, good, "--json", "-")
    assert passed.status == 0
    assert "passed: " in passed.err
    data = json.loads(passed.out)
    assert (data["schema"], data["status"], data["tolerance_mm"]) == ("carm-kin/check/1", "passed", 1.0)
    assert data["offset"]["difference_mm"] < data["offset"]["limit_mm"]
    failed = run(capsys, "check", result, bad, "--json", tmp_path / "check.json")
    assert failed.status == 3
    assert failed.out.splitlines()[-1] == "failed: the saved calibration does not hold"
    assert failed.err.splitlines()[-1].startswith("failed: the offset differs by 3.0")
    assert json.loads((tmp_path / "check.json").read_text())["status"] == "failed"
    carm_kin.write_recording(recorded(every=1).select(slice(0, 300)), good)
    refused = run(capsys, "check", result, good)
    assert refused.status == 3
    assert refused.out.splitlines()[-1].startswith("refused: ")
    assert refused.err.splitlines()[-1].startswith("refused (one_axis_only)")
    carm_kin.write_recording(recorded(), good)
    assert run(capsys, "check", result, good).out.splitlines()[-1] == "passed: the saved calibration holds"
    assert "no such file" in fails(capsys, "check", tmp_path / "none.json", good)
    assert "tolerance_m must be" in fails(capsys, "check", result, bad, "--tolerance-mm", 0)
