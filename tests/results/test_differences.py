"""Differences of two results by hand, and intervals against published values and by counting."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.results.differences import Difference, differences
from carm_kin.results.parts import Placement, PlacementSigma, Sigma
from carm_kin.results.result import CalibrationResult
from carm_kin.study.intervals import estimated, mean, median, ratio_of_rms, rms, share


@pytest.fixture(scope="module")
def base() -> CalibrationResult:
    return carm_kin.simulate("mobile_skewed", "minimal")[1]


def found(a: CalibrationResult, b: CalibrationResult) -> dict[str, Difference]:
    return {difference.quantity: difference for difference in differences(a, b, "a", "b")}


def moved(base: CalibrationResult, **more: object) -> CalibrationResult:
    return replace(base, **more)


def test_a_result_differs_from_itself_by_nothing(base):
    every = found(base, base)
    assert set(every) == {
        "offset",
        "major radius",
        "minor radius",
        "non-orthogonality",
        "orbital axis",
        "centre",
        "angular axis",
    }
    assert all((d.difference_m or 0.0) + (d.difference_rad or 0.0) < 1e-15 for d in every.values())
    assert all((d.first, d.second) == ("a", "b") for d in every.values())


def test_lengths_are_in_metres_and_in_the_sigmas_of_both(base):
    sigmas = Sigma(offset_sensor_pivot_m=np.array([1e-3, 2e-3, 2e-3]), major_radius_m=0.5e-3)
    a = moved(base, sigma=sigmas)
    b = moved(
        base,
        offset_sensor_pivot_m=base.offset_sensor_pivot_m + np.array([3e-3, 0, -4e-3]),
        major_radius_m=base.major_radius_m - 1e-3,
        sigma=Sigma(offset_sensor_pivot_m=np.array([0, 0, 10e-3])),
    )
    every = found(a, b)
    offset, radius = every["offset"], every["major radius"]
    assert offset.difference_m == pytest.approx(5e-3)
    assert offset.sigmas_of_first == pytest.approx(5 / 3)
    assert offset.sigmas_of_second == pytest.approx(0.5)
    assert (radius.difference_m, radius.sigmas_of_first) == (pytest.approx(1e-3), pytest.approx(2.0))
    assert radius.sigmas_of_second is None
    assert (radius.difference_rad, every["minor radius"].sigmas_of_first) == (None, None)


@pytest.mark.parametrize("sense", [1, -1])
def test_axes_are_lines(sense, base):
    axis = base.orbital_axis_sensor
    across = np.cross(axis, [0.3, 0.5, -0.2])
    turned = Rotation.from_rotvec(0.01 * across / np.linalg.norm(across)).apply(axis)
    difference = found(base, moved(base, orbital_axis_sensor=sense * turned))["orbital axis"]
    assert difference.difference_rad == pytest.approx(0.01, rel=1e-9)


def test_the_non_orthogonality_turns_its_sign_with_that_of_the_major_radius(base):
    other = moved(
        base,
        axis_non_orthogonality_rad=-base.axis_non_orthogonality_rad,
        major_radius_signed_m=-base.major_radius_signed_m,
    )
    assert found(base, other)["non-orthogonality"].difference_rad == 0
    other = moved(base, axis_non_orthogonality_rad=-base.axis_non_orthogonality_rad)
    twice = 2 * abs(base.axis_non_orthogonality_rad)
    assert found(base, other)["non-orthogonality"].difference_rad == pytest.approx(twice)


def test_placements_are_compared_by_label(base):
    def placement(label: str, x: float) -> Placement:
        return Placement(label, np.array([x, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), None, True)

    def sigma(value: float) -> PlacementSigma:
        return PlacementSigma(np.array([value, 0.0, 0.0]), None)

    a = moved(base, placements=(placement("1", 0.0), placement("2", 1.0)), sigma=Sigma(placements=(sigma(1), sigma(2))))
    b = moved(base, placements=(placement("2", 1.5), placement("3", 0.0)), sigma=Sigma(placements=(sigma(5), sigma(6))))
    every = found(a, b)
    assert [name for name in every if name.startswith(("centre", "angular"))] == ["centre 2", "angular axis 2"]
    centre = every["centre 2"]
    assert (centre.difference_m, centre.sigmas_of_first, centre.sigmas_of_second) == (0.5, 0.25, 0.1)


def test_what_one_of_two_does_not_have_is_not_compared(base):
    bare = moved(base, offset_sensor_pivot_m=None, orbital_axis_sensor=None, axis_non_orthogonality_rad=None)
    assert set(found(bare, base)) == {"major radius", "minor radius", "centre", "angular axis"}


@pytest.mark.parametrize(
    "hits, runs, low, high",
    [(8, 10, 0.4439, 0.9748), (0, 10, 0.0, 0.3085), (10, 10, 0.6915, 1.0), (95, 100, 0.8872, 0.9836)],
)
def test_the_interval_of_a_share_is_that_of_the_tables(hits, runs, low, high):
    value, ends = share(np.array([1.0] * hits + [0.0] * (runs - hits) + [np.nan]))
    assert value == hits / runs
    assert ends == pytest.approx((low, high), abs=6e-5)


def test_statistics_by_hand():
    values = np.array([3.0, -4.0, 0.0, np.nan])
    assert estimated(values, rms)[0] == pytest.approx(5 / np.sqrt(3))
    assert estimated(values, mean)[0] == pytest.approx(-1 / 3)
    assert estimated(values, median)[0] == 0
    one = np.array([1.0, 2.0, 3.0, 5.0])
    value, ends = estimated(np.array([2 * one, one]), ratio_of_rms)
    assert value == pytest.approx(2.0)
    assert ends == pytest.approx((2.0, 2.0))


def test_without_runs_there_is_no_number_and_with_one_no_interval():
    nothing = np.array([np.nan, np.nan])
    assert estimated(nothing, rms) == (None, None)
    assert share(nothing) == (None, None)
    assert estimated(np.array([2.0]), rms) == (2.0, None)
    assert estimated(np.zeros((2, 5)), ratio_of_rms) == (None, None)


def test_95_of_100_intervals_hold_the_truth():
    """RMS of 60 normal errors of unit sigma: the interval holds 1. The bootstrap's own shortfall at 60 runs is 2 to 3
    points; 300 trials at 0.93 spread by 0.015 (one sigma), so 0.88 is 3 sigmas below, and 1.0 is never reached."""
    rng = np.random.default_rng(7)
    held = [low <= 1 <= high for low, high in (estimated(rng.normal(size=60), rms)[1] for _ in range(300))]
    assert 0.88 < np.mean(held) < 0.99
