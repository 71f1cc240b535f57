"""Dated calibrations against control limits: whether the C-arm and its sensor are still what they were.

docs/quality.md has the rules.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from carm_kin.errors import InputError
from carm_kin.quality import trend_view
from carm_kin.quality.control_chart import (
    ALERT,
    BASELINE,
    FAIL,
    NOTE,
    PASS,
    Limits,
    Scatter,
    Values,
    judged,
    limits_of,
    scatter_of,
    scatters_more_than_stated,
    worst,
)
from carm_kin.quality.dated import Dated, PassedOver, ResultsLike, check_one_machine, in_order, sorted_out
from carm_kin.quality.quantities import LENGTH, OFFSET_CHANGE, OFFSET_COMPONENTS, Kind, offsets, scalars
from carm_kin.results.parts import Provenance
from carm_kin.results.provenance import provenance_of
from carm_kin.results.result import CalibrationResult
from carm_kin.results.result_json import json_text, name_in_file, object_of, to_json_value
from carm_kin.typed import above_zero
from solvers.estimate import Note
from solvers.se3 import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "carm-kin/trend/1"
USUAL_BASELINE = 5
"""Results of which the reference is the mean, where so many are followed by another one."""
FINE = BASELINE, PASS


@dataclass(frozen=True, eq=False)
class Chart:
    """One quantity over the N results: metres or radians, as its ``kind`` says."""

    quantity: str
    kind: Kind
    values: Array
    """(N,); of the change of the offset, the distance from the reference."""
    sigma: Array
    """(N,) one standard deviation as stated; of the change of the offset, the root of the summed variances."""
    reference: float
    """Mean of the baseline; 0 for the change of the offset."""
    scatter: float
    """One standard deviation by which the baseline scatters beyond what it states."""
    limits: Limits
    """(N,) each: of the distance from the reference."""
    statuses: tuple[str, ...]
    """Of each result by this quantity alone; none of a component of the offset: they count together, in the change of
    the offset."""

    @property
    def change(self) -> Array:
        """(N,) the values less the reference."""
        return self.values - self.reference

    def to_dict(self) -> dict[str, Any]:
        """As in the JSON file: mm or degrees, units in the names."""
        suffix, limits = self.kind.suffix, {f"{f.name}_beyond": getattr(self.limits, f.name) for f in fields(Limits)}
        numbers = {name: getattr(self, name) for name in ("values", "sigma", "reference", "scatter")} | limits
        named = {name_in_file(name + suffix): to_json_value(value, name + suffix) for name, value in numbers.items()}
        return {"quantity": self.quantity, **named, "statuses": list(self.statuses)}


@dataclass(frozen=True)
class Judged:
    """One calibration of a trend."""

    label: str
    date: str
    solver: str
    calibration: str
    """The status of the calibration itself."""
    status: str
    """``baseline``, ``pass``, ``note``, ``alert`` or ``fail``: the worst of its quantities."""
    reasons: tuple[str, ...]
    """What is beyond which limit, in words."""


@dataclass(frozen=True, eq=False)
class Trend:
    """What `carm_kin.trend` returns."""

    status: str
    """That of the latest result: ``pass``, ``note``, ``alert`` or ``fail``."""
    baseline: int
    """The first results, of which the reference is the mean."""
    tolerance_m: float | None
    tolerance_rad: float | None
    results: tuple[Judged, ...]
    """In the order of their dates."""
    charts: tuple[Chart, ...]
    passed_over: tuple[PassedOver, ...]
    warnings: tuple[Note, ...]
    provenance: Provenance

    @property
    def verdict(self) -> str:
        """The status in a sentence."""
        latest = self.results[-1]
        return f"{self.status}: {latest.label}: {'; '.join(latest.reasons) or 'agrees with the reference'}"

    def __str__(self) -> str:
        """What `carm-kin trend` prints."""
        return trend_view.text_of(self)

    def __repr__(self) -> str:
        """One line."""
        return f"Trend {self.status}: {len(self.results)} results, {len(self.passed_over)} passed over"

    def figure(self) -> "Figure":
        """The control charts. Raises MissingDependencyError without matplotlib."""
        from carm_kin.quality.trend_figure import trend_figure

        return trend_figure(self)

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file: mm and degrees, units in the names."""
        return object_of(SCHEMA, self) | {"charts": [chart.to_dict() for chart in self.charts]}

    def to_json(self, path: str | os.PathLike | None = None) -> str:
        """The JSON text; written to ``path``, whole or not at all, where one is given."""
        return json_text(self.to_dict(), path)


def trend(
    results: ResultsLike,
    *,
    baseline: int | None = None,
    tolerance_m: float | None = None,
    tolerance_rad: float | None = None,
    command: str | None = None,
) -> Trend:
    """Judge calibrations of one machine and sensor, in a list or by their labels, in the order of their dates.

    The reference is the mean of the first ``baseline`` ones, by default 5, or all but the last where these are fewer.
    A length farther from it than ``tolerance_m``, or an angle than ``tolerance_rad``, fails; where a tolerance is None,
    what is beyond the alert limit and 1 mm or 0.5 degrees.

    Raises InputError where fewer than two results count, where the baseline leaves none to judge, and for offsets more
    than 50 mm apart.
    """
    counted, passed = sorted_out(in_order(results))
    if len(counted) < 2:
        lost = "".join(f"; {one.label}: {one.reason}" for one in passed)
        raise InputError(f"a trend needs two results with an offset at least, not {len(counted)}{lost}")
    check_one_machine(counted)
    n = _baseline(baseline, len(counted))
    above_zero("tolerance_m", tolerance_m, 1.0)
    above_zero("tolerance_rad", tolerance_rad, 1.0)
    charts = _charts(counted, n, {"_m": tolerance_m, "_rad": tolerance_rad})
    each = tuple(_judged(one, k, charts) for k, one in enumerate(counted))
    warnings = _warnings(counted, n)
    made = provenance_of(None, command, None)
    return Trend(each[-1].status, n, tolerance_m, tolerance_rad, each, charts, passed, warnings, made)


def _baseline(given: int | None, count: int) -> int:
    if given is None:
        return min(USUAL_BASELINE, count - 1)
    if not 1 <= given < count:
        raise InputError(f"a baseline of {given} leaves none of {count} results to judge; it is 1 to {count - 1}")
    return given


def _charts(counted: Sequence[Dated], n: int, tolerances: dict[str, float | None]) -> tuple[Chart, ...]:
    results, tolerance = [one.result for one in counted], tolerances[LENGTH.suffix]
    offset = offsets(results, n)
    scatter = scatter_of(offset)
    limits = limits_of(offset, scatter, tolerance, LENGTH.least_fail)
    distance = np.linalg.norm(offset.values - offset.reference, axis=1)
    sigma = np.sqrt(np.trace(offset.covariances, axis1=1, axis2=2))
    beyond, statuses = float(np.sqrt(scatter.variances.sum())), judged(distance, limits, n)
    found = [Chart(OFFSET_CHANGE, LENGTH, distance, sigma, 0.0, beyond, limits, statuses)]
    for k, name in enumerate(OFFSET_COMPONENTS):
        found.append(_chart(name, LENGTH, offset.component(k), scatter.component(k), tolerance))
    for name, (kind, given) in scalars(results, n).items():
        alone = _chart(name, kind, given, scatter_of(given), tolerances[kind.suffix])
        found.append(replace(alone, statuses=judged(alone.change, alone.limits, n)))
    return tuple(found)


def _chart(name: str, kind: Kind, given: Values, scatter: Scatter, tolerance: float | None) -> Chart:
    """Of one number, not judged."""
    limits = limits_of(given, scatter, tolerance, kind.least_fail)
    sigma, beyond = np.sqrt(given.covariances[:, 0, 0]), float(np.sqrt(scatter.variances[0]))
    return Chart(name, kind, given.values[:, 0], sigma, float(given.reference[0]), beyond, limits, ())


def _judged(one: Dated, k: int, charts: Sequence[Chart]) -> Judged:
    status = worst([chart.statuses[k] for chart in charts if chart.statuses])
    reasons = tuple(_reason(chart, k) for chart in charts if chart.statuses and chart.statuses[k] not in FINE)
    result = one.result
    return Judged(one.label, result.provenance.date, result.solver, result.status, status, reasons)


def _reason(chart: Chart, k: int) -> str:
    status, limits, change = chart.statuses[k], chart.limits, abs(chart.change[k])
    limit = {NOTE: limits.note, ALERT: limits.alert, FAIL: limits.fail}[status][k]
    twice = status == ALERT and change <= limit
    limit = limits.note[k] if twice else limit
    scale, unit = chart.kind.scale, chart.kind.unit
    number = f"{chart.change[k] * scale:.3f}" if chart.quantity == OFFSET_CHANGE else f"{chart.change[k] * scale:+.3f}"
    again = ", for the second time in three results" if twice else ""
    return f"{chart.quantity} {number} {unit}, beyond {limit * scale:.3f}{again} ({status})"


def _warnings(counted: Sequence[Dated], n: int) -> tuple[Note, ...]:
    results, found = [one.result for one in counted], []
    if n < USUAL_BASELINE:
        many = f"{n} result" + "s" * (n > 1)
        words = f"a baseline of {many} tells little of how results scatter; the limits rest on their ±"
        found.append(Note("short_baseline", words))
    if len(names := sorted({result.solver for result in results})) > 1:
        words = f"results of several solvers ({', '.join(names)}): these differ by more than the noise"
        found.append(Note("several_solvers", words))
    if scattering := _scattering(results, n):
        words = f"the baseline scatters more than its ± explains, and the limits are as wide: {'; '.join(scattering)}"
        found.append(Note("baseline_scatters", words))
    return tuple(found)


def _scattering(results: Sequence[CalibrationResult], n: int) -> list[str]:
    """Quantities whose baseline differs by more than is stated, in words."""
    offset = offsets(results, n)
    every = {name: (LENGTH, offset.component(k)) for k, name in enumerate(OFFSET_COMPONENTS)} | scalars(results, n)
    return [
        f"{name} by {np.std(given.values[:n], ddof=1) * kind.scale:.3f} {kind.unit}, one sigma, where "
        f"{np.sqrt(given.covariances[:n].mean()) * kind.scale:.3f} {kind.unit} is stated"
        for name, (kind, given) in every.items()
        if scatters_more_than_stated(given)
    ]
