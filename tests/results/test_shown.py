"""A number that was held bears the word, one that means nothing is no number, in every place that a person reads."""

import json
from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.report import words
from carm_kin.report.comparison import comparison_of
from carm_kin.results.result import CalibrationResult
from carm_kin.results.rows import cells
from carm_kin.study.compare import compare
from carm_kin.study.compare_view import text_of
from helpers.pointers import pointer
from helpers.still import BOTH, recording
from solvers.estimate import Covariance


@pytest.fixture(scope="module")
def fixed() -> CalibrationResult:
    return carm_kin.calibrate(recording(BOTH, 0), fix_non_orthogonality=True)


@pytest.fixture(scope="module")
def vague() -> CalibrationResult:
    """A result whose radii and axes are known to 30 mm and 20 degrees."""
    found = carm_kin.calibrate(recording(BOTH, 0))
    grown = np.array([1e3 if name.endswith("radius") or "ax" in name else 1.0 for name in found.covariance.names])
    covariance = Covariance(found.covariance.names, found.covariance.matrix * np.outer(grown, grown))
    axis = np.full(3, np.radians(20.0))
    return replace(
        found,
        covariance=covariance,
        sigma=replace(
            found.sigma,
            major_radius_m=0.03,
            minor_radius_m=1e84,
            axis_non_orthogonality_rad=axis[0],
            orbital_axis_sensor=axis,
        ),
    )


def texts(result: CalibrationResult) -> list[str]:
    """Summary, notebook, report and comparison."""
    comparison = comparison_of({"one": result})
    page = " ".join(" ".join((*row.values, *row.sigmas, row.remark)) for row in words.rows_of(result))
    return [str(result), result._repr_html_(), page, str(comparison.lines)]


def test_what_was_fixed_says_so(fixed, tmp_path):
    assert fixed.fixed == ("axis_non_orthogonality",)
    assert all("fixed" in text for text in texts(fixed))
    assert all("± 0.000" not in text for text in texts(fixed))
    data = fixed.to_dict()
    assert data["fixed"] == ["axis_non_orthogonality"]
    assert data["sigma"]["axis_non_orthogonality_deg"] is None
    assert cells(data)["sigma_axis_non_orthogonality_deg"] is None
    fixed.to_json(tmp_path / "result.json")
    assert CalibrationResult.from_json(tmp_path / "result.json").fixed == fixed.fixed


def test_a_radius_that_the_locus_has_not_is_fixed():
    result = carm_kin.calibrate(pointer("cone", 0).recording, locus="point")
    assert result.fixed == ("major_radius",)
    assert "0.000 mm (fixed)" in str(result)


def test_an_estimated_number_is_not_fixed():
    assert carm_kin.calibrate(recording(BOTH, 0), fix_non_orthogonality=False).fixed == ()


def test_what_means_nothing_is_no_number(vague):
    radius, minor = f"{vague.major_radius_m * 1e3:.3f}", f"{vague.minor_radius_m * 1e3:.3f}"
    axis = f"{vague.orbital_axis_sensor[0]:+.5f}"
    for text in texts(vague):
        assert not [number for number in (radius, minor, axis, "000000000") if number in text]
    assert all(text.count("not determined") >= 4 for text in texts(vague)[:3])
    row = cells(json.loads(vague.to_json()))
    names = "major_radius_mm", "minor_radius_mm", "axis_non_orthogonality_deg", "orbital_axis_x"
    assert [row[name] for name in names] == [None] * 4
    assert row["offset_x_mm"] is not None


def test_a_comparison_says_what_was_fixed():
    given = recording(BOTH, 0)
    found = compare(given, "kinematic", folds=None)
    runs = tuple(replace(run, result=carm_kin.calibrate(given, fix_non_orthogonality=True)) for run in found.runs)
    assert "(fixed)" in text_of(replace(found, runs=runs))
