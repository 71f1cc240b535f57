"""How far the rotation centre wanders: metres and radians in Python, named units in its JSON and CSV files."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from carm_kin.files import write_atomically
from carm_kin.results.deformation import Deformation
from carm_kin.results.parts import Provenance
from carm_kin.results.result_json import json_text, object_of
from solvers.se3 import Array

SCHEMA = "carm-kin/isocentre/1"


@dataclass(frozen=True, eq=False)
class Ball:
    """The smallest ball that holds the rotation centre over a range of angles."""

    axis: str
    """``angular`` or ``orbital``, the other axis in the middle of its range, or ``both``."""
    diameter_m: float
    """By the deformation of the C alone."""
    sigma_m: float
    """One standard deviation of the distance of its two farthest points, taken as independent."""
    diameter_with_circle_m: float
    """With the circle of the major radius, on which the rotation centre moves by design."""
    walk_torus_m: Array
    """(3,) from the first to the last angle, in the torus frame: x along the angular axis; of both axes from one to the
    other of the two farthest points."""
    from_rad: Array
    """(2,) alpha and beta where the walk begins, and"""
    to_rad: Array
    """(2,) where it ends."""


@dataclass(frozen=True, eq=False)
class Isocentre:
    """What `carm_kin.isocentre` returns."""

    status: str
    """``found``, or against a tolerance ``passed`` or ``failed``."""
    tolerance_m: float | None
    """Greatest diameter over both axes that passes."""
    placement: str | None
    alpha_range_rad: tuple[float, ...]
    """Least and greatest calibrated angle."""
    beta_range_rad: tuple[float, ...]
    balls: tuple[Ball, ...]
    walks: tuple[str, ...]
    """The same in words."""
    deformation: Deformation | None = None
    provenance: Provenance | None = None

    def __str__(self) -> str:
        """What `carm-kin isocentre` prints."""
        rows = [f"{self.status}: smallest balls that hold the rotation centre"]
        for ball in self.balls:
            name = "both axes" if ball.axis == "both" else f"{ball.axis} axis"
            diameter = f"{ball.diameter_m * 1e3:8.3f} ± {ball.sigma_m * 1e3:.3f} mm"
            rows.append(f"  {name:<14}{diameter}, with its circle {ball.diameter_with_circle_m * 1e3:.3f} mm")
        if self.tolerance_m is not None:
            rows.append(f"  tolerance     {self.tolerance_m * 1e3:8.3f} mm over both axes")
        return "\n".join([*rows, *(f"  {walk}" for walk in self.walks)])

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file: mm and degrees, units in the names."""
        return object_of(SCHEMA, self)

    def to_json(self, path: str | os.PathLike | None = None) -> str:
        """The JSON text; written to ``path``, whole or not at all, where one is given.

        Raises InputError where the place cannot be written.
        """
        return json_text(self.to_dict(), path)

    def to_csv(self, path: str | os.PathLike) -> None:
        """A row an axis, for quality records. Raises InputError where the place cannot be written."""
        head = "date,status,axis,diameter_mm,sigma_mm,diameter_with_circle_mm,alpha_from_deg,alpha_to_deg,"
        rows = [head + "beta_from_deg,beta_to_deg"]
        date = "" if self.provenance is None else self.provenance.date
        for ball in self.balls:
            lengths = (x * 1e3 for x in (ball.diameter_m, ball.sigma_m, ball.diameter_with_circle_m))
            angles = np.degrees([*self.alpha_range_rad, *self.beta_range_rad])
            numbers = [*(f"{x:.4f}" for x in lengths), *(f"{x:.2f}" for x in angles)]
            rows.append(",".join([date, self.status, ball.axis, *numbers]))
        write_atomically(Path(path), "\n".join(rows) + "\n")
