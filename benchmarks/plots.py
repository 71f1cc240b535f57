"""The pictures of RESULTS.md, drawn with matplotlib as SVG."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carm_kin.report.static import COLOURS, figure, save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HERE = Path(__file__).parent


def ratios(name: str, title: str, rows: Mapping[str, Mapping[str, float]], most: float = 2.5) -> str:
    """A dot for every condition (row) and solver; beyond ``most`` it is drawn at the edge. Returns the Markdown."""
    drawn = figure(8.5, 1.3 + 0.28 * len(rows))
    axes = drawn.subplots()
    solvers = list(next(iter(rows.values())))
    for k, (solver, colour) in enumerate(zip(solvers, COLOURS, strict=False)):
        x = [min(row[solver], most) for row in rows.values()]
        y = [-i + 0.12 * ((len(solvers) - 1) / 2 - k) for i in range(len(rows))]
        axes.plot(x, y, "o", color=colour, label=solver, markersize=5)
    axes.set_yticks([-i for i in range(len(rows))], list(rows))
    axes.set_xlim(0.8, most + 0.02)
    axes.set_xlabel("ratio to the bound")
    axes.grid(axis="x", color="#d0d7de")
    return _saved(drawn, axes, name, title)


def growth(name: str, title: str, unit: str, rows: Mapping[str, Sequence[tuple[int, float]]]) -> str:
    """A line over the number of poses for every contender, both axes logarithmic. Returns the Markdown."""
    drawn = figure(8.5, 4.8)
    axes = drawn.subplots()
    for k, (contender, points) in enumerate(rows.items()):
        style = ":" if contender.startswith("SciPy") else "-"
        axes.loglog(*zip(*points, strict=True), style, marker="o", markersize=4, color=COLOURS[k], label=contender)
    axes.set_xlabel("poses")
    axes.set_ylabel(unit)
    axes.grid(color="#d0d7de")
    return _saved(drawn, axes, name, title)


def _saved(drawn: "Figure", axes: Any, name: str, title: str) -> str:
    axes.set_title(title, loc="left", fontsize=10)
    drawn.legend(loc="outside right upper", fontsize=8, frameon=False)
    save(drawn, HERE / name)
    return f"![{title}]({name})"
