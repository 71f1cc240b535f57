"""A trend as lines for the terminal, as text, and as rows of a CSV file."""

from typing import TYPE_CHECKING

from carm_kin.quality.control_chart import PASS
from carm_kin.results.rows import Cell
from carm_kin.results.summary import Line, Row
from carm_kin.results.summary import text_of as joined

if TYPE_CHECKING:
    from carm_kin.quality.dated import PassedOver
    from carm_kin.quality.trend import Chart, Judged, Trend

LONGEST_LABEL = 40


def lines_of(trend: "Trend") -> list[Line]:
    """The latest result by quantity, every result with its status, and what was passed over; not the verdict."""
    latest = trend.results[-1]
    every = len(trend.results)
    lines = [
        Line(f"{every} results, {_day(trend.results[0].date)} to {_day(latest.date)}; {_reference(trend)}"),
        Line(f"latest: {latest.label}"),
        *(Line(f"  {_of_latest(chart).text}") for chart in trend.charts),
        Line("change of the offset from the reference"),
    ]
    width = min(max(len(one.label) for one in (*trend.results, *trend.passed_over)), LONGEST_LABEL)
    lines += [Line(f"  {_history(trend, k, width)}") for k in range(every)]
    return lines + [Line(f"  {_passed(one, width)}") for one in trend.passed_over]


def text_of(trend: "Trend") -> str:
    """All that `carm-kin trend` prints."""
    return joined([*lines_of(trend), Line(trend.verdict)], trend.warnings)


def rows_of(trend: "Trend") -> list[dict[str, Cell]]:
    """A row for every result and quantity, in mm or deg, and one for every result that was passed over."""
    rows = [_cells(one, chart, k) for k, one in enumerate(trend.results) for chart in trend.charts]
    empty = dict.fromkeys(rows[0])
    rows += [
        empty | {"date": one.date, "label": one.label, "status": "passed over", "reasons": one.reason}
        for one in trend.passed_over
    ]
    return rows


def _cells(one: "Judged", chart: "Chart", k: int) -> dict[str, Cell]:
    scale = chart.kind.scale
    numbers = {
        "value": chart.values[k],
        "sigma": chart.sigma[k],
        "reference": chart.reference,
        "change": chart.change[k],
        "note_beyond": chart.limits.note[k],
        "alert_beyond": chart.limits.alert[k],
        "fail_beyond": chart.limits.fail[k],
    }
    return {
        "date": one.date,
        "label": one.label,
        "calibration": one.calibration,
        "solver": one.solver,
        "status": one.status,
        "reasons": "; ".join(one.reasons),
        "quantity": chart.quantity,
        "unit": chart.kind.unit,
        **{name: float(value) * scale for name, value in numbers.items()},
        "quantity_status": chart.statuses[k] if chart.statuses else None,
    }


def _reference(trend: "Trend") -> str:
    return "reference: " + (f"the mean of the first {trend.baseline}" if trend.baseline > 1 else "the first")


def _of_latest(chart: "Chart") -> Row:
    scale, limits = chart.kind.scale, chart.limits
    change = "" if not chart.reference else f", change {chart.change[-1] * scale:+.3f}"
    beyond = [f"{n} beyond {x[-1] * scale:.3f}" for n, x in (("note", limits.note), ("alert", limits.alert))]
    beyond.append(f"fail beyond {limits.fail[-1] * scale:.3f}")
    flagged = chart.statuses and chart.statuses[-1] != PASS
    more = f"  {chart.statuses[-1].upper()}" if flagged else ""
    unit = f"{chart.kind.unit}{change}" + (f"; {', '.join(beyond)}{more}" if chart.statuses else "")
    return Row(chart.quantity, f"{chart.values[-1] * scale:>10.3f}", f"{chart.sigma[-1] * scale:.3f}", unit)


def _history(trend: "Trend", k: int, width: int) -> str:
    one, chart = trend.results[k], trend.charts[0]
    remark = "" if one.calibration == "ok" else f" (calibration {one.calibration})"
    distance = f"{chart.values[k] * chart.kind.scale:9.3f} {chart.kind.unit}"
    return f"{_day(one.date)}  {one.label:<{width}}{distance}  {one.status}{remark}"


def _passed(one: "PassedOver", width: int) -> str:
    return f"{_day(one.date)}  {one.label:<{width}}{'-':>9}     passed over: {one.reason}"


def _day(date: str) -> str:
    return date[:10]
