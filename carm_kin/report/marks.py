"""A figure as data: what is drawn, before any library draws it. Lengths are mm, angles degrees."""

from dataclasses import dataclass

import numpy as np

from solvers.se3 import Array


@dataclass(frozen=True, eq=False)
class Points:
    """Single points."""

    name: str
    """In the key; "" stands for none."""
    at: Array
    """(N, 2) or (N, 3)."""
    colour: str | tuple[str, ...]
    """#rrggbb, one for all or one a point."""
    words: tuple[str, ...] = ()
    """What is said of each point under the pointer; plain text."""
    symbol: str = "circle"
    """``circle``, ``square``, ``diamond`` or ``cross``."""
    size: float = 4.0
    """Pixels."""
    sigma: Array | None = None
    """(N,) one standard deviation along y."""


@dataclass(frozen=True, eq=False)
class Line:
    """A line; a row of NaN lifts the pen."""

    name: str
    at: Array
    """(N, 2) or (N, 3)."""
    colour: str
    width: float = 2.0
    dashed: bool = False


@dataclass(frozen=True, eq=False)
class Bars:
    """A histogram."""

    name: str
    edges: Array
    """(K + 1,)."""
    heights: Array
    """(K,)."""
    colour: str


@dataclass(frozen=True, eq=False)
class Surface:
    """A translucent surface on a grid."""

    name: str
    at: Array
    """(M, N, 3)."""
    colour: str
    opacity: float


@dataclass(frozen=True, eq=False)
class Map:
    """Values over a grid as colours, with a bar that says which."""

    x: Array
    """(M,)."""
    y: Array
    """(N,)."""
    values: Array
    """(M, N)."""
    unit: str
    limits: tuple[float, float]
    """Values of the first and the last colour."""
    colours: tuple[str, ...]
    """#rrggbb, evenly spread."""


@dataclass(frozen=True, eq=False)
class Text:
    """A word in space."""

    at: Array
    """(3,)."""
    words: str


Mark = Points | Line | Bars | Surface | Map | Text


@dataclass(frozen=True, eq=False)
class Axis:
    """An axis of a panel."""

    title: str
    limits: tuple[float, float] | None = None
    """None: as the marks need it."""
    names: tuple[str, ...] = ()
    """What stands at 0, 1, 2 ... instead of numbers."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes."""

    x: Axis
    y: Axis
    marks: tuple[Mark, ...]


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels one below the other, with one x axis."""

    name: str
    """Of its file."""
    title: str
    caption: str
    panels: tuple[Panel, ...]

    @property
    def marks(self) -> tuple[Mark, ...]:
        """Those of all panels."""
        return tuple(mark for panel in self.panels for mark in panel.marks)


@dataclass(frozen=True, eq=False)
class Space:
    """A view of space with equal axes."""

    name: str
    title: str
    caption: str
    axes: tuple[str, str, str]
    """Titles."""
    limits: Array
    """(3, 2)."""
    eye: Array
    """(3,) the direction from which it is seen, z up."""
    marks: tuple[Mark, ...]


Figure = Chart | Space


@dataclass(frozen=True)
class Key:
    """A line of the legend."""

    name: str
    colour: str
    symbol: str
    """That of points, or ``line``, ``dashed``, ``area``."""
    members: tuple[int, ...]
    """Which of the figure's marks it stands for."""


def keys(figure: Figure) -> tuple[Key, ...]:
    """The legend, in the order in which the names come first."""
    found: dict[str, Key] = {}
    for number, mark in enumerate(figure.marks):
        if isinstance(mark, (Map, Text)) or not mark.name:
            continue
        colour = mark.colour if isinstance(mark.colour, str) else mark.colour[len(mark.colour) // 2]
        before = found[mark.name].members if mark.name in found else ()
        found[mark.name] = Key(mark.name, colour, _symbol(mark), (*before, number))
    return tuple(found.values())


def _symbol(mark: Points | Line | Bars | Surface) -> str:
    if isinstance(mark, Points):
        return mark.symbol
    if isinstance(mark, Line):
        return "dashed" if mark.dashed else "line"
    return "area"


def segments(*lines: Array) -> Array:
    """Several lines (N, D) as one, the pen lifted between them."""
    gap = np.full((1, lines[0].shape[1]), np.nan)
    return np.concatenate([part for line in lines for part in (line, gap)])
