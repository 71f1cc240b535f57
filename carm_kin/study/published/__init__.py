"""Values of the figures and of Table 1 of Lee, Seibold et al. (SPIE 2020), as data, to be drawn beside ours."""

import csv
from dataclasses import dataclass
from importlib.resources import files


@dataclass(frozen=True)
class Curve:
    """One published curve."""

    abscissa: tuple[float, ...]
    value: tuple[float, ...]


@dataclass(frozen=True)
class RansacRow:
    """A row of the paper's Table 1."""

    kind: str
    """``translation_mm`` or ``rotation_deg``."""
    sigma: float
    required: int
    detected: int
    mean_inliers_mm: float
    mean_all_mm: float


def curve(experiment: str, quantity: str) -> Curve:
    """The published curve, sorted by its abscissa; empty where the paper has none."""
    rows = [row for row in _rows("curves.csv") if (row["experiment"], row["quantity"]) == (experiment, quantity)]
    points = sorted((float(row["abscissa_value"]), float(row["value"])) for row in rows)
    return Curve(tuple(x for x, _ in points), tuple(y for _, y in points))


def table1() -> tuple[RansacRow, ...]:
    """The rows of Table 1."""
    return tuple(
        RansacRow(
            row["kind"],
            float(row["sigma"]),
            int(row["inliers_required"]),
            int(row["inliers_detected"]),
            float(row["mean_error_inliers_mm"]),
            float(row["mean_error_all_mm"]),
        )
        for row in _rows("table1.csv")
    )


def _rows(name: str) -> list[dict[str, str]]:
    text = files(__name__).joinpath(name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))
