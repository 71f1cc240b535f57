"""Every solver that a recording allows on the same poses and in the same gauge, beside each other and the truth."""

import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

import solvers
from carm_kin.cli_arguments import joint_names
from carm_kin.differences import Difference, differences
from carm_kin.errors import InputError, RefusedError
from carm_kin.held_out import HeldOut
from carm_kin.provenance import provenance_of
from carm_kin.recording import Recording
from carm_kin.result import CalibrationResult, Provenance
from carm_kin.result_json import name_in_file, to_json_value, write_atomically
from carm_kin.settings import CHAIN, Settings, calibrate_as
from solvers.estimate import Note

SCHEMA = "carm-kin/comparison/1"
TRUTH = "truth"
REFERENCE = "kinematic"
"""The solver by which poses that disagree are told, and beside which the others are shown."""


@dataclass(frozen=True, eq=False)
class Run:
    """One solver's answer."""

    solver: str
    result: CalibrationResult | None
    """None where the solver has none."""
    reason: Note | None
    """Why there is none: the code of the refusal, or ``not_possible`` for what the recording lacks."""
    time_s: float | None
    """Of the calibration, once warm."""
    held_out: HeldOut | None
    """Errors of poses that were left out of the fit."""
    held_out_reason: str | None
    """Why there are none."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """What `compare` returns."""

    poses: int
    left_out: int
    """Poses of the recording that no solver was given, since they disagree with the others."""
    runs: tuple[Run, ...]
    differences: tuple[Difference, ...]
    """Of every two solvers, and of every solver and the truth."""
    provenance: Provenance

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file: mm and degrees, units in the names."""
        data = {name_in_file(f.name): to_json_value(getattr(self, f.name), f.name) for f in fields(self)}
        for run, value in zip(self.runs, data["runs"], strict=True):
            value["result"] = run.result.to_dict() if run.result else None
        return {"schema": SCHEMA} | data

    def to_json(self, path: str | os.PathLike | None = None) -> str:
        """The JSON text; written to ``path``, whole or not at all, where one is given."""
        text = json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n"
        if path is not None:
            write_atomically(Path(path), text)
        return text


def agreeing(recording: Recording, settings: Settings = Settings()) -> Recording:
    """The poses that the solver ``kinematic`` keeps, so that no solver is judged by its treatment of outliers.

    All poses where it has no result.
    """
    run = _run(recording, replace(settings, solver=REFERENCE), folds=None)
    if run.result is None:
        return recording
    return recording.select(~np.isin(recording.pose_number, run.result.outliers.indices))


def compare(
    recording: Recording,
    names: Sequence[str] | None = None,
    *,
    settings: Settings = Settings(),
    truth: CalibrationResult | None = None,
    folds: int | None = 5,
    left_out: int = 0,
    command: str | None = None,
) -> Comparison:
    """Calibrate a recording with the solvers ``names``; by default all, and with a URDF in the settings its chain too.

    ``settings`` are those of the joints and of the noise. Every solver has its default options, so that all share the
    gauge of docs/gauge.md. ``folds`` is the number of parts that are held out in turn, None for no such check;
    ``left_out`` says how many poses have been taken out before, as by `agreeing`.

    Raises InputError for unknown solvers and for joints that the recording does not have.
    """
    every = (*solvers.solver_names(), *((CHAIN,) if settings.urdf else ()))
    chosen = tuple(dict.fromkeys(names or every))
    for name in chosen:
        replace(settings, solver=name).check()
    joint_names(recording, settings.urdf, settings.sensor_link, settings.angular, settings.orbital)
    runs = tuple(_run(recording, replace(settings, solver=name), folds) for name in chosen)
    found = [difference for a, b in combinations(runs, 2) for difference in _between(a, b.result, b.solver)]
    if truth is not None:
        found += [difference for run in runs for difference in _between(run, truth, TRUTH)]
    provenance = provenance_of(recording, command, None)
    return Comparison(len(recording), left_out, runs, tuple(found), provenance)


def _between(run: Run, other: CalibrationResult | None, name: str) -> list[Difference]:
    return [] if run.result is None or other is None else differences(run.result, other, run.solver, name)


def _run(recording: Recording, settings: Settings, folds: int | None) -> Run:
    name = settings.solver_name
    try:
        calibrate_as(recording, settings)
        start = time.perf_counter()
        result = calibrate_as(recording, settings)
        seconds = time.perf_counter() - start
    except InputError as error:
        return Run(name, None, Note("not_possible", str(error)), None, None, None)
    if result.refusal:
        return Run(name, None, result.refusal, seconds, None, None)
    held_out, reason = _held_out(recording, settings, folds)
    return Run(name, result, None, seconds, held_out, reason)


def _held_out(recording: Recording, settings: Settings, folds: int | None) -> tuple[HeldOut | None, str | None]:
    if folds is None:
        return None, None
    try:
        whole = calibrate_as(recording, replace(settings, cross_validate=folds)).cross_validation
    except (InputError, RefusedError) as error:
        return None, str(error)
    assert whole is not None
    return (whole.overall, None) if whole.overall.refusal is None else (None, whole.overall.refusal.message)
