"""The bending of an arc against the textbook formulas of curved and straight cantilevers."""

import numpy as np
import pytest

from carm_kin.simulation.beam import Arc

LOAD, RADIUS = 3.0, 0.7
ARC = Arc(RADIUS, bending=2.0, sideways=0.5, torsion=4.0)
TIP = np.array([0.0, 0.0, RADIUS])


def quarter(force: tuple[float, float, float], seen: np.ndarray = TIP, loaded: np.ndarray = TIP) -> np.ndarray:
    """Shift and turn (6,) of a quarter circle that is clamped at x and free at z."""
    load = LOAD * np.array([force])
    return np.hstack(ARC.deflection(np.array([np.pi / 2]), np.array([0.0]), load, loaded, seen))[0]


@pytest.mark.parametrize(
    "force, in_plane",
    [((0, 0, -1), (-1 / 2, -np.pi / 4)), ((1, 0, 0), (3 * np.pi / 4 - 2, 1 / 2))],
    ids=["towards the centre", "tangential"],
)
def test_a_quarter_circle_in_its_plane(force, in_plane):
    """P R^3 / EI times these, by Castigliano's theorem with the moments P R sin and P R (1 - cos)."""
    shift = LOAD * RADIUS**3 * ARC.bending * np.array(in_plane)
    slope = LOAD * RADIUS**2 * ARC.bending * (-1 if force[2] else np.pi / 2 - 1)
    expected = [shift[0], 0, shift[1], 0, slope, 0]
    np.testing.assert_allclose(quarter(force), expected, rtol=1e-12, atol=1e-15)


def test_a_quarter_circle_across_its_plane():
    """P R^3 (pi / 4 / EI + (3 pi / 4 - 2) / GJ): bending and torsion together."""
    bend, twist = np.pi / 4 * ARC.sideways, (3 * np.pi / 4 - 2) * ARC.torsion
    shift = quarter((0, 1, 0))[:3]
    np.testing.assert_allclose(shift, [0, LOAD * RADIUS**3 * (bend + twist), 0], rtol=1e-12, atol=1e-15)


def test_a_long_radius_is_a_straight_cantilever():
    """P L^3 / 3 EI and P L^2 / 2 EI."""
    length, radius = 1.5, 1e5
    tip = np.array([0.0, 0.0, radius])
    arc = Arc(radius, bending=2.0, sideways=0.5)
    for force, compliance in (((0, 0, LOAD), 2.0), ((0, LOAD, 0), 0.5)):
        load = np.array([force], dtype=float)
        shift, turn = arc.deflection(np.array([-length / radius]), np.array([0.0]), load, tip, tip)
        assert np.linalg.norm(shift) == pytest.approx(LOAD * length**3 / 3 * compliance, rel=1e-4)
        assert shift[0] @ load[0] > 0
        assert np.linalg.norm(turn) == pytest.approx(LOAD * length**2 / 2 * compliance, rel=1e-4)


def test_what_is_rigid_with_the_tip_turns_with_it():
    lever = np.array([0.1, -0.2, 0.3])
    at_tip, off = quarter((0.3, -0.5, 0.2)), quarter((0.3, -0.5, 0.2), seen=TIP + lever)
    np.testing.assert_allclose(off[:3], at_tip[:3] + np.cross(at_tip[3:], lever), atol=1e-14)
    np.testing.assert_allclose(off[3:], at_tip[3:], atol=1e-14)


def test_maxwell_and_betti():
    """A load at one point moves another one along b as much as a load along b there moves the first along a."""
    rng = np.random.default_rng(3)
    first, second, a, b = rng.normal(size=(4, 3))
    there = quarter(tuple(a), seen=second, loaded=first)[:3]
    back = quarter(tuple(b), seen=first, loaded=second)[:3]
    assert there @ b == pytest.approx(back @ a, rel=1e-12)
    assert abs(there @ b) > 1e-3


def test_either_sense_of_the_arc_bends_alike():
    """The mirrored arc, clamped at -x, under the mirrored load."""
    mirror = np.array([-1.0, 1.0, 1.0])
    load = np.array([[0.3, -0.5, 0.2]])
    shift, _ = ARC.deflection(np.array([-np.pi / 2]), np.array([0.0]), load, TIP, TIP)
    np.testing.assert_allclose(shift[0], mirror * quarter(tuple(load[0] * mirror / LOAD))[:3], atol=1e-14)
