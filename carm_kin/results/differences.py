"""Differences of two calibrations, quantity by quantity, in mm and degrees and in the standard deviations of both."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from carm_kin.results.result import CalibrationResult
from solvers.se3 import Array

OFFSET, MAJOR_RADIUS, MINOR_RADIUS = "offset", "major radius", "minor radius"
NON_ORTHOGONALITY, ORBITAL_AXIS = "non-orthogonality", "orbital axis"
CENTRE, ANGULAR_AXIS = "centre", "angular axis"


@dataclass(frozen=True)
class Difference:
    """How far two calibrations are apart in one quantity; a length or an angle."""

    first: str
    second: str
    """Names of the two: solvers, or ``truth``."""
    quantity: str
    """Such as ``offset``; of a placement with a label, its label behind it."""
    difference_m: float | None
    difference_rad: float | None
    sigmas_of_first: float | None
    """The difference over the standard deviation that the first states: of a vector, over the root of the summed
    variances of its components. None where it states none."""
    sigmas_of_second: float | None


def differences(first: CalibrationResult, second: CalibrationResult, one: str, other: str) -> list[Difference]:
    """Of all quantities that both have. Axes are lines: where they point to does not count."""
    found = []
    for quantity, length, angle, sigmas in _pairs(first, second):
        size = length if angle is None else angle
        assert size is not None
        found.append(Difference(one, other, quantity, length, angle, *(_over(size, sigma) for sigma in sigmas)))
    return found


Sigmas = tuple[Array | float | None, Array | float | None]
Pair = tuple[str, float | None, float | None, Sigmas]
"""Quantity, length (m) or angle (rad), and the sigmas of both."""


def _pairs(a: CalibrationResult, b: CalibrationResult) -> Iterator[Pair]:
    names = {OFFSET: "offset_sensor_pivot_m", MAJOR_RADIUS: "major_radius_m", MINOR_RADIUS: "minor_radius_m"}
    for quantity, name in names.items():
        values = getattr(a, name), getattr(b, name)
        if values[0] is not None and values[1] is not None:
            apart = float(np.linalg.norm(np.subtract(*values)))
            yield quantity, apart, None, (getattr(a.sigma, name), getattr(b.sigma, name))
    if a.axis_non_orthogonality_rad is not None and b.axis_non_orthogonality_rad is not None:
        sigmas = a.sigma.axis_non_orthogonality_rad, b.sigma.axis_non_orthogonality_rad
        yield NON_ORTHOGONALITY, None, _skewness(a, b), sigmas
    if a.orbital_axis_sensor is not None and b.orbital_axis_sensor is not None:
        angle = _between_lines(a.orbital_axis_sensor, b.orbital_axis_sensor)
        yield ORBITAL_AXIS, None, angle, (a.sigma.orbital_axis_sensor, b.sigma.orbital_axis_sensor)
    yield from _of_placements(a, b)


def _of_placements(a: CalibrationResult, b: CalibrationResult) -> Iterator[Pair]:
    number = {placement.label: k for k, placement in enumerate(b.placements)}
    for k, here in enumerate(a.placements):
        if here.label not in number:
            continue
        there = b.placements[number[here.label]]
        sigmas = [
            result.sigma.placements[i] if result.sigma.placements else None
            for result, i in ((a, k), (b, number[here.label]))
        ]
        suffix = f" {here.label}" if here.label else ""
        apart = float(np.linalg.norm(here.torus_center_world_m - there.torus_center_world_m))
        centres = [s and s.torus_center_world_m for s in sigmas]
        yield CENTRE + suffix, apart, None, (centres[0], centres[1])
        if here.angular_axis_world is not None and there.angular_axis_world is not None:
            angle = _between_lines(here.angular_axis_world, there.angular_axis_world)
            axes = [s and s.angular_axis_world for s in sigmas]
            yield ANGULAR_AXIS + suffix, None, angle, (axes[0], axes[1])


def _skewness(a: CalibrationResult, b: CalibrationResult) -> float:
    """Its sign follows that of R: where the two results count R the other way, it is turned."""
    one, other = a.axis_non_orthogonality_rad or 0.0, b.axis_non_orthogonality_rad or 0.0
    same_sense = (a.major_radius_signed_m or 0.0) * (b.major_radius_signed_m or 0.0) >= 0
    return abs(one - other) if same_sense else abs(one + other)


def _between_lines(u: Array, v: Array) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(u, v)), abs(u @ v)))


def _over(size: float, sigma: Array | float | None) -> float | None:
    total = 0.0 if sigma is None else float(np.linalg.norm(sigma))
    return size / total if total > 0 else None
