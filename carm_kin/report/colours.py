"""Colours that can be read on white and on black; the poses by sweep or placement."""

import numpy as np

INK = "#6b7280"
"""Of what belongs to no data."""
RED, GREEN, BLUE = "#dc2626", "#16a34a", "#3b82f6"
TRIAD = RED, GREEN, BLUE
"""The x, y and z axis of a frame."""
REJECTED = "#e11d48"
PIVOT = "#db2777"
SURFACE = "#0d9488"
ELLIPSOID = "#a855f7"
EXPECTED = "#ea580c"
SERIES = ("#3b82f6", "#ea580c", "#16a34a", "#a855f7", "#db2777", "#0d9488", "#ca8a04", "#6b7280")
"""Of solvers, placements and other things without an order."""

AMOUNT = ("#1e3a8a", "#0d9488", "#facc15")
"""Of a value from 0 up, and"""
SIGNED = ("#1d4ed8", "#93c5fd", "#f3f4f6", "#fca5a5", "#b91c1c")
"""of one of either sign."""

RAMPS = {
    "angular": ("#f59e0b", "#dc2626"),
    "orbital": ("#1d6fd8", "#22b8cf"),
    "": ("#7c3aed", "#c084fc"),
}
"""Ends of the range of colours of the sweeps in which a joint moves."""


def ramp(ends: tuple[str, str], count: int) -> list[str]:
    """``count`` colours between two."""
    first, last = (np.array([int(end[i : i + 2], 16) for i in (1, 3, 5)]) for end in ends)
    return ["#" + "".join(f"{round(c):02x}" for c in first + (last - first) * s) for s in np.linspace(0, 1, count)]
