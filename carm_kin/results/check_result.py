"""What a check of a saved calibration finds: metres and radians in Python, named units in its JSON file."""

import os
from dataclasses import dataclass
from math import degrees
from typing import Any

from carm_kin.errors import printable
from carm_kin.results.parts import Provenance
from carm_kin.results.result_json import json_text, object_of
from carm_kin.results.summary import Line, check_lines, text_of
from solvers.estimate import Note

SCHEMA = "carm-kin/check/1"


@dataclass(frozen=True)
class Length:
    """How far a length differs, in m."""

    difference_m: float
    sigma_m: float
    """One standard deviation of the difference."""
    limit_m: float
    within: bool

    @property
    def shown(self) -> tuple[float, float, str]:
        """Difference, limit and their unit, for a person."""
        return self.difference_m * 1e3, self.limit_m * 1e3, "mm"


@dataclass(frozen=True)
class Angle:
    """How far an angle differs, in rad."""

    difference_rad: float
    sigma_rad: float
    """One standard deviation of the difference."""
    limit_rad: float
    within: bool

    @property
    def shown(self) -> tuple[float, float, str]:
        """Difference, limit and their unit, for a person."""
        return degrees(self.difference_rad), degrees(self.limit_rad), "deg"


@dataclass(frozen=True, eq=False)
class Check:
    """What `carm_kin.check` returns. Of a refused recording that alone is compared which an axis that turned tells."""

    status: str
    """``passed``, ``failed`` or ``refused``."""
    tolerance_m: float
    tolerance_rad: float
    poses: int
    used: int
    """Poses that agree with one C-arm."""
    warnings: tuple[Note, ...]
    provenance: Provenance
    offset: Length | None = None
    """Distance of the two offsets."""
    orbital_axis: Angle | None = None
    """Between the two orbital axes in the sensor's frame."""
    orbital_zero: Angle | None = None
    """Turn of the sensor about the orbital axis; None unless labels give beta = 0 in both recordings."""
    major_radius: Length | None = None
    non_orthogonality: Angle | None = None
    pose_position: Length | None = None
    """Root mean square position error of the poses by the saved calibration beyond that by their own."""
    pose_rotation: Angle | None = None
    """The same of the orientations."""
    extrapolated: int = 0
    """Used poses outside of the angles over which the deformation of the C was calibrated."""
    failures: tuple[str, ...] = ()
    """In words."""
    unseen: tuple[str, ...] = ()
    """Changes that this recording cannot show, in words."""
    refusal: Note | None = None

    @property
    def verdict(self) -> str:
        """The status in a sentence."""
        return {
            "passed": "passed: the saved calibration holds",
            "failed": "failed: the saved calibration does not hold",
            "refused": "refused: whether the saved calibration holds is not known",
        }[self.status]

    def __str__(self) -> str:
        """What `carm-kin check` prints."""
        words = text_of([*check_lines(self), Line(self.verdict)], self.warnings, self.refusal)
        return f"{words}\n{printable('failed: ' + '; '.join(self.failures))}" if self.failures else words

    def __repr__(self) -> str:
        """One line."""
        why = f" ({self.refusal.code})" if self.refusal else ""
        offset = f", offset differs by {self.offset.difference_m * 1e3:.3f} mm" if self.offset else ""
        return f"Check {self.status}{why}: {self.used} of {self.poses} poses{offset}"

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file: mm and degrees, units in the names."""
        return object_of(SCHEMA, self)

    def to_json(self, path: str | os.PathLike | None = None) -> str:
        """The JSON text; written to ``path``, whole or not at all, where one is given."""
        return json_text(self.to_dict(), path)
