"""Calibrations in the order of their dates: those that count, and those that are passed over, with the reason."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError, wrong_type
from carm_kin.results.result import CalibrationResult, ResultLike, as_result

ResultsLike = Mapping[str, ResultLike] | Sequence[ResultLike]
"""Calibrations by their labels, or in a sequence: those from files are labelled by the files' names."""

MOST_APART_M = 0.05
"""Offsets that are farther apart are of different machines or sensors."""
MOST_NAMED = 3
"""Results that a message names."""


@dataclass(frozen=True, eq=False)
class Dated:
    """A calibration with its label and date."""

    label: str
    date: datetime
    result: CalibrationResult


@dataclass(frozen=True)
class PassedOver:
    """A calibration that does not count."""

    label: str
    date: str
    reason: str


def in_order(results: ResultsLike) -> list[Dated]:
    """Sorted by date; of the same date as given.

    Raises InputError for what is no calibration, and for a date that is none.
    """
    labelled = _labelled(results)
    read = [(label, as_result(result)) for label, result in labelled]
    return sorted((Dated(label, _date(label, one), one) for label, one in read), key=lambda one: one.date)


def sorted_out(every: Sequence[Dated]) -> tuple[list[Dated], tuple[PassedOver, ...]]:
    """Those that count, and the others: without an offset and its deviation, or of a recording that counts already."""
    good: list[Dated] = []
    passed: list[PassedOver] = []
    seen: dict[str, str] = {}
    for one in every:
        digest = one.result.provenance.input_sha256
        if reason := _lacks(one.result) or (digest and digest in seen and f"the same recording as {seen[digest]}"):
            passed.append(PassedOver(one.label, one.result.provenance.date, reason))
            continue
        good.append(one)
        if digest:
            seen[digest] = one.label
    return good, tuple(passed)


def check_one_machine(results: Sequence[Dated]) -> None:
    """Raises InputError where offsets are so far apart that they are of several machines or sensors."""
    first = results[0]
    apart = [(one.label, _apart(one.result, first.result)) for one in results]
    far = [f"{label} ({metres * 1e3:.0f} mm)" for label, metres in apart if metres > MOST_APART_M]
    if far:
        named = ", ".join(far[:MOST_NAMED]) + (f" and {len(far) - MOST_NAMED} more" if len(far) > MOST_NAMED else "")
        raise InputError(
            f"the offsets of {named} are more than {MOST_APART_M * 1e3:.0f} mm from that of {first.label}: these are "
            "other machines or sensors, or a sensor mounted anew; give the results of one mount"
        )


def _apart(one: CalibrationResult, other: CalibrationResult) -> float:
    assert one.offset_sensor_pivot_m is not None
    assert other.offset_sensor_pivot_m is not None
    return float(np.linalg.norm(one.offset_sensor_pivot_m - other.offset_sensor_pivot_m))


def _lacks(result: CalibrationResult) -> str:
    """Why a result says nothing of a trend; "" where it does."""
    if result.refusal:
        return f"refused ({result.refusal.code})"
    if result.offset_sensor_pivot_m is None:
        return "a part of the offset is not told" if result.told else f"no offset by the solver {result.solver}"
    sigma = result.sigma.offset_sensor_pivot_m
    return "" if sigma is not None and (sigma > 0).all() else "the offset has no ±"


def _labelled(results: ResultsLike) -> list[tuple[str, ResultLike]]:
    """A file's label is its name, its whole path where another one has the same name."""
    if isinstance(results, Mapping):
        return [(str(label), result) for label, result in results.items()]
    if isinstance(results, (CalibrationResult, str, os.PathLike)) or not isinstance(results, Sequence):
        raise wrong_type(results, "several calibrations (a list of results or of their files)")
    paths = [None if isinstance(one, CalibrationResult) else one for one in results]
    names = Counter(Path(path).name for path in paths if isinstance(path, (str, os.PathLike)))
    labels = []
    for k, path in enumerate(paths):
        if not isinstance(path, (str, os.PathLike)):
            labels.append(f"result {k + 1}")
        else:
            labels.append(Path(path).name if names[Path(path).name] == 1 else str(path))
    return [*zip(labels, results, strict=True)]


def _date(label: str, result: CalibrationResult) -> datetime:
    """With a time zone: UTC where it has none."""
    text = result.provenance.date
    try:
        date = datetime.fromisoformat(text.replace("Z", "+00:00"))
    except ValueError:
        words = f"the date '{text}' of its provenance must be as in 2024-05-31T09:30:00+00:00"
        raise InputError(words, file=label) from None
    return date if date.tzinfo else date.replace(tzinfo=timezone.utc)
