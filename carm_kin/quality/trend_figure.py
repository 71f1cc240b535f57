"""The control charts of a trend as one figure."""

from typing import TYPE_CHECKING, Any

import numpy as np

from carm_kin.quality.control_chart import ALERT, BASELINE, FAIL, NOTE, PASS, WORSE
from carm_kin.quality.quantities import OFFSET_CHANGE
from carm_kin.report.static import figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from carm_kin.quality.trend import Chart, Trend

COLOURS = {BASELINE: "#6b7280", PASS: "#0b6e4f", NOTE: "#ca8a04", ALERT: "#c2410c", FAIL: "#9f1239"}
UNJUDGED = "#1f6feb"
MOST_DATES = 8
"""Below an axis."""


def trend_figure(trend: "Trend") -> "Figure":
    """A panel for each quantity: values with one standard deviation, the reference, its limits, statuses as colours."""
    rows = -(-len(trend.charts) // 2)
    drawn = figure(10, 2.2 * rows + 0.8)
    panels = [*drawn.subplots(rows, 2, squeeze=False).flat]
    dates = [one.date[:10] for one in trend.results]
    for k, chart in enumerate(trend.charts):
        _panel(panels[k], chart, trend.baseline)
        lowest = k + 2 >= len(trend.charts)
        _dates(panels[k], dates if lowest else [""] * len(dates))
    for panel in panels[len(trend.charts) :]:
        panel.axis("off")
    drawn.legend(handles=_key(), loc="outside lower center", ncols=9, fontsize=8, frameon=False)
    return drawn


def _panel(panel: Any, chart: "Chart", baseline: int) -> None:
    scale, order = chart.kind.scale, np.arange(len(chart.values))
    limits, centre = chart.limits, chart.reference * scale
    panel.axvspan(-0.5, baseline - 0.5, color="#eef2f6", zorder=0)
    panel.axhline(centre, color=COLOURS[PASS], linewidth=1)
    after = slice(baseline, None)
    signs = (1,) if chart.quantity == OFFSET_CHANGE else (1, -1)
    for limit, style, status in ((limits.note, ":", NOTE), (limits.alert, "--", ALERT), (limits.fail, "-", FAIL)):
        for sign in signs:
            at = centre + sign * limit[after] * scale
            ends = np.append(order[after] - 0.5, order[-1] + 0.5)
            panel.step(ends, np.append(at, at[-1]), style, where="post", color=COLOURS[status], linewidth=1)
    panel.errorbar(order, chart.values * scale, chart.sigma * scale, fmt="none", ecolor="#9aa4b2", elinewidth=1)
    panel.plot(order, chart.values * scale, "-", color="#9aa4b2", linewidth=0.8)
    statuses = chart.statuses or (None,) * len(order)
    colours = [UNJUDGED if status is None else COLOURS[status] for status in statuses]
    panel.scatter(order, chart.values * scale, c=colours, s=18, zorder=3)
    fail = f"fail beyond {limits.fail[-1] * scale:.3g}" if chart.statuses else "counts in the change of the offset"
    panel.set_title(f"{chart.quantity}, {chart.kind.unit} ({fail})", loc="left", fontsize=9)
    panel.set_ylim(*_reach(chart, baseline))
    panel.set_xlim(-0.5, len(order) - 0.5)
    panel.grid(axis="y", color="#d0d7de", linewidth=0.5)
    panel.ticklabel_format(axis="y", useOffset=False)


def _reach(chart: "Chart", baseline: int) -> tuple[float, float]:
    """Of the values and the alert limits; the fail limit may be far outside."""
    ends = (chart.values + chart.sigma, chart.values - chart.sigma)
    alert = chart.limits.alert[baseline:].max()
    low = 0.0 if chart.quantity == OFFSET_CHANGE else min(ends[1].min(), chart.reference - alert)
    high = max(ends[0].max(), chart.reference + alert)
    margin = 0.1 * (high - low)
    return (low - margin) * chart.kind.scale, (high + margin) * chart.kind.scale


def _dates(panel: Any, dates: list[str]) -> None:
    every = -(-len(dates) // MOST_DATES)
    shown = range(0, len(dates), every)
    panel.set_xticks([*shown], [dates[k] for k in shown], rotation=30, ha="right", fontsize=8)


def _key() -> list[Any]:
    from matplotlib.lines import Line2D

    dots = [Line2D([], [], color=COLOURS[s], marker="o", linestyle="", markersize=4, label=s) for s in WORSE]
    dots.append(Line2D([], [], color=UNJUDGED, marker="o", linestyle="", markersize=4, label="not judged"))
    styles: tuple[tuple[str, Any], ...] = ((NOTE, ":"), (ALERT, "--"), (FAIL, "-"))
    return dots + [Line2D([], [], color=COLOURS[s], linestyle=style, label=f"{s} beyond") for s, style in styles]
