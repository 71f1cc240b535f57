"""What the search for a virtual scan centre finds: metres and radians in Python, named units in its JSON file."""

import os
from dataclasses import dataclass
from typing import Any

from carm_kin.results.parts import NoiseLevel, Outliers, Provenance
from carm_kin.results.result_json import json_text, object_of
from carm_kin.results.summary import Line, centre_lines, in_mm, text_of
from solvers.estimate import Note
from solvers.se3 import Array

SCHEMA = "carm-kin/virtual-centre/1"


@dataclass(frozen=True)
class Spread:
    """How far the centre moved in the world during the scan, by the measured poses."""

    rms_m: float
    """Root mean square distance from its mean place."""
    noise_m: float
    """What the noise of the poses alone makes of it."""
    beyond_noise_m: float
    """Root of the difference of their squares."""
    largest_m: float
    """Largest distance from the mean place."""
    largest_pose: int
    """The pose at which it is, numbered as in the recording's file."""
    chi2_per_dof: float
    """About 1 where one point stands still."""
    probability: float
    """Of so large a chi-square if one point stands still."""


@dataclass(frozen=True, eq=False)
class CentreSigma:
    """One-sigma values under the names of `VirtualCentre`, from both recordings' noise."""

    centre_carm_m: Array
    centre_sensor_m: Array
    centre_world_m: Array
    path_radius_m: float


@dataclass(frozen=True, eq=False)
class VirtualCentre:
    """What `carm_kin.virtual_centre` returns. Numbers are None where the scan is refused.

    Where no point stands still (``not_fixed``) the centre is that of the least spread, without a sigma.
    """

    status: str
    """``fixed``, ``not_fixed`` or ``refused``."""
    tolerance_m: float
    poses: int
    used: int
    outliers: Outliers
    noise: NoiseLevel
    """Of the poses, as given or as calibrated."""
    warnings: tuple[Note, ...]
    provenance: Provenance
    centre_carm_m: Array | None = None
    """(3,) in the C-arm frame, whose origin is the rotation centre. y = 0: a shift along the orbital axis, which is y,
    changes nothing."""
    centre_sensor_m: Array | None = None
    """(3,) in the sensor's frame."""
    centre_world_m: Array | None = None
    """(3,) where it stands."""
    path_radius_m: float | None = None
    """The rotation centre moves on a circle of this radius about the virtual centre, |centre_carm_m|."""
    path_rms_m: float | None = None
    """Root mean square distance of the measured rotation centres from that circle."""
    sigma: CentreSigma | None = None
    spread: Spread | None = None
    turn_rad: float | None = None
    """Range of the orbital angle."""
    alpha_rad: float | None = None
    """Mean angle about the angular axis. None, like the next two, where the base has turned since the calibration."""
    used_poses: tuple[int, ...] = ()
    """(M,) numbers of the used poses, as in the recording's file; the arrays below are in this order."""
    beta_rad: Array | None = None
    """(M,) orbital angles."""
    travel_torus_m: Array | None = None
    """(M, 3) measured rotation centres less the virtual centre along the axes of `torus`: horizontal travel, sideways,
    lift, where alpha = 0 is upright."""
    pivots_world_m: Array | None = None
    """(M, 3) measured rotation centres."""
    centres_world_m: Array | None = None
    """(M, 3) where each pose puts the virtual centre."""
    refusal: Note | None = None

    def __str__(self) -> str:
        """What `carm-kin centre` prints."""
        words = text_of([*centre_lines(self), Line(self.verdict)], self.warnings, self.refusal)
        return f"{words}\nnot fixed: {self.motion}" if self.motion else words

    @property
    def verdict(self) -> str:
        """The status in a sentence."""
        return {
            "fixed": "fixed: one point of the C-arm stands still",
            "not_fixed": "not fixed: no point of the C-arm stands still",
            "refused": "refused: whether a point stands still is not known",
        }[self.status]

    @property
    def motion(self) -> str:
        """How far the stillest point moves, in words; "" where one stands still or this is not known."""
        if self.status != "not_fixed" or not self.spread:
            return ""
        moves = f"{self.spread.beyond_noise_m * 1e3:.2f} mm (rms) beyond the noise"
        return f"no point stands still: the one that moves least moves by {moves}"

    def __repr__(self) -> str:
        """One line."""
        why = f" ({self.refusal.code})" if self.refusal else ""
        sigma = self.sigma and self.sigma.centre_carm_m
        centre = "" if self.centre_carm_m is None else f", centre in the C-arm {in_mm(self.centre_carm_m, sigma)}"
        return f"VirtualCentre {self.status}{why}: {self.used} of {self.poses} poses{centre}"

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file: mm and degrees, units in the names."""
        return object_of(SCHEMA, self)

    def to_json(self, path: str | os.PathLike | None = None) -> str:
        """The JSON text; written to ``path``, whole or not at all, where one is given."""
        return json_text(self.to_dict(), path)
