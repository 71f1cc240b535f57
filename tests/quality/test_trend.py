"""Trends of made results, by hand: the order, what counts, the statuses, the files, the command."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.results.parts import Sigma
from helpers.command import fails, run
from solvers.estimate import Note

SIGMA_M = 1e-4
OFFSETS_MM = (0.05, -0.05, 0.02, -0.03, 0.01, 0.0)
"""Along x, of the results of a sound machine, one a month."""


@pytest.fixture(scope="module")
def base() -> carm_kin.CalibrationResult:
    _, truth = carm_kin.simulate("mobile_skewed", "minimal", seed=0)
    sigma = Sigma(np.full(3, SIGMA_M), SIGMA_M, SIGMA_M, 1e-4)
    return replace(truth, sigma=sigma, covariance=None, solver="kinematic")


def made(base, month: int, x_mm: float = 0.0, R_mm: float = 0.0, skew_deg: float = 0.0, **more):
    """A calibration of that month, its numbers moved."""
    moved = {
        "offset_sensor_pivot_m": base.offset_sensor_pivot_m + np.array([x_mm / 1e3, 0, 0]),
        "major_radius_m": base.major_radius_m + R_mm / 1e3,
        "axis_non_orthogonality_rad": base.axis_non_orthogonality_rad + np.radians(skew_deg),
        "provenance": replace(base.provenance, date=f"2024-{month:02d}-01T08:00:00+00:00", input_sha256=f"{month}"),
    }
    return replace(base, **(moved | more))


def refused(base, month: int):
    none = dict.fromkeys(("offset_sensor_pivot_m", "major_radius_m", "minor_radius_m", "major_radius_signed_m"))
    none |= dict.fromkeys(("axis_non_orthogonality_rad", "orbital_axis_sensor", "T_sensor_carm", "covariance"))
    why = Note("too_few_poses", "three poses")
    return made(base, month, **none, sigma=Sigma(), placements=(), status="refused", refusal=why)


def sound(base, *latest, **more):
    """The trend of a sound machine and of what follows."""
    return carm_kin.trend([*(made(base, k + 1, x) for k, x in enumerate(OFFSETS_MM)), *latest], **more)


def chart(trend, quantity):
    return next(one for one in trend.charts if one.quantity == quantity)


def test_a_sound_machine_passes(base):
    found = sound(base)
    assert (found.status, found.baseline, found.warnings) == ("pass", 5, ())
    assert [one.status for one in found.results] == ["baseline"] * 5 + ["pass"]
    offset = chart(found, "offset, x")
    assert offset.reference == pytest.approx(base.offset_sensor_pivot_m[0], abs=1e-9)
    assert offset.limits.note[-1] == pytest.approx(2 * SIGMA_M * np.sqrt(1.2), rel=1e-4)
    assert offset.statuses == ()
    assert chart(found, "change of the offset").values[0] == pytest.approx(5e-5)


CHANGES = {
    "note": ({"x_mm": 0.35}, "note", "change of the offset 0.350 mm, beyond 0.310 (note)"),
    "alert": ({"x_mm": -0.6}, "alert", "change of the offset 0.600 mm"),
    "fail": ({"x_mm": 1.2}, "fail", "change of the offset 1.200 mm, beyond 1.000 (fail)"),
    "radius": ({"R_mm": -0.4}, "alert", "major radius -0.400 mm, beyond 0.329 (alert)"),
    "skew": ({"skew_deg": 0.6}, "fail", "non-orthogonality +0.600 deg, beyond 0.500 (fail)"),
}


@pytest.mark.parametrize("case", CHANGES)
def test_a_change_is_told_with_its_limit(case, base):
    change, status, reason = CHANGES[case]
    found = sound(base, made(base, 7, **change))
    assert found.status == found.results[-1].status == status
    assert reason in found.verdict
    assert found.verdict in str(found)
    assert all(one.status in ("baseline", "pass") for one in found.results[:-1])


def test_twice_beyond_the_note_limit_is_an_alert(base):
    found = sound(base, made(base, 7, R_mm=0.25), made(base, 8), made(base, 9, R_mm=0.25))
    assert [one.status for one in found.results[5:]] == ["pass", "note", "pass", "alert"]
    assert "beyond 0.219, for the second time in three results (alert)" in found.verdict


def test_the_latest_decides(base):
    found = sound(base, made(base, 7, x_mm=3), made(base, 8))
    assert [one.status for one in found.results[-2:]] == ["fail", "pass"]
    assert found.status == "pass"


def test_a_tolerance_fails_whatever_the_deviation(base):
    assert sound(base, made(base, 7, x_mm=0.3), tolerance_m=0.25e-3).status == "fail"
    assert sound(base, made(base, 7, x_mm=1.9), tolerance_m=2e-3).status == "alert"
    assert sound(base, made(base, 7, skew_deg=0.02), tolerance_rad=np.radians(0.01)).status == "fail"


def test_the_order_is_that_of_the_dates_in_their_time_zones(base):
    first, second = (made(base, 1, x) for x in (0.0, 0.1))
    first = replace(first, provenance=replace(first.provenance, date="2024-01-01T01:00:00+02:00", input_sha256=None))
    second = replace(second, provenance=replace(second.provenance, date="2024-01-01T00:00:00Z", input_sha256=None))
    found = carm_kin.trend({"second": second, "first": first})
    assert [one.label for one in found.results] == ["first", "second"]


def test_what_says_nothing_is_passed_over(base):
    no_sigma = made(base, 9, sigma=Sigma())
    again = made(base, 10, provenance=made(base, 3).provenance)
    found = sound(base, refused(base, 7), made(base, 8), no_sigma, again)
    assert {(one.label, one.reason) for one in found.passed_over} == {
        ("result 7", "refused (too_few_poses)"),
        ("result 9", "the offset has no ±"),
        ("result 10", "the same recording as result 3"),
    }
    assert len(found.results) == 7
    assert "passed over: refused (too_few_poses)" in str(found)


def test_quantities_that_are_not_in_every_result_are_left_out(base):
    found = sound(base, made(base, 7, minor_radius_m=None, sigma=replace(base.sigma, axis_non_orthogonality_rad=0.0)))
    assert [one.quantity for one in found.charts] == [
        "change of the offset", "offset, x", "offset, y", "offset, z", "major radius",
    ]  # fmt: skip


def test_the_skew_is_counted_in_the_sense_of_a_positive_radius(base):
    turned = {"major_radius_signed_m": -base.major_radius_m, "axis_non_orthogonality_rad": -1e-3}
    found = sound(made(base, 1, axis_non_orthogonality_rad=1e-3), made(base, 8, **turned))
    assert chart(found, "non-orthogonality").values[-1] == pytest.approx(1e-3)
    near_zero = made(base, 8, major_radius_m=1e-5, major_radius_signed_m=1e-5)
    assert not any(one.quantity == "non-orthogonality" for one in sound(base, near_zero).charts)


def test_what_weakens_a_trend_is_warned_of(base):
    def codes(found):
        return [note.code for note in found.warnings]

    assert codes(carm_kin.trend([made(base, 1), made(base, 2)])) == ["short_baseline"]
    assert codes(sound(base, made(base, 7, solver="surface"))) == ["several_solvers"]
    wild = carm_kin.trend([made(base, k + 1, 10 * x) for k, x in enumerate(OFFSETS_MM)])
    assert codes(wild) == ["baseline_scatters"]
    assert "offset, x by 0.400 mm, one sigma, where 0.100 mm is stated" in wild.warnings[0].message
    assert chart(wild, "offset, x").scatter > 2e-4


MISTAKES = {
    "one": (lambda b: [made(b, 1)], {}, "two results with an offset at least, not 1"),
    "one and a refused one": (lambda b: [made(b, 1), refused(b, 2)], {}, "not 1; result 2: refused"),
    "a single path": (lambda b: "a.json", {}, "several calibrations .* is needed, not a str"),
    "no calibration": (lambda b: [3, 4], {}, "a calibration .* is needed, not 3"),
    "a long baseline": (lambda b: [made(b, 1), made(b, 2)], {"baseline": 2}, "leaves none of 2 results to judge"),
    "a tolerance of 0": (lambda b: [made(b, 1), made(b, 2)], {"tolerance_m": 0.0}, "tolerance_m must be"),
    "another sensor": (
        lambda b: [made(b, k + 1, x) for k, x in enumerate((0, 60, 1, 70, 80, 90))],
        {},
        r"result 2 \(60 mm\), result 4 \(70 mm\), result 5 \(80 mm\) and 1 more are more than 50 mm from .* result 1:",
    ),
    "no date": (
        lambda b: [made(b, 1), made(b, 2, provenance=replace(b.provenance, date="May"))],
        {},
        "result 2: the date 'May'",
    ),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes_end_on_one_sentence(case, base):
    results, more, message = MISTAKES[case]
    with pytest.raises(carm_kin.InputError, match=message) as ended:
        carm_kin.trend(results(base), **more)
    assert "\n" not in str(ended.value)


@pytest.fixture
def files(base, tmp_path):
    """Seven results, the last one bumped; r7.json. One refused."""
    for k, x in enumerate((*OFFSETS_MM, 1.5)):
        made(base, k + 1, x).to_json(tmp_path / f"r{k + 1}.json")
    refused(base, 9).to_json(tmp_path / "refused.json")
    return sorted(tmp_path.glob("*.json"))


def test_the_command(files, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="pip install 'carm-kin[figures]'")
    places = tmp_path / "t.png", tmp_path / "t.csv", tmp_path / "t.out"
    ended = run(capsys, "trend", *files, "--figure", places[0], "--csv", places[1], "--json", places[2])
    assert ended.status == 3
    assert ended.err.splitlines() == [
        f"written: {places[2]}", f"written: {places[1]}", f"written: {places[0]}",
        "fail: r7.json: change of the offset 1.500 mm, beyond 1.000 (fail)",
    ]  # fmt: skip
    assert ended.out.splitlines()[-1] == "fail: r7.json: change of the offset 1.500 mm, beyond 1.000 (fail)"
    assert ended.out.splitlines() == str(carm_kin.trend(files)).splitlines()
    assert places[0].read_bytes().startswith(b"\x89PNG")

    data = json.loads(places[2].read_text())
    assert (data["schema"], data["status"], data["baseline"]) == ("carm-kin/trend/1", "fail", 5)
    assert data["charts"][1]["values_mm"][6] == pytest.approx(data["charts"][1]["reference_mm"] + 1.5)
    assert data["charts"][0]["fail_beyond_mm"][6] == pytest.approx(1.0)
    assert data["passed_over"][0]["label"] == "refused.json"

    rows = list(csv.DictReader(places[1].open(newline="", encoding="utf-8")))
    assert len(rows) == 7 * 7 + 1
    bumped = next(row for row in rows if row["label"] == "r7.json" and row["quantity"] == "offset, x")
    assert (bumped["unit"], bumped["status"]) == ("mm", "fail")
    assert float(bumped["change"]) == pytest.approx(1.5)
    assert (rows[-1]["label"], rows[-1]["status"], rows[-1]["value"]) == ("refused.json", "passed over", "")


def test_the_command_passes_and_keeps_its_word_on_stdout(files, capsys):
    ended = run(capsys, "trend", *files[:6], "--json", "-")
    assert (ended.status, json.loads(ended.out)["status"]) == (0, "pass")
    assert run(capsys, "trend", *files, "--tolerance-mm", 2).status == 3
    assert "--tolerance-mm must be" in fails(capsys, "trend", *files, "--tolerance-mm", -1)
    assert "the extension of a figure" in fails(capsys, "trend", *files, "--figure", "trend.html")


def test_files_of_one_name_are_labelled_by_their_places(base, tmp_path):
    for month in (1, 2):
        (tmp_path / str(month)).mkdir()
        made(base, month).to_json(tmp_path / str(month) / "result.json")
    paths = sorted(tmp_path.glob("*/result.json"))
    assert [one.label for one in carm_kin.trend(paths).results] == [str(path) for path in paths]


def test_the_figure_has_a_panel_a_quantity_with_the_limits(base):
    pytest.importorskip("matplotlib", reason="pip install 'carm-kin[figures]'")
    found = sound(base, made(base, 7, x_mm=0.6))
    panels = [axes for axes in found.figure().axes if axes.axison]
    assert len(panels) == len(found.charts) == 7
    values = panels[0].collections[-1].get_offsets()
    np.testing.assert_allclose(values[:, 1], found.charts[0].values * 1e3)
