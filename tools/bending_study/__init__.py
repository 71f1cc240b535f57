"""Calibrations of simulated recordings of one machine that sags, by a tracker that distorts, against the truth."""

import csv
import itertools
import tempfile
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

import carm_kin

SEEDS, SAGS_MM = 6, (0.0, 1.0, 2.0, 4.0)
ARCS_DEG = {60: (10, 60), 120: (-15, 85), 180: (-40, 110)}
"""Swivel of alpha about 0 -> range of beta."""


@dataclass(frozen=True)
class Row:
    """One calibration, and how far off its offset is."""

    sag_mm: float
    field_mm: float
    swivel_deg: int
    placements: int
    systematic: str
    seed: int
    status: str = ""
    error_mm: float = np.nan
    within_95_mm: float = np.nan
    effects: str = ""

    @property
    def recorded(self) -> tuple[float, float, int, int]:
        return self.sag_mm, self.field_mm, self.swivel_deg, self.placements


def cases() -> list[Row]:
    seeds = range(SEEDS)
    sags = itertools.product(SAGS_MM, (0.0, 0.2), (180,), (1,), ("auto", "none"), seeds)
    arcs = itertools.product((2.0,), (0.2,), (60, 120), (1,), ("auto",), seeds)
    placements = itertools.product((0.0,), (0.3,), (180,), (1, 2, 3), ("auto",), seeds)
    return [Row(*case) for case in (*sags, *arcs, *placements)]


def protocol(swivel_deg: int, placements: int) -> str:
    """Five orbital and three angular sweeps a placement; about 650 poses however many placements."""
    (low, high), half = ARCS_DEG[swivel_deg], swivel_deg / 2
    sweeps = [("orbital", low, high, "angular", x) for x in np.linspace(-half, half, 5)]
    sweeps += [("angular", -half, half, "orbital", x) for x in np.linspace(low, high, 5)[1:4]]
    return "".join(
        f'[[sweep]]\nmoving = "{moving}"\nfrom_deg = {a}\nto_deg = {b}\nstep_deg = {swivel_deg / 90 * placements}\n'
        f"held_deg = {{ {held} = {x}, cart_yaw = {60 * k} }}\nheld_mm = {{ cart_x = {400 * k}, lift = {150 * k} }}\n"
        for k in range(placements)
        for moving, a, b, held, x in sweeps
    )


def calibrated(case: Row) -> tuple[carm_kin.CalibrationResult, carm_kin.CalibrationResult]:
    """The result and the truth."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "protocol.toml"
        path.write_text(protocol(case.swivel_deg, case.placements), encoding="utf-8")
        noise: dict[str, Any] = {"sigma_t_m": 2e-4, "sigma_r_rad": float(np.radians(0.08)), "seed": case.seed}
        amount: dict[str, Any] = {"sag_m": case.sag_mm * 1e-3, "field_m": case.field_mm * 1e-3}
        recording, truth = carm_kin.simulate("mobile_skewed", path, **noise, **amount)
    return carm_kin.calibrate(recording, systematic=case.systematic), truth


def measured(case: Row) -> Row:
    result, truth = calibrated(case)
    found, within = result.offset_sensor_pivot_m, result.offset_within_95_m
    if found is None or within is None or truth.offset_sensor_pivot_m is None:
        return replace(case, status=result.status)
    error = float(np.linalg.norm(found - truth.offset_sensor_pivot_m))
    effects = " ".join(effect.name for effect in result.effects)
    return replace(
        case, status=result.status, error_mm=round(error * 1e3, 3), within_95_mm=round(within * 1e3, 3), effects=effects
    )


def write(rows: list[Row], path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, [field.name for field in fields(Row)], lineterminator="\n")
        table.writeheader()
        table.writerows(asdict(row) for row in rows)


def read(path: Path) -> list[Row]:
    kinds: list[Any] = [float, float, int, int, str, int, str, float, float, str]
    with path.open(encoding="utf-8", newline="") as file:
        return [Row(*(k(x) for k, x in zip(kinds, row, strict=True))) for row in list(csv.reader(file))[1:]]
