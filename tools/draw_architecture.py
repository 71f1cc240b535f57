"""Draw the rooms of the code from its imports: python tools/draw_architecture.py docs/architecture.svg

Arrows run downwards. An arrow that follows from others (A -> B -> C makes A -> C superfluous) is left out.
"""

import ast
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path
from statistics import mean
from textwrap import wrap
from xml.sax.saxutils import escape

ROOT = Path(__file__).parents[1]
PACKAGES = "carm_kin", "solvers"
FACADE, GROUND, METHODS, IN_USE, BASE = "import carm_kin", "ground", "one file a solver", "in use", "base"
TOGETHER = {
    "carm_kin": FACADE,
    "carm_kin.__main__": "carm_kin.cli",
    **{f"carm_kin.{name}": GROUND for name in ("canvas", "errors", "files", "steps", "typed", "version")},
    "solvers": METHODS,
    **{f"solvers.{name}": METHODS for name in ("closed_form", "decomposed", "direct", "kinematic", "surface")},
    **{f"solvers.{name}": BASE for name in ("estimate", "plugins", "problem", "se3", "told", "torus")},
    **{f"solvers.{name}": IN_USE for name in ("nearest", "still_point")},
}
"""Modules in one box, which bears this name; any other root file has a box of its own, as every room has."""
HINTS = {FACADE: "the names for Python"}
"""What stands below a name, where it is neither the first words of the room nor the names of the files."""

BOX = 156, 66
GAP, FLOOR, GUTTER, MARGIN, TOP = 16, 100, 44, 26, 46
COLOURS = {"carm_kin": ("#eef4fc", "#ffffff", "#3b6ea8"), "solvers": ("#eff7f0", "#ffffff", "#3f8554")}
"""Of a package: its ground, its boxes, their frames and arrows."""
INK, FAINT = "#1d2126", "#5b6470"

Arrows = dict[str, set[str]]


def modules() -> dict[str, Path]:
    """Every module of the packages by its full name."""
    found = {}
    for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        found[name.removesuffix(".__init__")] = path
    return found


def imported(path: Path, known: dict[str, Path]) -> Iterator[str]:
    """The modules that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module in known:
            full = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in known else node.module for name in full)


def box_of(module: str) -> str:
    """The name of the box in which a module stands."""
    return TOGETHER.get(module) or ".".join(module.split(".")[:2])


def arrows_of(known: dict[str, Path]) -> Arrows:
    """Which boxes each box imports."""
    found: Arrows = {box_of(module): set() for module in known}
    for module, path in known.items():
        found[box_of(module)] |= {box_of(other) for other in imported(path, known)} - {box_of(module)}
    return found


def reduced(arrows: Arrows) -> Arrows:
    """Without the arrows that follow from others, the lowest boxes first. Raises CycleError where they run
    in a circle."""
    order = [*TopologicalSorter({box: sorted(arrows[box]) for box in sorted(arrows)}).static_order()]
    below: Arrows = {}
    for box in order:
        below[box] = arrows[box].union(*(below[other] for other in arrows[box]))
    return {
        box: {other for other in arrows[box] if not any(other in below[between] for between in arrows[box])}
        for box in order
    }


def floors_of(arrows: Arrows) -> dict[str, int]:
    """Of `reduced` arrows: as low as possible, or just below the boxes that import it where these are more than those
    that it imports."""
    floors: dict[str, int] = {}
    for box in arrows:
        floors[box] = max((floors[other] + 1 for other in arrows[box]), default=0)
    for box in reversed(arrows):
        above = [floors[other] for other in arrows if box in arrows[other]]
        if len(above) > len(arrows[box]) > 0:
            floors[box] = min(above) - 1
    return floors


def package_of(box: str, known: dict[str, Path]) -> str:
    return next(module for module in known if box_of(module) == box).split(".")[0]


def hint_of(box: str, known: dict[str, Path]) -> str:
    """What stands below the name: the first words of the docstring, or the files where a box has several."""
    if box in HINTS:
        return HINTS[box]
    if box in TOGETHER.values() and box not in known:
        return ", ".join(m.split(".")[-1] for m in sorted(known) if TOGETHER.get(m) == box and "." in m)
    words = ast.get_docstring(ast.parse(known[box].read_text(encoding="utf-8"))) or ""
    return words.split("\n")[0].split(":")[0].split(",")[0].rstrip(".").replace("`", "")


@dataclass(eq=False)
class Spot:
    """A box on its floor, or the place where an arrow passes between the boxes of a floor."""

    box: str | None
    floor: int
    package: str
    x: float = 0.0
    """Of the middle."""
    beside: list["Spot"] = field(default_factory=list)
    """The ends of its arrows."""

    @property
    def width(self) -> float:
        return GAP + (BOX[0] if self.box else 2)


def spots_of(arrows: Arrows, known: dict[str, Path]) -> tuple[dict[str, Spot], list[list[Spot]]]:
    """The boxes, and the ways of the arrows from spot to spot, floor by floor."""
    floors = floors_of(arrows)
    boxes = {box: Spot(box, floors[box], package_of(box, known)) for box in sorted(arrows)}
    occupied = {(spot.floor, spot.package) for spot in boxes.values()}
    ways = []
    for above, below in ((boxes[a], boxes[b]) for a in boxes for b in sorted(arrows[a])):
        between = range(above.floor - 1, below.floor, -1)
        passed = [Spot(None, floor, above.package) for floor in between if (floor, above.package) in occupied]
        ways.append([above, *passed, below])
        for one, next_one in pairwise(ways[-1]):
            one.beside.append(next_one)
            next_one.beside.append(one)
    return boxes, ways


def placed(boxes: dict[str, Spot], ways: list[list[Spot]]) -> float:
    """Give every spot its place, the first package left of the second; returns where the second begins."""
    every = [*boxes.values(), *(spot for way in ways for spot in way[1:-1])]
    rows = [
        [[s for s in every if s.floor == floor and s.package == package] for floor in range(max_floor(every) + 1)]
        for package in PACKAGES
    ]
    begins = left = MARGIN
    for of_package in rows:
        broadest = max(sum(spot.width for spot in row) for row in of_package)
        for row in of_package:
            _spread(row, left, left + broadest)
        for turn in range(60):
            for row in of_package if turn % 2 else of_package[::-1]:
                for spot in row:
                    spot.x = mean(other.x or spot.x for other in spot.beside) if spot.beside else spot.x
                row.sort(key=lambda spot: spot.x)
                _apart(row, left, left + broadest)
        begins, left = left, left + broadest + GUTTER
    return begins


def max_floor(spots: list[Spot]) -> int:
    return max(spot.floor for spot in spots)


def _spread(row: list[Spot], left: float, right: float) -> None:
    """One beside the other, in the middle."""
    at = (left + right - sum(spot.width for spot in row)) / 2
    for spot in row:
        spot.x, at = at + spot.width / 2, at + spot.width


def _apart(row: list[Spot], left: float, right: float) -> None:
    """Push spots that overlap apart, as little as possible, within the bounds."""
    for _ in range(20):
        for one, other in pairwise(row):
            overlap = (one.width + other.width) / 2 - (other.x - one.x)
            if overlap > 0:
                one.x, other.x = one.x - overlap / 2, other.x + overlap / 2
    at = left
    for spot in row:
        spot.x = max(spot.x, at + spot.width / 2)
        at = spot.x + spot.width / 2
    at = right
    for spot in reversed(row):
        spot.x = min(spot.x, at - spot.width / 2)
        at = spot.x - spot.width / 2


def drawing() -> str:
    """The SVG."""
    known = modules()
    arrows = reduced(arrows_of(known))
    boxes, ways = spots_of(arrows, known)
    begins = placed(boxes, ways)
    top = max_floor(list(boxes.values()))
    right = max(spot.x for spot in boxes.values()) + BOX[0] / 2 + GAP / 2
    width, height = right + MARGIN, TOP + top * FLOOR + BOX[1] + 2 * MARGIN

    def y(floor: int) -> float:
        return TOP + MARGIN + (top - floor) * FLOOR

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" '
        f'height="{height:.0f}" font-family="Helvetica, Arial, Liberation Sans, sans-serif" text-anchor="middle">',
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="#ffffff"/>',
        *_package("carm_kin", MARGIN - GAP / 2, begins - GUTTER + GAP / 2, height),
        *_package("solvers", begins - GAP / 2, right + GAP / 2, height),
    ]
    parts += [_arrow(way, y) for way in ways]
    parts += [_box(spot, y(spot.floor), hint_of(box, known)) for box, spot in boxes.items()]
    return "\n".join([*parts, "</svg>", ""])


def _package(name: str, start: float, end: float, height: float) -> list[str]:
    """The ground of a package, and the head of its arrows."""
    ground, _, colour = COLOURS[name]
    return [
        f'<marker id="{name}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0,0.8 L7.5,4 L0,7.2 z" fill="{colour}"/></marker>',
        f'<rect x="{start:.1f}" y="14" width="{end - start:.1f}" height="{height - 28:.1f}" rx="10" fill="{ground}"/>',
        _text((start + end) / 2, 42, f"{name}/", 19, f'font-weight="bold" fill="{colour}"'),
    ]


def _arrow(way: list[Spot], y: Callable[[int], float]) -> str:
    colour, marker = COLOURS[way[0].package][2], way[0].package
    points = [(way[0].x, y(way[0].floor) + BOX[1])]
    for spot in way[1:-1]:
        points += [(spot.x, y(spot.floor)), (spot.x, y(spot.floor) + BOX[1])]
    points.append((way[-1].x, y(way[-1].floor) - 1))
    path = f"M{points[0][0]:.1f},{points[0][1]:.1f}"
    for k, ((x0, y0), (x1, y1)) in enumerate(pairwise(points)):
        middle = (y0 + y1) / 2
        path += f" L{x1:.1f},{y1:.1f}" if k % 2 else f" C{x0:.1f},{middle:.1f} {x1:.1f},{middle:.1f} {x1:.1f},{y1:.1f}"
    stroke = f'stroke="{colour}" stroke-width="1.4" opacity="0.75" marker-end="url(#{marker})"'
    return f'<path d="{path}" fill="none" {stroke}/>'


def _box(spot: Spot, y: float, hint: str) -> str:
    _, fill, colour = COLOURS[spot.package]
    assert spot.box is not None
    name = spot.box if spot.box in TOGETHER.values() and spot.box.count(".") == 0 else spot.box.split(".")[-1] + "/"
    lines = wrap(hint, 23)[:3]
    first = y + BOX[1] / 2 + 4.5 - 6.8 * len(lines)
    rows = [_text(spot.x, first, name, 15, f'font-weight="bold" fill="{INK}"')]
    rows += [_text(spot.x, first + 2 + 13.5 * k, line, 11.5, f'fill="{FAINT}"') for k, line in enumerate(lines, 1)]
    frame = (
        f'<rect x="{spot.x - BOX[0] / 2:.1f}" y="{y:.1f}" width="{BOX[0]}" height="{BOX[1]}" rx="6" fill="{fill}" '
        f'stroke="{colour}" stroke-width="1.3"/>'
    )
    return "\n".join([frame, *rows])


def _text(x: float, y: float, words: str, size: float, style: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" {style}>{escape(words)}</text>'


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(drawing(), encoding="utf-8")
