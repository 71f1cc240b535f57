"""Results as files: written, read back without loss, and refused where they are broken."""

import json
import re
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import carm_kin
from carm_kin.errors import InputError
from carm_kin.results.parts import (
    NoiseLevel,
    Observability,
    Outliers,
    Placement,
    PlacementSigma,
    Provenance,
    Rejection,
    Residuals,
    Sigma,
)
from carm_kin.results.result import CalibrationResult
from solvers.estimate import Covariance, Note
from solvers.likelihood.covariance import NORMAL_95

DESIGN_KEYS = {
    "schema", "status", "solver", "options", "offset_sensor_pivot_mm", "major_radius_mm",
    "major_radius_signed_mm", "major_radius_interval_95_mm", "offset_within_95_mm", "minor_radius_mm",
    "axis_non_orthogonality_deg", "orbital_axis_sensor", "placements", "T_sensor_carm", "orbital_referenced",
    "sigma", "covariance", "noise", "residuals", "poses", "used", "outliers", "observability", "warnings",
    "refusal", "provenance", "cross_validation", "chain", "told", "fixed", "sigma_parts", "effects",
    "deformation", "tracker_scale",
}  # fmt: skip


@pytest.fixture(scope="module")
def result() -> CalibrationResult:
    recording, _ = carm_kin.simulate("mobile_skewed", sigma_t_m=3e-4, sigma_r_rad=1e-3, seed=3)
    return carm_kin.calibrate(recording)


@pytest.fixture
def file(result, tmp_path):
    path = tmp_path / "result.json"
    result.to_json(path)
    return path


def same(a: Any, b: Any) -> None:
    """Equal values; numbers to the last two digits, since mm and degrees are rounded as well."""
    if is_dataclass(a):
        assert type(a) is type(b)
        for f in fields(a):
            same(getattr(a, f.name), getattr(b, f.name))
    elif isinstance(a, tuple):
        assert isinstance(b, tuple)
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            same(x, y)
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key, value in a.items():
            same(value, b[key])
    elif isinstance(a, (float, np.ndarray)):
        np.testing.assert_allclose(b, a, rtol=5e-16, atol=0, strict=isinstance(a, np.ndarray))
    else:
        assert a == b
        assert type(a) is type(b)


def test_the_file_has_the_keys_of_the_design(result):
    data = result.to_dict()
    assert data.keys() == DESIGN_KEYS
    assert data["residuals"].keys() == {"overall", "per_sweep"}
    assert {"translation_rms_mm", "rotation_rms_deg", "chi2_per_dof"} <= data["residuals"]["overall"].keys()
    assert len(data["residuals"]["per_sweep"]) == 8
    assert data["covariance"].keys() == {"names", "matrix"}
    assert data["noise"].keys() == {
        "translation_mm", "rotation_deg", "estimated",
        "translation_correlation_poses", "rotation_correlation_poses", "effective_poses", "axes",
    }  # fmt: skip
    assert data["outliers"].keys() == {"count", "indices", "reasons"}
    assert data["observability"].keys() == {"singular_values", "condition", "unobservable"}
    assert data["placements"][0].keys() == {
        "label", "torus_center_world_mm", "angular_axis_world", "T_world_torus", "referenced",
    }  # fmt: skip
    assert {"offset_sensor_pivot_mm", "major_radius_mm", "placements"} <= data["sigma"].keys()
    assert {"versions", "input_sha256", "command", "seed", "date"} <= data["provenance"].keys()


def test_units_of_the_file(result):
    data = result.to_dict()
    assert data["offset_sensor_pivot_mm"] == (result.offset_sensor_pivot_m * 1e3).tolist()
    assert data["axis_non_orthogonality_deg"] == pytest.approx(0.7, abs=0.02)
    assert data["major_radius_mm"] == pytest.approx(60, abs=0.2)
    assert data["T_sensor_carm"][0][3] == pytest.approx(data["offset_sensor_pivot_mm"][0])
    assert data["T_sensor_carm"][3] == [0, 0, 0, 1]
    names = data["covariance"]["names"]
    k = names.index("major_radius_mm")
    assert np.sqrt(data["covariance"]["matrix"][k][k]) == pytest.approx(data["sigma"]["major_radius_mm"], rel=1e-9)
    k = names.index("axis_non_orthogonality_deg")
    sigma_deg = data["sigma"]["axis_non_orthogonality_deg"]
    assert np.sqrt(data["covariance"]["matrix"][k][k]) == pytest.approx(sigma_deg, rel=1e-9)
    assert "orbital_axis_sensor_x" in names


@pytest.mark.parametrize(
    "R_m, sigma_m, expected_mm",
    [
        (12e-6, 20e-6, [0.0, 0.0511993]),
        (0.0, 20e-6, [0.0, 0.0391993]),
        (39e-6, 20e-6, [0.0, 0.0781993]),
        (40e-6, 20e-6, [0.00080072, 0.07919928]),
        (0.1, 1e-3, [98.040036, 101.959964]),
        (0.1, 0.0, [100.0, 100.0]),
        (0.1, None, None),
        (None, None, None),
    ],
)
def test_the_interval_of_the_major_radius(R_m, sigma_m, expected_mm, result, tmp_path):
    """By hand: 1.959964 sigma on either side, from 0 where that would begin below."""
    given = replace(result, major_radius_m=R_m, sigma=replace(result.sigma, major_radius_m=sigma_m))
    interval = given.major_radius_interval_95_m
    assert (None if interval is None else [x * 1e3 for x in interval]) == (expected_mm and pytest.approx(expected_mm))
    assert given.to_dict()["major_radius_interval_95_mm"] == (expected_mm and pytest.approx(expected_mm))
    text = given.to_json(tmp_path / "r.json")
    back = CalibrationResult.from_json(tmp_path / "r.json")
    assert back.major_radius_interval_95_m == (interval and pytest.approx(interval, rel=1e-15))
    assert back.to_json() == text


def test_a_result_comes_back_from_its_file(result, file):
    back = CalibrationResult.from_json(file)
    same(replace(result, angles_rad=None), back)
    assert back.to_json() == file.read_text()


@pytest.mark.parametrize("solver", ["closed_form", "decomposed", "direct", "surface"])
def test_results_with_missing_numbers_come_back(solver, tmp_path):
    recording, truth = carm_kin.simulate("mobile_isocentric", sigma_t_m=3e-4, sigma_r_rad=1e-3, seed=3)
    for result in (
        truth,
        carm_kin.calibrate(recording, solver),
        carm_kin.calibrate(recording.select(slice(4)), solver),
    ):
        text = result.to_json(tmp_path / "r.json")
        assert CalibrationResult.from_json(tmp_path / "r.json").to_json() == text


numbers = st.floats(-1e6, 1e6, allow_subnormal=False).map(lambda x: 0.0 if abs(x) < 1e-9 else x)
positive = numbers.map(abs)
vectors = arrays(float, 3, elements=numbers)
names = st.text(max_size=20)


@st.composite
def transforms(draw) -> np.ndarray:
    R, _ = np.linalg.qr(np.random.default_rng(draw(st.integers(0, 2**32))).normal(size=(3, 3)))
    return np.block([[R * np.sign(np.linalg.det(R)), draw(vectors)[:, None]], [np.zeros(3), 1.0]])


@st.composite
def results(draw) -> CalibrationResult:
    def maybe(strategy: st.SearchStrategy) -> Any:
        return draw(st.none() | strategy)

    def residual() -> Residuals:
        return Residuals(draw(names), draw(positive), maybe(positive), maybe(positive), draw(st.integers(0)))

    T = draw(transforms())
    half = draw(arrays(float, (3, 3), elements=st.floats(-10, 10)))
    outliers = tuple(draw(st.lists(st.integers(0, 10**6), max_size=3)))
    return CalibrationResult(
        status="ok",
        solver=draw(names),
        options={
            "lever_m": draw(positive),
            "seed": 3,
            "locus": draw(names),
            "fix": draw(st.booleans()),
            "width_m": None,
        },
        offset_sensor_pivot_m=maybe(vectors),
        major_radius_m=maybe(positive),
        major_radius_signed_m=maybe(numbers),
        minor_radius_m=maybe(positive),
        axis_non_orthogonality_rad=maybe(numbers),
        orbital_axis_sensor=T[:3, 1],
        placements=(
            Placement(draw(names), draw(vectors), T[:3, 0], T, draw(st.booleans())),
            Placement(draw(names), draw(vectors), None, None, draw(st.booleans())),
        ),
        T_sensor_carm=maybe(transforms()),
        orbital_referenced=draw(st.booleans()),
        sigma=Sigma(maybe(vectors), maybe(positive), placements=(PlacementSigma(maybe(vectors), None),)),
        covariance=maybe(
            st.just(Covariance(("major_radius", "axis_non_orthogonality", "orbital_axis_sensor_x"), half @ half.T))
        ),
        noise=NoiseLevel(maybe(positive), maybe(positive), draw(st.booleans())),
        residuals=residual(),
        residuals_per_sweep=(residual(), residual()),
        poses=10,
        used=8,
        outliers=Outliers(len(outliers), outliers),
        observability=Observability(draw(arrays(float, 2, elements=positive)), maybe(positive), (draw(names),)),
        warnings=(Note(draw(names), draw(names)),),
        refusal=None,
        provenance=Provenance({"numpy": "2"}, maybe(names), maybe(names), maybe(names), maybe(st.integers(0)), "now"),
    )


@given(results())
def test_any_result_comes_back(tmp_path_factory, result):
    path = tmp_path_factory.getbasetemp() / "any.json"
    text = result.to_json(path)
    back = CalibrationResult.from_json(path)
    same(result, back)
    assert back.to_json() == text
    if (interval := back.major_radius_interval_95_m) is not None:
        low, high = interval
        assert back.major_radius_m is not None
        assert 0 <= low <= back.major_radius_m <= high
        assert (low == 0) == (back.major_radius_m <= NORMAL_95 * (back.sigma.major_radius_m or 0.0))


DELETE = object()


def _set(*path: object, value: object):
    def change(data: dict) -> None:
        for key in path[:-1]:
            data = data[key]
        if value is DELETE:
            del data[path[-1]]
        else:
            data[path[-1]] = value

    return change


BROKEN = {
    "no schema": (_set("schema", value=DELETE), "'schema' must be 'carm-kin/result/1'"),
    "another schema": (_set("schema", value="carm-kin/result/2"), "'schema' must be"),
    "key missing": (_set("offset_sensor_pivot_mm", value=DELETE), "'offset_sensor_pivot_mm' is missing"),
    "unknown key": (_set("ofset", value=1), "'ofset' is unknown"),
    "unknown status": (_set("status", value="fine"), "status must be"),
    "refused with numbers": (_set("status", value="refused"), "status must be"),
    "refusal with numbers": (
        lambda d: d.update(status="refused", refusal={"code": "misfit", "message": "no"}),
        "refused result must hold no numbers",
    ),
    "text for a number": (_set("major_radius_mm", value="60"), "major_radius_mm must be a finite number or null"),
    "true for a number": (_set("major_radius_mm", value=True), "major_radius_mm must be a finite number or null"),
    "negative radius": (_set("major_radius_mm", value=-60.0), "below 0"),
    "null entry": (_set("offset_sensor_pivot_mm", 1, value=None), r"offset_sensor_pivot_mm\[1\] must be a finite"),
    "short vector": (_set("offset_sensor_pivot_mm", value=[1.0, 2.0]), "must have 3 numbers, not 2"),
    "number for a vector": (_set("orbital_axis_sensor", value=1.0), "orbital_axis_sensor must be a list"),
    "long axis": (_set("orbital_axis_sensor", value=[1.0, 1.0, 0.0]), "no unit vector"),
    "3x4 transform": (_set("T_sensor_carm", 3, value=DELETE), "T_sensor_carm must have 4 rows, not 3"),
    "no rotation": (_set("T_sensor_carm", 0, 0, value=3.0), "no rigid motion"),
    "placements an object": (_set("placements", value={}), "placements must be a list"),
    "placement without label": (_set("placements", 0, "label", value=DELETE), r"placements\[0\]: 'label' is missing"),
    "referenced a text": (_set("placements", 0, "referenced", value="yes"), r"placements\[0\].referenced must be true"),
    "poses a float": (_set("poses", value=1.5), "poses must be a whole number"),
    "more used than poses": (_set("used", value=10**6), "contradict"),
    "outliers not listed": (_set("outliers", "count", value=3), "contradict"),
    "covariance not square": (_set("covariance", "matrix", 0, value=DELETE), "covariance.matrix must have"),
    "covariance skewed": (_set("covariance", "matrix", 0, 1, value=9.0), "not symmetric"),
    "residuals flat": (_set("residuals", value={}), "'overall' and 'per_sweep'"),
    "warning a text": (_set("warnings", value=["no"]), r"warnings\[0\] must be a JSON object"),
    "no interval": (_set("major_radius_interval_95_mm", value=DELETE), "'major_radius_interval_95_mm' is missing"),
    "interval unknown": (_set("major_radius_interval_95_mm", value=None), "interval of the major radius is not"),
    "interval of one": (_set("major_radius_interval_95_mm", value=[60.0]), "interval of the major radius is not"),
    "interval of texts": (_set("major_radius_interval_95_mm", value=["a", "b"]), r"95_mm\[0\] must be a finite"),
    "another interval": (_set("major_radius_interval_95_mm", 0, value=0.0), "interval of the major radius is not"),
    "another sigma": (_set("sigma", "major_radius_mm", value=3.0), "interval of the major radius is not"),
    "huge number": (_set("major_radius_mm", value=10**400), "major_radius_mm must be a finite number"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_result_says_what_is_wrong(kind, file):
    change, expected = BROKEN[kind]
    data = json.loads(file.read_text())
    change(data)
    file.write_text(json.dumps(data))
    with pytest.raises(InputError) as error:
        CalibrationResult.from_json(file)
    assert str(error.value).startswith(f"{file}: ")
    assert re.search(expected, str(error.value)), error.value


@pytest.mark.parametrize(
    "content, expected",
    {
        b"": "not JSON",
        b"{": "line 1: is not JSON",
        b"[]": "no JSON object",
        b"\xff": "not JSON",
        b'{"a": 1, "a": 2}': "'a' stands twice",
        b"[" * 100_000: "not JSON",
        b'{"a": ' + b"9" * 10_000 + b"}": "not JSON",
    }.items(),
)
def test_what_is_no_json_says_so(content, expected, tmp_path):
    file = tmp_path / "r.json"
    file.write_bytes(content)
    with pytest.raises(InputError, match=expected):
        CalibrationResult.from_json(file)


def test_every_truncation_of_a_file_is_refused(file):
    text = file.read_bytes()
    for cut in range(0, len(text) - 2, 97):
        file.write_bytes(text[:cut])
        with pytest.raises(InputError):
            CalibrationResult.from_json(file)


@pytest.mark.parametrize("value", ["NaN", "Infinity", "1e999"])
def test_numbers_that_are_not_finite_are_refused(value, file):
    file.write_text(re.sub(r'"minor_radius_mm": [^,]*', f'"minor_radius_mm": {value}', file.read_text(), count=1))
    with pytest.raises(InputError, match="minor_radius_mm must be a finite number"):
        CalibrationResult.from_json(file)


def test_no_such_file_and_a_folder(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        CalibrationResult.from_json(tmp_path / "none.json")
    with pytest.raises(InputError, match="is not a file"):
        CalibrationResult.from_json(tmp_path)


def test_a_place_that_cannot_be_written(result, tmp_path):
    with pytest.raises(InputError, match="is a folder"):
        result.to_json(tmp_path)
    with pytest.raises(InputError, match="cannot be written"):
        result.to_json(tmp_path / "none" / "r.json")
    assert list(tmp_path.iterdir()) == []


def test_why_poses_were_rejected_survives_the_file_and_must_add_up(result, tmp_path):
    path = tmp_path / "result.json"
    frozen = Rejection("identical to the pose before", 2, (3, 4))
    outliers = Outliers(3, (3, 4, 9), (frozen,))
    listed = replace(result, used=result.poses - 3, outliers=outliers)
    listed.to_json(path)
    assert CalibrationResult.from_json(path).outliers == outliers
    for wrong in (replace(frozen, count=1), replace(frozen, indices=(3, 5)), replace(frozen, indices=(3, 3))):
        replace(listed, outliers=replace(outliers, reasons=(wrong,))).to_json(path)
        with pytest.raises(InputError, match="the reasons of the outliers"):
            CalibrationResult.from_json(path)
