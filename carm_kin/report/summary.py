"""The page of many calibrations: a line a recording."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from urllib.parse import quote

import numpy as np

from carm_kin.report.colours import SERIES
from carm_kin.report.comparison import MOST_LETTERS, MOST_NAMES, offsets_chart
from carm_kin.report.marks import Axis, Chart, Panel, Points
from carm_kin.report.page import write_page
from carm_kin.report.poses import short
from carm_kin.report.words import number, with_sigma
from carm_kin.results.result import CalibrationResult, ResultLike, as_result
from carm_kin.results.shown import only_determined
from carm_kin.version import __version__

HEAD = (
    "recording",
    "status",
    "offset x, y, z, mm",
    "± mm",
    "major radius, mm",
    "residual, mm",
    "used poses",
    "warnings",
)
MOST_DRAWN = 500
"""Of more results the figures show an even choice; the table has all."""


@dataclass(frozen=True)
class _Line:
    name: str
    link: str
    status: str
    cells: tuple[str, ...]
    words: str
    """In place of the rest of the cells."""


def write_summary(
    results: Mapping[str, ResultLike],
    out: str | os.PathLike,
    *,
    title: str = "Calibrations",
    links: Mapping[str, str] | None = None,
) -> None:
    """Write the page of results, or of those in files, by the names of their recordings.

    ``links`` gives the names of files beside the page, such as the report of each recording. Raises InputError
    where the place cannot be written.
    """
    known = {name: only_determined(as_result(result)) for name, result in results.items()}
    drawn = dict(list(known.items())[:: max(1, -(-len(known) // MOST_DRAWN))])
    lines = [_line(name, result, (links or {}).get(name, "")) for name, result in known.items()]
    write_page(
        "summary.html",
        Path(out),
        title=title,
        version=__version__,
        count=len(known),
        refused=sum(result.refusal is not None for result in known.values()),
        partial=sum(result.status == "partial" for result in known.values()),
        charts=_charts(drawn),
        drawn=len(drawn),
        head=HEAD,
        lines=lines,
    )


def _line(name: str, result: CalibrationResult, link: str) -> _Line:
    target = quote(link)
    if result.refusal:
        return _Line(name, target, "refused", ("refused",), f"{result.refusal.code}: {result.refusal.message}")
    offset, sigma = result.offset_sensor_pivot_m, result.sigma.offset_sensor_pivot_m
    radius = "–"
    if result.major_radius_m is not None:
        deviation = result.sigma.major_radius_m
        radius = with_sigma(result.major_radius_m * 1e3, deviation and deviation * 1e3)[0]
    cells = (
        result.status,
        "–" if offset is None else ", ".join(f"{x * 1e3:.2f}" for x in offset),
        "–" if sigma is None or offset is None else number(float(np.linalg.norm(sigma)) * 1e3),
        radius,
        f"{result.residuals.translation_rms_m * 1e3:.3f}",
        f"{result.used} of {result.poses}",
        ", ".join(dict.fromkeys(note.code for note in result.warnings)) or "–",
    )
    return _Line(name, target, result.status, cells, "")


def _charts(results: Mapping[str, CalibrationResult]) -> tuple[Chart, ...]:
    offsets = [r.offset_sensor_pivot_m for r in results.values() if r.offset_sensor_pivot_m is not None]
    if len(offsets) < 2:
        return ()
    chart = offsets_chart(results, np.median(offsets, axis=0), "their median")
    return tuple(found for found in (chart, _residuals(results)) if found)


def _residuals(results: Mapping[str, CalibrationResult]) -> Chart:
    shown = {name: r for name, r in results.items() if r.refusal is None}
    at = np.array([[k, r.residuals.translation_rms_m * 1e3] for k, r in enumerate(shown.values())])
    turn = np.array([[k, degrees(r.residuals.rotation_rms_rad or np.nan)] for k, r in enumerate(shown.values())])
    names = tuple(short(name) for name in shown)
    ticks = tuple(short(name, MOST_LETTERS) for name in shown) if len(shown) <= MOST_NAMES else ()
    x = Axis("", (-0.6, len(shown) - 0.4), ticks)
    panels = (
        Panel(x, Axis("position, mm"), (Points("position residual, rms", at, SERIES[0], names, size=7),)),
        Panel(x, Axis("rotation, deg"), (Points("rotation residual, rms", turn, SERIES[1], names, size=7),)),
    )
    return Chart("summary_residuals", "Residuals side by side", "Of the used poses of each recording.", panels)
