"""The smallest ball that holds the rotation centre, against balls in closed form."""

from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.calibrated.isocentre import isocentre, smallest_ball
from carm_kin.results.deformation import Deformation, DeformationNode
from helpers.command import run

ALPHA, BETA = np.radians([-60.0, 0.0, 60.0]), np.radians([-45.0, 0.0, 45.0])


@pytest.fixture(scope="module")
def result():
    recording, _ = carm_kin.simulate("mobile_nonisocentric", sigma_t_m=2e-4, sigma_r_rad=1e-3, seed=1)
    return replace(
        carm_kin.calibrate(recording, systematic="none"), provenance=carm_kin.calibrate(recording).provenance
    )


def bent(result, slope_m, axis):
    """A C whose rotation centre moves along an axis of the carm frame by ``slope_m`` a radian of alpha."""
    along = result.T_sensor_carm[:3, axis]
    nodes = [
        DeformationNode(float(a), float(b), slope_m * a * along, np.zeros(3), np.full(3, 1e-4))
        for a in ALPHA
        for b in BETA
    ]
    return replace(result, deformation=Deformation((ALPHA[0], ALPHA[-1]), (BETA[0], BETA[-1]), tuple(nodes)))


@pytest.mark.parametrize(
    "points, radius",
    [
        ([(0, 0, 0), (2, 0, 0), (1, 0.1, 0)], 1.0),
        ([(0, 0, 0), (1, 0, 0), (0.5, np.sqrt(0.75), 0)], 1 / np.sqrt(3)),
        ([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], np.sqrt(3)),
        ([(3, 2, 1)], 0.0),
    ],
)
def test_the_smallest_ball(points, radius):
    centre, found = smallest_ball(np.array(points, dtype=float))
    assert found == pytest.approx(radius, rel=1e-3, abs=1e-9)
    assert (np.linalg.norm(np.array(points) - centre, axis=1) <= found * (1 + 1e-9)).all()


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_no_other_ball_is_smaller(dimensions):
    """Of random points on a line, in a plane and in space: all are held, and no centre nearby holds them in less."""
    rng = np.random.default_rng(dimensions)
    for _ in range(20):
        points = 1e-3 * rng.normal(size=(rng.integers(1, 200), 3)) * (np.arange(3) < dimensions)
        centre, radius = smallest_ball(points)
        assert np.linalg.norm(points - centre, axis=1).max() <= radius * (1 + 1e-9)
        for step in rng.normal(size=(30, 3)):
            assert np.linalg.norm(points - centre - 1e-3 * radius * step, axis=1).max() >= radius * (1 - 1e-9)


def test_a_shift_along_the_orbital_axis(result):
    """At alpha it lies along Rx(alpha) y: the ball over alpha is that of a flat spiral, over beta a point."""
    slope = 1e-3
    found = isocentre(bent(result, slope, 1))
    angular, orbital, both = found.balls
    alpha = np.linspace(ALPHA[0], ALPHA[-1], 25)
    e = result.axis_non_orthogonality_rad
    axis = np.column_stack([np.full(25, -np.sin(e)), np.cos(e) * np.cos(alpha), np.cos(e) * np.sin(alpha)])
    expected = 2 * smallest_ball(-slope * alpha[:, None] * axis)[1]
    assert angular.diameter_m == pytest.approx(expected, rel=1e-3)
    assert orbital.diameter_m == pytest.approx(0, abs=1e-9)
    assert both.diameter_m == pytest.approx(expected, rel=1e-3)
    assert both.diameter_with_circle_m > result.major_radius_m
    assert angular.sigma_m == pytest.approx(np.sqrt(2) * 1e-4, rel=0.5)
    assert "over the angular axis from -60 to 60 deg it walks" in found.walks[0]


def test_the_circle_is_told_apart(result):
    """Without a shift the centre still moves on the chord of its circle."""
    both = isocentre(bent(result, 0.0, 1)).balls[-1]
    assert both.diameter_m == pytest.approx(0, abs=1e-9)
    assert both.diameter_with_circle_m == pytest.approx(2 * result.major_radius_m * np.sin(np.radians(60)), rel=1e-3)


def test_the_command(result, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    bent(result, 1e-3, 1).to_json(tmp_path / "r.json")
    ended = run(
        capsys, "isocentre", tmp_path / "r.json", "--tolerance-mm", 5, "--csv", tmp_path / "i.csv",
        "--figure", tmp_path / "i.png", "--json", tmp_path / "i.json",
    )  # fmt: skip
    assert ended.status == 0
    assert ended.out.startswith("passed: smallest balls")
    assert (tmp_path / "i.png").stat().st_size > 10_000
    assert (tmp_path / "i.csv").read_text().splitlines()[0].startswith("date,status,axis,diameter_mm,sigma_mm")
    assert run(capsys, "isocentre", tmp_path / "r.json", "--tolerance-mm", 0.5).status == 3
    result.to_json(tmp_path / "rigid.json")
    ended = run(capsys, "isocentre", tmp_path / "rigid.json")
    assert ended.status == 2
    assert "tells no deformation" in ended.err


def test_bad_tolerances(result):
    with pytest.raises(carm_kin.InputError, match="above 0"):
        isocentre(bent(result, 1e-3, 1), tolerance_m=0.0)
