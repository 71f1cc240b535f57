"""What a motion about one axis tells: where it stands in sensor and world, the circle of the sensor, its runout."""

from dataclasses import dataclass

import numpy as np

from solvers.problem import Problem
from solvers.se3 import Array, orthonormal_complement
from solvers.told import MIN_ARC_RAD, least_arc, turn_noise, turned
from solvers.verdict.runout import Runout, Wander, runout

STRAYS, MANY = 3, 100
"""So many poses at each end of an arc may be wrong, where there is one for every so many."""
STILL_M = 0.005
"""Positions that spread by less along the longest direction stand still: 5 degrees at a C-arm's size are ten times as
much."""


@dataclass(frozen=True, eq=False)
class Circle:
    """The circle nearest to positions, m."""

    axis: Array
    """(3,) unit, across its plane."""
    centre: Array
    """(3,)."""
    radius: float
    off: float
    """Root mean square distance of the positions from it."""
    arc: float
    """How much of it they span, rad."""


def swept(angle: Array) -> float:
    """The arc, rad, that an angle (N,) spans: the circle less its largest gap.

    Of many poses `STRAYS` at each end of it do not count, which may be wrong.
    """
    angle = np.sort(np.mod(angle, 2 * np.pi))
    if not len(angle):
        return 0.0
    gaps = np.diff(angle, append=angle[0] + 2 * np.pi)
    start = int(np.argmax(gaps)) + 1
    along = np.mod(np.roll(angle, -start) - angle[start % len(angle)], 2 * np.pi)
    strays = min(STRAYS, len(along) // MANY)
    return float(along[-1 - strays] - along[strays])


def circle_of(p: Array, axis: Array) -> Circle:
    """Of positions (N, 3), in the plane across ``axis`` (3,)."""
    mean = p.mean(axis=0)
    e = orthonormal_complement(axis)
    across = (p - mean) @ e
    A = np.column_stack([2 * across, np.ones(len(across))])
    x = np.linalg.lstsq(A, (across**2).sum(axis=1), rcond=None)[0]
    radius, spoke = float(np.sqrt(max(float(x[2] + x[:2] @ x[:2]), 0.0))), across - x[:2]
    off = np.hypot(np.linalg.norm(spoke, axis=1) - radius, (p - mean) @ axis)
    arc = swept(np.arctan2(spoke[:, 1], spoke[:, 0]))
    return Circle(axis, mean + e @ x[:2], radius, float(np.sqrt((off**2).mean())), arc)


def one_circle(p: Array) -> tuple[str, ...]:
    """Sentences where positions (N, 3) stand still, or are those of a sensor that turns about one axis alone.

    A second axis is told if it is swept by `MIN_ARC_RAD`. That takes a sensor at the radius r from it off the circle
    of the first by r `MIN_ARC_RAD` / sqrt(12), rms; less is wobble or sag.
    """
    _, spread, directions = np.linalg.svd(p - p.mean(axis=0), full_matrices=False)
    if spread[0] / np.sqrt(len(p)) < STILL_M:
        return ("the positions stand still: the torus is unknown",)
    found = circle_of(p, directions[-1])
    if found.off >= found.radius * MIN_ARC_RAD / np.sqrt(12):
        return ()
    told = (
        f"its axis stands along {in_words(found.axis)} in the world, its radius is {found.radius * 1e3:.4g} mm, "
        if found.arc > MIN_ARC_RAD
        else ""
    )
    return (
        f"the positions lie on one circle within {found.off * 1e3:.2g} mm (rms), as where one axis turned: {told}"
        "the other axis, the torus and its radii are unknown",
    )


def turns_untold(problem: Problem) -> tuple[str, ...]:
    """Sentences where the orientations of one placement do not turn about two directions by `least_arc`; else none."""
    noise = turn_noise(problem).sigma
    told = int(turned(problem, noise).told.sum())
    if told == 3:
        return ()
    least = f"{np.degrees(least_arc(noise)):.2g} deg"
    if told < 2:
        return (f"no motion about any axis beyond {least}: where base and sensor stand is unknown",)
    return (
        f"the sensor turns about one axis only, about any other by less than {least}: where base and sensor stand is "
        "unknown along it and about it",
        *one_axis_in_words(problem),
    )


def one_axis_in_words(problem: Problem) -> tuple[str, ...]:
    """What the motion about one axis tells: its line in the sensor and the world, and the orbit's radius.

    The axis u of the world is fixed in the sensor as v where ``R_i v = u``: the first singular vectors of the mean
    orientation. The sensor circles it, so that the positions across u lie on a circle about a point c of the axis.
    Seen from the sensor it passes the mean of ``R_iᵀ (c - p_i)``, the part along v left out. How that point and v move
    in the world is the axis' runout.
    """
    if problem.placements > 1 or problem.R_world_sensor is None:
        return ()
    left, _, right = np.linalg.svd(problem.rotations.mean(axis=0))
    u, v = left[:, 0], right[0]
    e = orthonormal_complement(u)
    turn = problem.rotations @ orthonormal_complement(v)[:, 0] @ e
    theta, circle = np.arctan2(turn[:, 1], turn[:, 0]), circle_of(problem.p_world_sensor, u)
    seen = np.einsum("nji,nj->ni", problem.rotations, circle.centre - problem.p_world_sensor).mean(axis=0)
    point = seen - v * (v @ seen)
    found = runout(theta, problem.p_world_sensor + problem.rotations @ point, problem.rotations @ v, u)
    return (
        f"one axis turned, by {np.degrees(swept(theta)):.3g} deg: it stands along {in_words(v)} in the sensor and "
        f"along {in_words(u)} in the world, the sensor circles it at {circle.radius * 1e3:.4g} mm; it passes "
        f"{_point(point)} in the sensor and {_point(circle.centre)} in the world"
        f"{_runout_in_words(found) if found else ''}",
    )


def _runout_in_words(found: Runout) -> str:
    deg = float(np.degrees(1))
    parts = (
        _wander_in_words("radial runout", found.radial, 1e3, "mm"),
        _wander_in_words("axial runout", found.axial, 1e3, "mm"),
        _wander_in_words("wobble", found.wobble, deg, "deg"),
    )
    return f"; {', '.join(parts)} (peak to peak over the turn)"


def _wander_in_words(name: str, wander: Wander, unit: float, unit_name: str) -> str:
    noise = "" if wander.told else " within the noise"
    return f"{name} {wander.size * unit:.2g} ± {wander.sigma * unit:.1g} {unit_name}{noise}"


def in_words(direction: Array) -> str:
    """A unit vector (3,)."""
    return "(" + ", ".join(f"{x:+.3f}" for x in direction) + ")"


def _point(p: Array) -> str:
    """A point (3,), m."""
    return "(" + ", ".join(f"{x * 1e3:+.1f}" for x in p) + ") mm"
