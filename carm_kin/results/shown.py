"""Which numbers of a result a person is shown: not those that are so uncertain that they mean nothing."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from carm_kin.results.parts import Placement
from solvers.estimate import MEANINGLESS_M, MEANINGLESS_RAD, Covariance
from solvers.se3 import Array

if TYPE_CHECKING:
    from carm_kin.results.result import CalibrationResult

NOT_DETERMINED, FIXED = "not determined", "fixed"
FIXED_SIGMA = 1e-11
"""m or rad: a standard deviation below comes of rounding, the number was not estimated."""
SCALARS = ("major_radius", "minor_radius", "axis_non_orthogonality")
"""Quantities that a solver may hold fixed."""


def determined(sigma: Array | float | None, most: float) -> bool:
    """Whether no part of a number has a standard deviation above ``most``; one without any counts as determined."""
    return sigma is None or bool((np.asarray(sigma) <= most).all())


def length_determined(sigma_m: Array | float | None) -> bool:
    """`determined` of a length."""
    return determined(sigma_m, MEANINGLESS_M)


def angle_determined(sigma_rad: float | None) -> bool:
    """`determined` of an angle."""
    return determined(sigma_rad, MEANINGLESS_RAD)


def direction_determined(sigma: Array | None) -> bool:
    """`determined` of a unit vector with the standard deviations (3,) of its components."""
    return sigma is None or angle_determined(float(np.linalg.norm(sigma)))


def fixed_quantities(covariance: Covariance | None, major_radius_m: float | None) -> tuple[str, ...]:
    """Those of `SCALARS` that were not estimated but held: they have no variance, or the locus has no such radius."""
    if covariance is None:
        return ()
    held = [name for name in SCALARS if name in covariance.names and covariance.sigma(name)[0] < FIXED_SIGMA]
    no_radius = major_radius_m == 0.0 and "major_radius" not in covariance.names
    return (*held, *(("major_radius",) if no_radius else ()))


def only_determined(result: "CalibrationResult") -> "CalibrationResult":
    """The result without the numbers that are not determined: what a table or a chart beside others may show."""
    sigma, angle = result.sigma, result.axis_non_orthogonality_rad
    offset, axis = result.offset_sensor_pivot_m, result.orbital_axis_sensor
    radius = result.major_radius_m if length_determined(sigma.major_radius_m) else None
    return replace(
        result,
        offset_sensor_pivot_m=offset if length_determined(sigma.offset_sensor_pivot_m) else None,
        major_radius_m=radius,
        major_radius_signed_m=None if radius is None else result.major_radius_signed_m,
        minor_radius_m=result.minor_radius_m if length_determined(sigma.minor_radius_m) else None,
        axis_non_orthogonality_rad=angle if angle_determined(sigma.axis_non_orthogonality_rad) else None,
        orbital_axis_sensor=axis if direction_determined(sigma.orbital_axis_sensor) else None,
        placements=_determined_placements(result),
    )


def _determined_placements(result: "CalibrationResult") -> tuple[Placement, ...]:
    """Without the angular axes that are not determined."""
    found = []
    for k, placement in enumerate(result.placements):
        one = result.sigma.placements[k] if result.sigma.placements else None
        if one is None or direction_determined(one.angular_axis_world):
            found.append(placement)
        else:
            found.append(replace(placement, angular_axis_world=None))
    return tuple(found)
