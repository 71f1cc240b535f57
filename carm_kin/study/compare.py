"""Every solver that a recording allows on the same poses and in the same gauge, beside each other and the truth."""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

import solvers
from carm_kin.calibration.by_settings import calibrate_as, two_axes_arguments
from carm_kin.calibration.cross_validate import cross_validate, errors_of
from carm_kin.calibration.settings import CHAIN, Settings
from carm_kin.errors import InputError, RefusedError
from carm_kin.recording.formats import RecordingLike, as_recording
from carm_kin.recording.recording import Recording
from carm_kin.results.differences import Difference, differences
from carm_kin.results.held_out import HeldOut, row_of
from carm_kin.results.parts import Provenance
from carm_kin.results.provenance import provenance_of
from carm_kin.results.result import CalibrationResult, ResultLike, as_result
from carm_kin.results.result_json import json_text, object_of
from carm_kin.results.shown import only_determined
from carm_kin.study import compare_view
from carm_kin.study.compare_view import REFERENCE, TRUTH
from solvers.estimate import Note

SCHEMA = "carm-kin/comparison/1"


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
    fitted: HeldOut | None
    """Errors of the counted poses, the fit to all of them being given."""
    held_out: HeldOut | None
    """Errors of the counted poses, each by a fit that it had no part in."""
    errors_reason: str | None
    """Why there are none."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """What `compare` returns."""

    poses: int
    """What every solver was given."""
    counted: int
    """Poses whose errors count, the same for every solver."""
    runs: tuple[Run, ...]
    differences: tuple[Difference, ...]
    """Of every two solvers, and of every solver and the truth."""
    provenance: Provenance

    def __str__(self) -> str:
        """The tables that `carm-kin compare` prints, and why a solver has no answer."""
        return compare_view.text_of(self)

    def __repr__(self) -> str:
        """One line."""
        answers = ", ".join(f"{run.solver} {run.reason.code if run.reason else 'ok'}" for run in self.runs)
        return f"Comparison on {self.poses} poses: {answers}"

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file: mm and degrees, units in the names."""
        data = object_of(SCHEMA, self)
        for run, value in zip(self.runs, data["runs"], strict=True):
            value["result"] = run.result.to_dict() if run.result else None
        return data

    def to_json(self, path: str | os.PathLike | None = None) -> str:
        """The JSON text; written to ``path``, whole or not at all, where one is given."""
        return json_text(self.to_dict(), path)


def agreement(recording: Recording, settings: Settings = Settings()) -> np.ndarray:
    """(N,) which poses the solver ``kinematic`` keeps; all where it has no result."""
    run = _run(recording, replace(settings, solver=REFERENCE), np.ones(len(recording), dtype=bool), None)
    if run.result is None:
        return np.ones(len(recording), dtype=bool)
    return ~np.isin(recording.pose_number, run.result.outliers.indices)


def compare(
    recording: RecordingLike,
    names: str | Sequence[str] | None = None,
    *,
    settings: Settings = Settings(),
    counted: np.ndarray | None = None,
    truth: ResultLike | None = None,
    folds: int | None = 5,
    command: str | None = None,
) -> Comparison:
    """Calibrate a recording, which may be a path, with the solvers ``names``, comma between where they are one text; by
    default all, and with a URDF in the settings its chain too.

    ``settings`` are those of the joints and of the noise. Every solver has its default options, so that all share the
    gauge of docs/gauge.md, and all poses. Errors are of the poses ``counted`` (N,), by default all: `agreement` tells
    which belong together. ``folds`` is the number of parts that are held out in turn, None for no such check.

    Raises InputError for unknown solvers and for joints that the recording does not have.
    """
    recording, truth = as_recording(recording), None if truth is None else as_result(truth)
    names = [name.strip() for name in names.split(",")] if isinstance(names, str) else names
    every = (*solvers.solver_names(), *((CHAIN,) if settings.urdf else ()))
    chosen = tuple(dict.fromkeys(names or every))
    for name in chosen:
        replace(settings, solver=name).check()
    two_axes_arguments(recording, settings)
    mask = np.ones(len(recording), dtype=bool) if counted is None else counted
    runs = tuple(_run(recording, replace(settings, solver=name), mask, folds) for name in chosen)
    found = [difference for a, b in combinations(runs, 2) for difference in _between(a, b.result, b.solver)]
    if truth is not None:
        found += [difference for run in runs for difference in _between(run, truth, TRUTH)]
    return Comparison(len(recording), int(mask.sum()), runs, tuple(found), provenance_of(recording, command, None))


def _between(run: Run, other: CalibrationResult | None, name: str) -> list[Difference]:
    if run.result is None or other is None:
        return []
    return differences(only_determined(run.result), only_determined(other), run.solver, name)


def _run(recording: Recording, settings: Settings, counted: np.ndarray, folds: int | None) -> Run:
    name = settings.solver_name
    try:
        calibrate_as(recording, settings)
        start = time.perf_counter()
        result = calibrate_as(recording, settings)
        seconds = time.perf_counter() - start
    except InputError as error:
        return Run(name, None, Note("not_possible", str(error)), None, None, None, None)
    if result.refusal:
        return Run(name, None, result.refusal, seconds, None, None, None)
    fitted, no_fitted = _errors_of(_fitted, recording, settings, result, counted)
    held_out, no_held_out = None, None
    if folds is not None:
        held_out, no_held_out = _errors_of(partial(_held_out, folds), recording, settings, result, counted)
    return Run(name, result, None, seconds, fitted, held_out, no_fitted or no_held_out)


def _errors_of(of: Callable[..., HeldOut], *given: Any) -> tuple[HeldOut | None, str | None]:
    """The errors, or why there are none."""
    try:
        errors = of(*given)
    except (InputError, RefusedError) as error:
        return None, str(error)
    return (None, errors.refusal.message) if errors.refusal else (errors, None)


def _fitted(recording: Recording, settings: Settings, result: CalibrationResult, counted: np.ndarray) -> HeldOut:
    arguments = two_axes_arguments(recording, settings)
    errors = errors_of(recording, result, counted, arguments["angular"], arguments["orbital"])
    return row_of("fitted", (), errors.poses, errors, None)


def _held_out(
    folds: int, recording: Recording, settings: Settings, result: CalibrationResult, counted: np.ndarray
) -> HeldOut:
    if settings.solver_name != CHAIN:
        arguments = two_axes_arguments(recording, settings)
        return cross_validate(recording, folds, settings.solver, counted=counted, **arguments).overall
    whole = calibrate_as(recording, replace(settings, cross_validate=folds)).cross_validation
    assert whole is not None
    return whole.overall
