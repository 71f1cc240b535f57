"""The result of a calibration: metres and radians in Python, named units in its JSON file."""

import contextlib
import json
import os
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from carm_kin.errors import InputError
from carm_kin.result_json import name_in_file, of_json_object, read_object, to_json_value
from solvers.estimate import Covariance, Note
from solvers.se3 import Array

SCHEMA = "carm-kin/result/1"
NOT_IN_FILE = ("angles_rad",)
TOLERANCE = 1e-6
"""How far the axes and rotations of a file may be from unit length and orthonormality."""


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
class Outliers:
    """Poses that were not used, numbered as in the recording's file."""

    count: int
    indices: tuple[int, ...]


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

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file: mm and degrees, units in the names."""
        written = [f.name for f in fields(self) if f.name not in NOT_IN_FILE]
        data = {"schema": SCHEMA} | {name_in_file(name): to_json_value(getattr(self, name), name) for name in written}
        data["residuals"] = {"overall": data["residuals"], "per_sweep": data.pop("residuals_per_sweep")}
        return data

    def to_json(self, path: str | os.PathLike | None = None) -> str:
        """The JSON text; written to ``path``, whole or not at all, where one is given.

        Raises InputError where the place cannot be written.
        """
        text = json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n"
        if path is not None:
            write_atomically(Path(path), text)
        return text

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
            result = of_json_object(CalibrationResult, data, "", skipped=NOT_IN_FILE)
            if problem := _contradiction(result):
                raise InputError(problem)
        except InputError as error:
            raise InputError(str(error), file=path) from None
        return result


def write_atomically(path: Path, text: str) -> None:
    """Write a whole file or nothing. Raises InputError where the place cannot be written."""
    if path.is_dir():
        raise InputError("is a folder; give the name of a file", file=path)
    temporary = path.with_name(f".{uuid.uuid4().hex}.part")
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=path) from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _contradiction(result: CalibrationResult) -> str | None:
    """What in a result that was read cannot be, in words."""
    unit = [result.orbital_axis_sensor, *(placement.angular_axis_world for placement in result.placements)]
    rigid = [result.T_sensor_carm, *(placement.T_world_torus for placement in result.placements)]
    lengths = [result.major_radius_m, result.minor_radius_m, result.sigma.major_radius_m, result.sigma.minor_radius_m]
    refused = result.refusal is not None
    numbers = [result.offset_sensor_pivot_m, result.axis_non_orthogonality_rad, result.covariance, *unit, *rigid]
    numbers += lengths
    checks = {
        "status must be 'ok' without a refusal or 'refused' with one": result.status
        != ("refused" if refused else "ok"),
        "a refused result must hold no numbers": refused and any(x is not None for x in numbers),
        "an axis is no unit vector": any(x is not None and abs(x @ x - 1) > TOLERANCE for x in unit),
        "a transform is no rigid motion": any(x is not None and not _is_rigid(x) for x in rigid),
        "a length is below 0": any(x is not None and x < 0 for x in lengths),
        "the numbers of poses, used poses and outliers contradict each other": not (
            0 <= result.used <= result.poses and result.outliers.count == len(result.outliers.indices)
        ),
        "the covariance is not symmetric": result.covariance is not None
        and not np.allclose(result.covariance.matrix, result.covariance.matrix.T, rtol=TOLERANCE),
    }
    return next((words for words, wrong in checks.items() if wrong), None)


def _is_rigid(T: Array) -> bool:
    R = T[:3, :3]
    orthonormal = np.abs(R.T @ R - np.eye(3)).max() < TOLERANCE and np.linalg.det(R) > 0
    return bool(orthonormal and (T[3] == (0, 0, 0, 1)).all())
