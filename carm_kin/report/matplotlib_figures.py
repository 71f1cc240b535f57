"""Figures drawn by matplotlib, on white, for print."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from carm_kin.report import static
from carm_kin.report.marks import Axis, Bars, Chart, Figure, Line, Map, Points, Space, Surface, Text, keys
from solvers.se3 import Array

ENDINGS = ".svg", ".png"
WIDTH_INCH = 6.5
PANEL_INCH = 2.4
SYMBOLS = {"circle": "o", "square": "s", "diamond": "D", "cross": "+"}
GRID = "#d0d7de"


def needs_matplotlib() -> None:
    """Raises MissingDependencyError where it is not installed."""
    static.figure(1, 1)


def draw(figure: Figure, files: Sequence[Path]) -> None:
    """Draw a figure into each of the files, by their endings; the same figure gives the same bytes."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    with matplotlib.rc_context({"svg.hashsalt": "carm-kin", "svg.fonttype": "path", "font.size": 9}):
        canvas = Canvas(figsize=_size(figure), layout="constrained")
        FigureCanvasAgg(canvas)
        if isinstance(figure, Space):
            _space(canvas, figure)
        else:
            _chart(canvas, figure)
        _legend(canvas, figure)
        for file in files:
            metadata = {"Date": None} if file.suffix == ".svg" else {"Software": None}
            canvas.savefig(file, dpi=300, metadata=metadata)


def _size(figure: Figure) -> tuple[float, float]:
    rows = -(-len(keys(figure)) // 3)
    height = 5.4 if isinstance(figure, Space) else 0.7 + PANEL_INCH * max(len(figure.panels), 1.25)
    return WIDTH_INCH, height + 0.2 * rows


def _chart(canvas: Any, chart: Chart) -> None:
    every = canvas.subplots(len(chart.panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(every, chart.panels, strict=True):
        for mark in panel.marks:
            _flat(axes, mark)
        axes.set_ylabel(panel.y.title)
        axes.grid(color=GRID, linewidth=0.5)
        axes.set_axisbelow(True)
        _limits(axes.set_ylim, panel.y)
    _limits(every[-1].set_xlim, chart.panels[0].x)
    every[-1].set_xlabel(chart.panels[0].x.title)
    if chart.panels[0].x.names:
        every[-1].set_xticks(range(len(chart.panels[0].x.names)), [_literal(n) for n in chart.panels[0].x.names])


def _limits(set_limits: Any, axis: Axis) -> None:
    if axis.limits:
        set_limits(*axis.limits)


def _flat(axes: Any, mark: Any) -> None:
    if isinstance(mark, Map):
        draw_map(axes, mark)
    elif isinstance(mark, Bars):
        axes.bar(mark.edges[:-1], mark.heights, np.diff(mark.edges), align="edge", color=mark.colour, alpha=0.75)
    elif isinstance(mark, Line):
        axes.plot(*mark.at.T, color=mark.colour, linewidth=0.6 * mark.width, linestyle=_dash(mark))
    else:
        if mark.sigma is not None:
            axes.errorbar(*mark.at.T, yerr=mark.sigma, fmt="none", ecolor=mark.colour, elinewidth=1, capsize=2)
        axes.scatter(*mark.at.T, **_dots(mark))


def draw_map(axes: Any, mark: Map) -> None:
    """Draw a map and its bar of colours."""
    from matplotlib.colors import LinearSegmentedColormap

    colours, (low, high) = LinearSegmentedColormap.from_list("map", mark.colours), mark.limits
    mesh = axes.pcolormesh(
        mark.x, mark.y, mark.values.T, shading="gouraud", rasterized=True, cmap=colours, vmin=low, vmax=high
    )
    axes.figure.colorbar(mesh, ax=axes, label=mark.unit)


def _dots(mark: Points) -> dict[str, Any]:
    colour = mark.colour if isinstance(mark.colour, str) else list(mark.colour)
    width = 1.2 if mark.symbol == "cross" else 0.0
    return {"c": colour, "s": (0.8 * mark.size) ** 2, "marker": SYMBOLS[mark.symbol], "linewidths": width, "alpha": 0.9}


def _dash(mark: Line) -> str:
    return "--" if mark.dashed else "-"


def _space(canvas: Any, space: Space) -> None:
    axes = canvas.add_subplot(projection="3d", computed_zorder=False)
    for mark in space.marks:
        if isinstance(mark, Surface):
            axes.plot_surface(*np.moveaxis(mark.at, -1, 0), color=mark.colour, alpha=mark.opacity, linewidth=0)
        elif isinstance(mark, Line):
            width = 0.35 * mark.width
            axes.plot(
                *mark.at.T, color=mark.colour, linewidth=width, linestyle=_dash(mark), alpha=min(1.0, 0.3 + width)
            )
        elif isinstance(mark, Points):
            axes.scatter(*mark.at.T, depthshade=False, **_dots(mark))
        elif isinstance(mark, Text):
            axes.text(*mark.at, _literal(mark.words), fontsize=8)
    for name, title, limits in zip("xyz", space.axes, space.limits, strict=True):
        getattr(axes, f"set_{name}lim")(*limits)
        getattr(axes, f"set_{name}label")(title)
    axes.set_box_aspect(np.ptp(space.limits, axis=1), zoom=0.87)
    axes.view_init(*_view(space.eye))


def _view(eye: Array) -> tuple[float, float]:
    """Elevation and azimuth, deg."""
    return tuple(np.degrees([np.arctan2(eye[2], np.hypot(eye[0], eye[1])), np.arctan2(eye[1], eye[0])]))


def _legend(canvas: Any, figure: Figure) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = []
    for key in keys(figure):
        label = _literal(key.name)
        if key.symbol == "area":
            handles.append(Patch(color=key.colour, alpha=0.5, label=label))
        elif key.symbol in ("line", "dashed"):
            handles.append(
                Line2D([], [], color=key.colour, linestyle="-" if key.symbol == "line" else "--", label=label)
            )
        else:
            marker = SYMBOLS[key.symbol]
            handles.append(Line2D([], [], color=key.colour, marker=marker, linestyle="", markersize=4, label=label))
    if handles:
        canvas.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=7.5, frameon=False)


def _literal(text: str) -> str:
    """Text that matplotlib shows as it is, without mathematics."""
    return text.replace("$", r"\$")
