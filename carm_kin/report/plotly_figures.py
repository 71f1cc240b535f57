"""Figures as plotly.js takes them: plain data, to be written as JSON. Plotly itself is not needed for that.

Every text is plain: what plotly.js would take for markup is escaped. Colours of letters and grids are the page's.
"""

from typing import Any

import numpy as np

from carm_kin.report.marks import Axis, Bars, Chart, Figure, Line, Map, Points, Space, Surface, Text
from solvers.se3 import Array

DIGITS = 5
"""Significant digits, of the extent of what is drawn."""
SYMBOLS_2D = {"circle": "circle", "square": "square", "diamond": "diamond", "cross": "cross-thin-open"}
SYMBOLS_3D = {"circle": "circle", "square": "square", "diamond": "diamond", "cross": "cross"}
MOST_LEVEL, SLANT_DEG = 40, -35
"""Letters beside an axis; the names slant where there are more."""
GAP = 0.06
"""Between panels, of the height."""


def plotly_figure(figure: Figure) -> dict[str, Any]:
    """``data`` and ``layout`` of a figure; one trace a mark, in the same order."""
    return _space(figure) if isinstance(figure, Space) else _chart(figure)


def with_words_once(content: dict[str, Any]) -> dict[str, Any]:
    """The same with the lists of words that several traces share in ``words``, and their number there in the traces."""
    words: dict[tuple[str, ...], int] = {}
    data = [
        trace | ({"text": words.setdefault(tuple(trace["text"]), len(words))} if "text" in trace else {})
        for trace in content["data"]
    ]
    return content | {"data": data, "words": [list(one) for one in words]}


def plain(text: str) -> str:
    """Text that plotly.js shows as it is."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _chart(chart: Chart) -> dict[str, Any]:
    count = len(chart.panels)
    height = (1 - GAP * (count - 1)) / count
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = _layout() | {"margin": {"l": 62, "r": 14, "t": 10, "b": 48}, "barmode": "overlay"}
    for k, panel in enumerate(chart.panels):
        number = "" if k == 0 else str(k + 1)
        top = 1 - k * (height + GAP)
        data += [_flat(mark) | {"xaxis": "x", "yaxis": f"y{number}"} for mark in panel.marks]
        layout[f"yaxis{number}"] = _axis(panel.y) | {"domain": [max(top - height, 0.0), top], "anchor": "x"}
    last = "" if count == 1 else str(count)
    layout["xaxis"] = _axis(chart.panels[0].x) | {"anchor": f"y{last}"}
    return {"data": data, "layout": layout}


def _layout() -> dict[str, Any]:
    return {
        "showlegend": False,
        "autosize": True,
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "hovermode": "closest",
        "dragmode": "zoom",
    }


def _axis(axis: Axis) -> dict[str, Any]:
    found: dict[str, Any] = {"title": {"text": plain(axis.title), "standoff": 8}, "automargin": True, "zeroline": False}
    found |= {"ticks": "outside", "ticklen": 5, "tickcolor": "rgba(0,0,0,0)"}
    if axis.limits:
        found["range"] = [float(limit) for limit in axis.limits]
    if axis.names:
        found |= {"tickvals": list(range(len(axis.names))), "ticktext": [plain(name) for name in axis.names]}
        if sum(map(len, axis.names)) > MOST_LEVEL:
            found["tickangle"] = SLANT_DEG
    return found


def _flat(mark: Any) -> dict[str, Any]:
    if isinstance(mark, Map):
        return _map(mark)
    if isinstance(mark, Bars):
        middle, width = (mark.edges[1:] + mark.edges[:-1]) / 2, np.diff(mark.edges)
        return {
            "type": "bar",
            "name": plain(mark.name),
            "x": _numbers(middle),
            "y": _numbers(mark.heights),
            "width": _numbers(width),
            "marker": {"color": mark.colour, "opacity": 0.75, "line": {"width": 0}},
            "hovertemplate": "%{x:.4g}: %{y:.4g}<extra></extra>",
        }
    trace = {"type": "scatter", "name": plain(mark.name), "x": _numbers(mark.at[:, 0]), "y": _numbers(mark.at[:, 1])}
    if isinstance(mark, Line):
        dash = "dash" if mark.dashed else "solid"
        return trace | {
            "mode": "lines",
            "line": {"color": mark.colour, "width": mark.width, "dash": dash},
            "hoverinfo": "skip",
        }
    trace |= {"mode": "markers", "marker": _marker(mark, SYMBOLS_2D)} | _words(mark, "x", "y")
    if mark.sigma is not None:
        trace["error_y"] = {"type": "data", "array": _numbers(mark.sigma), "thickness": 1.5, "width": 3}
    return trace


def _map(mark: Map) -> dict[str, Any]:
    steps = np.linspace(0, 1, len(mark.colours)).tolist()
    return {
        "type": "heatmap",
        "x": _numbers(mark.x),
        "y": _numbers(mark.y),
        "z": _numbers(mark.values.T),
        "zmin": float(mark.limits[0]),
        "zmax": float(mark.limits[1]),
        "zsmooth": "best",
        "colorscale": [list(step) for step in zip(steps, mark.colours, strict=True)],
        "colorbar": {"title": {"text": plain(mark.unit)}, "thickness": 12, "outlinewidth": 0},
        "hovertemplate": f"%{{x:.1f}}, %{{y:.1f}}: %{{z:.3f}} {plain(mark.unit)}<extra></extra>",
    }


def _marker(mark: Points, symbols: dict[str, str]) -> dict[str, Any]:
    colour = mark.colour if isinstance(mark.colour, str) else list(mark.colour)
    line = {"width": 2, "color": colour} if mark.symbol == "cross" else {"width": 0}
    return {"color": colour, "size": mark.size, "symbol": symbols[mark.symbol], "opacity": 0.9, "line": line}


def _words(mark: Points, *axes: str) -> dict[str, Any]:
    """What the pointer shows: the point's own words, then its numbers."""
    numbers = ", ".join(f"%{{{axis}:.4g}}" for axis in axes)
    if not mark.words:
        return {"hovertemplate": f"{numbers}<extra></extra>"}
    return {
        "text": [plain(word) for word in mark.words],
        "hovertemplate": f"%{{text}}<br>{numbers}<extra></extra>",
    }


def _space(space: Space) -> dict[str, Any]:
    resolution = float(np.ptp(space.limits, axis=1).max())
    scene: dict[str, Any] = {
        "aspectmode": "data",
        "camera": {
            "eye": dict(zip("xyz", (float(e) for e in space.eye), strict=True)),
            "center": {"x": 0, "y": 0, "z": -0.1},
            "up": {"x": 0, "y": 0, "z": 1},
        },
        "dragmode": "turntable",
    }
    for name, title, limits in zip("xyz", space.axes, space.limits, strict=True):
        scene[f"{name}axis"] = {
            "title": {"text": plain(title)},
            "range": [float(limit) for limit in limits],
            "showbackground": False,
            "showspikes": False,
            "nticks": 6,
        }
    layout = _layout() | {"scene": scene, "margin": {"l": 0, "r": 0, "t": 0, "b": 0}}
    return {"data": [_solid(mark, resolution) for mark in space.marks], "layout": layout}


def _solid(mark: Any, resolution: float) -> dict[str, Any]:
    if isinstance(mark, Text):
        at = {axis: [float(value)] for axis, value in zip("xyz", mark.at, strict=True)}
        return {"type": "scatter3d", "mode": "text", "text": [plain(mark.words)], "hoverinfo": "skip", **at}
    xyz = {axis: _numbers(mark.at[..., i], resolution) for i, axis in enumerate("xyz")}
    common = {"name": plain(mark.name), **xyz}
    if isinstance(mark, Surface):
        return common | {
            "type": "surface",
            "colorscale": [[0, mark.colour], [1, mark.colour]],
            "showscale": False,
            "opacity": mark.opacity,
            "hoverinfo": "skip",
            "contours": {axis: {"highlight": False} for axis in "xyz"},
            "lighting": {"ambient": 0.9, "diffuse": 0.2, "specular": 0.0},
        }
    common["type"] = "scatter3d"
    if isinstance(mark, Line):
        dash = "dash" if mark.dashed else "solid"
        line = {"color": mark.colour, "width": mark.width, "dash": dash}
        return common | {"mode": "lines", "line": line, "hoverinfo": "skip"}
    return common | {"mode": "markers", "marker": _marker(mark, SYMBOLS_3D)} | _words(mark, "x", "y", "z")


def _numbers(values: Array, resolution: float | None = None) -> list[Any]:
    """Nested lists, rounded; NaN, which JSON has not, is null."""
    size = resolution or float(np.nanmax(np.abs(values), initial=0.0))
    digits = DIGITS - int(np.floor(np.log10(size))) if size > 0 else 0
    rounded = np.round(values, digits).astype(object)
    rounded[~np.isfinite(values)] = None
    return rounded.tolist()
