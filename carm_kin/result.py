"""The result of a calibration: metres and radians in Python, named units in its JSON file."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from carm_kin.errors import InputError
from solvers.estimate import Covariance, Note
from solvers.se3 import Array

SCHEMA = "carm-kin/result/1"


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
    angles_rad: Array | None = field(default=None)
    """(N, 2) alpha and beta of every pose; not written to the file."""

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file: mm and degrees, units in the names."""
        skipped = ("angles_rad", "residuals_per_sweep", "covariance")
        data = {"schema": SCHEMA} | {
            _unit_name(f.name): _plain(getattr(self, f.name), f.name) for f in fields(self) if f.name not in skipped
        }
        per_sweep = [_plain(r, "") for r in self.residuals_per_sweep]
        data["residuals"] = {"overall": data["residuals"], "per_sweep": per_sweep}
        data["covariance"] = _covariance(self.covariance)
        return data

    def to_json(self, path: str | os.PathLike | None = None) -> str:
        """The JSON text; written to ``path``, atomically, where one is given."""
        text = json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n"
        if path is not None:
            write_atomically(Path(path), text)
        return text


def write_atomically(path: Path, text: str) -> None:
    """Write a whole file or nothing. Raises InputError where the place cannot be written."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise InputError(f"cannot be written: {error.strerror}", file=path) from None


def _unit_name(name: str) -> str:
    """The key in the file: millimetres for metres, degrees for radians."""
    if name.endswith("_m"):
        return name[:-2] + "_mm"
    return name[:-4] + "_deg" if name.endswith("_rad") else name


def _plain(value: Any, name: str) -> Any:
    """JSON values of a dataclass, in the units of the file."""
    if is_dataclass(value) and not isinstance(value, type):
        return {_unit_name(f.name): _plain(getattr(value, f.name), f.name) for f in fields(value)}
    if isinstance(value, Mapping):
        return {_unit_name(str(k)): _plain(v, str(k)) for k, v in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(v, name) for v in value]
    if isinstance(value, np.ndarray):
        return _scaled_array(value, name).tolist()
    if isinstance(value, (float, np.floating)):
        scaled = float(value) * _factor(name)
        return scaled if np.isfinite(scaled) else None
    return value.item() if isinstance(value, np.generic) else value


def _factor(name: str) -> float:
    if name.endswith("_m"):
        return 1e3
    return float(np.degrees(1.0)) if name.endswith("_rad") else 1.0


def _scaled_array(value: Array, name: str) -> Array:
    if name.startswith("T_"):
        value = value.copy()
        value[:3, 3] *= 1e3
        return value
    return value * _factor(name)


def _covariance(covariance: Covariance | None) -> dict[str, Any] | None:
    if covariance is None:
        return None
    names, scale = [], []
    for name in covariance.names:
        angle, unit_vector = "orthogonality" in name, "_axis_" in name and "orthogonality" not in name
        names.append(name + ("_deg" if angle else "" if unit_vector else "_mm"))
        scale.append(np.degrees(1.0) if angle else 1.0 if unit_vector else 1e3)
    return {"names": names, "matrix": (covariance.matrix * np.outer(scale, scale)).tolist()}
