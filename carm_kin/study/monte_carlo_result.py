"""What a study of simulated recordings returns."""

import os
from dataclasses import dataclass
from typing import Any

from carm_kin.results.parts import Provenance
from carm_kin.results.result_json import json_text, object_of
from carm_kin.study.intervals import Interval

SCHEMA = "carm-kin/study/1"


@dataclass(frozen=True)
class Simulation:
    """What is simulated anew for every seed; see `carm_kin.simulate`."""

    urdf: str
    protocol: str = "clinical"
    sigma_t_m: float = 0.0
    sigma_r_rad: float = 0.0
    outliers: float = 0.0
    missing: float = 0.0
    labels: bool = True
    angular: str | None = None
    orbital: str | None = None
    sensor_link: str | None = None


@dataclass(frozen=True)
class SolverStudy:
    """One solver over all recordings. Every ``_95_`` is a confidence interval; None where there is no number."""

    solver: str
    runs: int
    refused: int
    """Runs without a result."""
    first_reason: str | None
    """Why the first of them had none."""
    offset_rms_m: float | None
    offset_rms_95_m: Interval | None
    major_radius_bias_m: float | None
    """Mean of estimate less truth."""
    major_radius_bias_95_m: Interval | None
    major_radius_rms_m: float | None
    major_radius_rms_95_m: Interval | None
    orbital_axis_rms_rad: float | None
    orbital_axis_rms_95_rad: Interval | None
    angular_axis_rms_rad: float | None
    angular_axis_rms_95_rad: Interval | None
    coverage: float | None
    """Share of runs whose 95% ellipsoid of the offset holds the truth."""
    coverage_95: Interval | None
    time_s: float | None
    """Median."""
    time_95_s: Interval | None


@dataclass(frozen=True)
class PairStudy:
    """Two solvers on those recordings for which both have a result."""

    first: str
    second: str
    runs: int
    offset_ratio: float | None
    """RMS error of the offset of the first over that of the second."""
    offset_ratio_95: Interval | None
    first_nearer: float | None
    """Share of the runs in which the first is nearer to the true offset."""
    first_nearer_95: Interval | None


@dataclass(frozen=True)
class Study:
    """What `study` returns."""

    simulation: Simulation
    seeds: tuple[int, ...]
    solvers: tuple[SolverStudy, ...]
    pairs: tuple[PairStudy, ...]
    offset_errors_m: tuple[tuple[float, ...], ...]
    """For each solver, for each seed; NaN where there is no result."""
    provenance: Provenance

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file: mm and degrees, units in the names."""
        return object_of(SCHEMA, self)

    def to_json(self, path: str | os.PathLike | None = None) -> str:
        """The JSON text; written to ``path``, whole or not at all, where one is given."""
        return json_text(self.to_dict(), path)
