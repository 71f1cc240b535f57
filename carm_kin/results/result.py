"""The result of a calibration: metres and radians in Python, named units in its JSON file."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from carm_kin.errors import InputError, wrong_type
from carm_kin.results.chain_result import ChainCalibration
from carm_kin.results.deformation import Deformation
from carm_kin.results.figure import result_figure
from carm_kin.results.held_out import CrossValidation
from carm_kin.results.html import html_table
from carm_kin.results.parts import (
    NoiseLevel,
    Observability,
    Outliers,
    Placement,
    Provenance,
    Residuals,
    Sigma,
    SigmaPart,
    SystematicEffect,
    ToldOffset,
    TrackerScale,
)
from carm_kin.results.result_json import (
    json_text,
    name_in_file,
    of_json_object,
    of_json_value,
    read_object,
    to_json_value,
)
from carm_kin.results.shown import fixed_quantities
from carm_kin.results.summary import in_mm, result_lines, result_rows, text_of
from solvers.estimate import Covariance, Note
from solvers.likelihood.covariance import interval_of_magnitude, radius_95
from solvers.se3 import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "carm-kin/result/1"
NOT_IN_FILE = ("angles_rad",)
INTERVAL, WITHIN, HELD = "major_radius_interval_95_m", "offset_within_95_m", "fixed"
"""Written to the file although they follow from other numbers there."""
TOLERANCE = 1e-6
"""How far the axes and rotations of a file may be from unit length and orthonormality."""


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """What `carm_kin.calibrate` returns. Numbers that the solver cannot give are None, with a warning
    that says why; a refused result has none at all."""

    status: str
    """``ok``; ``doubtful`` where the parts of the recording disagree by more than the noise explains; ``partial`` where
    the motion tells a part of the offset only, which is in `told`; ``refused``."""
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
    sigma_parts: tuple[SigmaPart, ...] = ()
    """What `sigma` is made of; empty where no systematic effects were looked for."""
    effects: tuple[SystematicEffect, ...] = ()
    """Those for which `sigma` allows."""
    tracker_scale: TrackerScale | None = None
    """None where no length was known."""
    deformation: Deformation | None = None
    """How the C bends; None where it is rigid as far as the poses show."""
    angles_rad: Array | None = None
    """(N, 2) alpha and beta of every pose; not written to the file."""
    cross_validation: CrossValidation | None = None
    """None where it was not asked for."""
    chain: ChainCalibration | None = None
    """None but where a URDF's chain was calibrated."""
    told: ToldOffset | None = None
    """What is told of the offset where that is not all of it (status ``partial``); else None."""

    def __str__(self) -> str:
        """What `carm-kin calibrate` prints."""
        return text_of(result_lines(self), self.warnings, self.refusal)

    def __repr__(self) -> str:
        """One line."""
        why = f" ({self.refusal.code})" if self.refusal else ""
        t = self.offset_sensor_pivot_m
        offset = "" if t is None else f", offset {in_mm(t, self.sigma.offset_sensor_pivot_m)}"
        used = f"{self.used} of {self.poses} poses"
        return f"CalibrationResult {self.status}{why}: solver {self.solver}, {used}{offset}"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        head = f"{self.status}: solver {self.solver}, {self.used} of {self.poses} poses"
        return html_table(head, () if self.refusal else result_rows(self), self.warnings, self.refusal)

    def figure(self) -> "Figure":
        """The calibrated C-arm in the frame of its torus, with the fitted poses, and the angles that they cover.

        The poses are there as long as the result was not read from a file. Raises InputError where the result is
        refused or holds no complete chain, MissingDependencyError without matplotlib.
        """
        return result_figure(self)

    @property
    def major_radius_interval_95_m(self) -> tuple[float, float] | None:
        """The 95% interval of |R|; it begins at 0, one-sided, where R is not told from 0. None without a sigma."""
        return _interval(self.major_radius_m, self.sigma.major_radius_m)

    @property
    def fixed(self) -> tuple[str, ...]:
        """Quantities that were held instead of estimated, such as ``axis_non_orthogonality``; they have no sigma."""
        return fixed_quantities(self.covariance, self.major_radius_m)

    @property
    def offset_within_95_m(self) -> float | None:
        """How far off the offset may be: the radius of the ball about it that holds the true one with 95%, by the
        stated covariance. None without one."""
        if self.covariance is None or not len(self.covariance.block("offset")):
            return None
        return radius_95(self.covariance.block("offset"))

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file: mm and degrees, units in the names."""
        written = [f.name for f in fields(self) if f.name not in NOT_IN_FILE]
        data: dict[str, Any] = {"schema": SCHEMA}
        data |= {name_in_file(name): to_json_value(getattr(self, name), name) for name in written}
        data["residuals"] = {"overall": data["residuals"], "per_sweep": data.pop("residuals_per_sweep")}
        interval_mm = _interval(data["major_radius_mm"], data["sigma"]["major_radius_mm"])
        data[name_in_file(INTERVAL)] = to_json_value(interval_mm)
        data[HELD] = list(self.fixed)
        data[name_in_file(WITHIN)] = to_json_value(self.offset_within_95_m, WITHIN)
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
            for name in (name_in_file(WITHIN), HELD):
                data.pop(name, None)
            key = name_in_file(INTERVAL)
            if key not in data:
                raise InputError(f"the result: '{key}' is missing")
            interval = of_json_value(tuple[float, float] | None, data.pop(key), INTERVAL, key)
            result = of_json_object(CalibrationResult, data, "", skipped=NOT_IN_FILE)
            if problem := _contradiction(result, interval):
                raise InputError(problem)
        except InputError as error:
            raise InputError(str(error), file=path) from None
        return result


ResultLike = CalibrationResult | str | os.PathLike
"""A calibration, or the path of its JSON file."""


def as_result(result: ResultLike) -> CalibrationResult:
    """A calibration as it is, or the one in a file. Raises InputError as `read_result`."""
    return result if isinstance(result, CalibrationResult) else read_result(result)


def read_result(path: str | os.PathLike) -> CalibrationResult:
    """The calibration in a file that `CalibrationResult.to_json` wrote. Raises InputError for anything else."""
    if not isinstance(path, (str, os.PathLike)):
        raise wrong_type(path, "a calibration (a CalibrationResult, or the path of its JSON file)")
    return CalibrationResult.from_json(path)


def _interval(magnitude: float | None, sigma: float | None) -> tuple[float, float] | None:
    return None if magnitude is None or sigma is None else interval_of_magnitude(magnitude, sigma)


def _contradiction(result: CalibrationResult, interval_m: tuple[float, ...] | None) -> str | None:
    """What in a result that was read cannot be, in words; ``interval_m`` is the interval of |R| that stood with it."""
    unit = [result.orbital_axis_sensor, *(placement.angular_axis_world for placement in result.placements)]
    rigid = [result.T_sensor_carm, *(placement.T_world_torus for placement in result.placements)]
    lengths = [result.major_radius_m, result.minor_radius_m, result.sigma.major_radius_m, result.sigma.minor_radius_m]
    refused = result.refusal is not None
    numbers = [result.offset_sensor_pivot_m, result.axis_non_orthogonality_rad, result.covariance, *unit, *rigid]
    numbers += lengths
    checks = {
        "status must be 'ok' or 'doubtful' without a refusal, 'partial' with a part that is told, or 'refused' with a "
        "refusal": result.status
        not in (("refused",) if refused else ("partial",) if result.told else ("ok", "doubtful")),
        "a refused result must hold no numbers": refused and any(x is not None for x in [*numbers, result.told]),
        "a partial result must hold no numbers but those that are told": result.told is not None
        and any(x is not None for x in numbers),
        "the directions that are told and untold are not orthogonal": not _orthogonal(result.told),
        "an axis is no unit vector": any(x is not None and abs(x @ x - 1) > TOLERANCE for x in unit),
        "a transform is no rigid motion": any(x is not None and not _is_rigid(x) for x in rigid),
        "a length is below 0": any(x is not None and x < 0 for x in lengths),
        "the interval of the major radius is not the one that follows from its sigma": not _same_interval(
            result.major_radius_interval_95_m, interval_m
        ),
        "the numbers of poses, used poses and outliers contradict each other": not (
            0 <= result.used <= result.poses and result.outliers.count == len(result.outliers.indices)
        ),
        "the reasons of the outliers name other poses or count them wrong": not _counted(result),
        "the covariance is not symmetric": result.covariance is not None
        and not np.allclose(result.covariance.matrix, result.covariance.matrix.T, rtol=TOLERANCE),
    }
    return next((words for words, wrong in checks.items() if wrong), None)


def _orthogonal(told: ToldOffset | None) -> bool:
    if told is None:
        return True
    d = np.array([*(one.direction_sensor for one in told.told), *told.untold_directions_sensor])
    some = told.told and told.untold_directions_sensor and len(told.untold_sigma_rad) == len(d) - len(told.told)
    return bool(some) and d.shape == (3, 3) and bool(np.abs(d @ d.T - np.eye(3)).max() < TOLERANCE)


def _counted(result: CalibrationResult) -> bool:
    """Whether the reasons divide some of the outliers among them."""
    reasons = result.outliers.reasons
    named = [pose for reason in reasons for pose in reason.indices]
    once = len(set(named)) == len(named) and set(named) <= set(result.outliers.indices)
    return once and all(reason.count == len(reason.indices) for reason in reasons)


def _same_interval(expected: tuple[float, float] | None, stated: tuple[float, ...] | None) -> bool:
    if expected is None or stated is None or len(stated) != 2:
        return expected is stated is None
    return bool(np.allclose(stated, expected, rtol=0.0, atol=TOLERANCE * expected[1]))


def _is_rigid(T: Array) -> bool:
    R = T[:3, :3]
    orthonormal = np.abs(R.T @ R - np.eye(3)).max() < TOLERANCE and np.linalg.det(R) > 0
    return bool(orthonormal and (T[3] == (0, 0, 0, 1)).all())
