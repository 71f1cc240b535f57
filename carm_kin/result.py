"""The result of a calibration: metres and radians in Python, named units in its JSON file."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from carm_kin.chain_result import ChainCalibration
from carm_kin.errors import InputError
from carm_kin.held_out import CrossValidation
from carm_kin.intake import Intake
from carm_kin.result_checks import contradiction
from carm_kin.result_json import (
    json_text,
    name_in_file,
    of_json_object,
    of_json_value,
    read_object,
    to_json_value,
)
from solvers.covariance import interval_of_magnitude
from solvers.estimate import Covariance, Note
from solvers.se3 import Array

SCHEMA = "carm-kin/result/1"
NOT_IN_FILE = ("angles_rad",)
INTERVAL = "major_radius_interval_95_m"
"""Written to the file although it follows from other numbers there."""


@dataclass(frozen=True, eq=False)
class Placement:
    """Where the C-arm's torus stands in the world, for one base placement."""

    label: str
    torus_center_world_m: Array
    """(3,)."""
    angular_axis_world: Array | None
    """(3,) unit; None where the locus has no axes."""
    T_world_torus: Array | None
    """(4, 4), m; None where the solver gives no complete chain."""
    referenced: bool
    """Whether alpha = 0 comes from labels; else it is a convention."""


@dataclass(frozen=True, eq=False)
class PlacementSigma:
    """One-sigma values of a placement."""

    torus_center_world_m: Array | None
    angular_axis_world: Array | None


@dataclass(frozen=True, eq=False)
class Sigma:
    """One-sigma values under the names of the result; None where the solver gives none."""

    offset_sensor_pivot_m: Array | None = None
    major_radius_m: float | None = None
    minor_radius_m: float | None = None
    axis_non_orthogonality_rad: float | None = None
    orbital_axis_sensor: Array | None = None
    placements: tuple[PlacementSigma, ...] = ()


@dataclass(frozen=True)
class NoiseLevel:
    """One standard deviation an axis."""

    translation_m: float | None
    rotation_rad: float | None
    estimated: bool


@dataclass(frozen=True)
class Residuals:
    """What the model leaves of the used poses."""

    label: str
    """The sweep, or ``overall``."""
    translation_rms_m: float
    """Root mean square length of the position residual."""
    rotation_rms_rad: float | None
    """Root mean square rotation angle."""
    chi2_per_dof: float | None
    """None where the noise was not given and is therefore estimated from these residuals."""
    poses: int


@dataclass(frozen=True)
class Rejection:
    """Poses that were not used for one and the same reason, numbered as in the recording's file."""

    reason: str
    """In words, such as ``identical to the pose before``."""
    count: int
    indices: tuple[int, ...]


@dataclass(frozen=True)
class Outliers:
    """Poses that were not used, numbered as in the recording's file."""

    count: int
    indices: tuple[int, ...]
    reasons: tuple[Rejection, ...] = ()
    """Why, for as many of them as it is known; each pose stands under one reason at most."""


@dataclass(frozen=True, eq=False)
class Observability:
    """What the data determine."""

    singular_values: Array
    """Of the information matrix scaled to a unit diagonal, largest first."""
    condition: float | None
    unobservable: tuple[str, ...]
    """In words."""


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from."""

    versions: Mapping[str, str]
    input_name: str | None
    input_sha256: str | None
    command: str | None
    seed: int | None
    date: str
    intakes: tuple[Intake, ...] = ()
    """How the input was read, and what was dropped."""


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """What `carm_kin.calibrate` returns. Numbers that the solver cannot give are None, with a warning
    that says why; a refused result has none at all."""

    status: str
    """``ok`` or ``refused``."""
    solver: str
    options: Mapping[str, Any]
    offset_sensor_pivot_m: Array | None
    """(3,) the rotation centre in the sensor's frame."""
    major_radius_m: float | None
    """|R|, the distance of the two axes."""
    major_radius_signed_m: float | None
    """R as it stands in the chain formula: negative where labels put the pivot on the torus' -z side."""
    minor_radius_m: float | None
    """Radius of the sensor's orbit about the orbital axis."""
    axis_non_orthogonality_rad: float | None
    """epsilon: the axes enclose 90 degrees + epsilon."""
    orbital_axis_sensor: Array | None
    """(3,) unit, in the sensor's frame."""
    placements: tuple[Placement, ...]
    T_sensor_carm: Array | None
    """(4, 4), m: the C-arm frame at the rotation centre, in the sensor's frame."""
    orbital_referenced: bool
    """Whether beta = 0 comes from labels; else it is a convention."""
    sigma: Sigma
    covariance: Covariance | None
    noise: NoiseLevel
    residuals: Residuals
    residuals_per_sweep: tuple[Residuals, ...]
    poses: int
    """Poses in the recording, missing frames left out."""
    used: int
    outliers: Outliers
    observability: Observability
    warnings: tuple[Note, ...]
    refusal: Note | None
    provenance: Provenance
    angles_rad: Array | None = None
    """(N, 2) alpha and beta of every pose; not written to the file."""
    cross_validation: CrossValidation | None = None
    """None where it was not asked for."""
    chain: ChainCalibration | None = None
    """None but where a URDF's chain was calibrated."""

    @property
    def major_radius_interval_95_m(self) -> tuple[float, float] | None:
        """The 95% interval of |R|; it begins at 0, one-sided, where R is not told from 0. None without a sigma."""
        return _interval(self.major_radius_m, self.sigma.major_radius_m)

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file: mm and degrees, units in the names."""
        written = [f.name for f in fields(self) if f.name not in NOT_IN_FILE]
        data: dict[str, Any] = {"schema": SCHEMA}
        data |= {name_in_file(name): to_json_value(getattr(self, name), name) for name in written}
        data["residuals"] = {"overall": data["residuals"], "per_sweep": data.pop("residuals_per_sweep")}
        interval_mm = _interval(data["major_radius_mm"], data["sigma"]["major_radius_mm"])
        data[name_in_file(INTERVAL)] = to_json_value(interval_mm)
        return data

    def to_json(self, path: str | os.PathLike | None = None) -> str:
        """The JSON text; written to ``path``, whole or not at all, where one is given.

        Raises InputError where the place cannot be written.
        """
        return json_text(self.to_dict(), path)

    @staticmethod
    def from_json(path: str | os.PathLike) -> "CalibrationResult":
        """The result in a file that `to_json` wrote; ``angles_rad``, which is not written, is None.

        Writing it again gives the same bytes. Raises InputError that says what is wrong where, also for
        numbers that contradict each other or the status.
        """
        path = Path(path)
        data = read_object(path)
        if data.pop("schema", None) != SCHEMA:
            raise InputError(f"is no result that this version can read: 'schema' must be '{SCHEMA}'", file=path)
        try:
            residuals = data.get("residuals")
            if not isinstance(residuals, dict) or residuals.keys() != {"overall", "per_sweep"}:
                raise InputError("'residuals' must be an object with 'overall' and 'per_sweep'")
            data |= {"residuals": residuals["overall"], "residuals_per_sweep": residuals["per_sweep"]}
            key = name_in_file(INTERVAL)
            if key not in data:
                raise InputError(f"the result: '{key}' is missing")
            interval = of_json_value(tuple[float, float] | None, data.pop(key), INTERVAL, key)
            result = of_json_object(CalibrationResult, data, "", skipped=NOT_IN_FILE)
            if problem := contradiction(result, interval):
                raise InputError(problem)
        except InputError as error:
            raise InputError(str(error), file=path) from None
        return result


def _interval(magnitude: float | None, sigma: float | None) -> tuple[float, float] | None:
    return None if magnitude is None or sigma is None else interval_of_magnitude(magnitude, sigma)
