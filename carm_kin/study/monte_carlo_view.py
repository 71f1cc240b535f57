"""A study of solvers as tables for the terminal and as rows of a CSV file."""

from collections.abc import Callable

import numpy as np
from rich.table import Table

from carm_kin.results.rows import Cell
from carm_kin.study.compare_view import NONE, empty_table
from carm_kin.study.intervals import Interval
from carm_kin.study.monte_carlo_result import PairStudy, SolverStudy, Study

Number = tuple[float | None, Interval | None]
DEG = float(np.degrees(1.0))


def scaled(value: float | None, interval: Interval | None, scale: float) -> Number:
    """A number and its interval in another unit."""
    return value and value * scale, interval and (interval[0] * scale, interval[1] * scale)


NUMBERS: dict[str, Callable[[SolverStudy], Number]] = {
    "offset RMS, mm": lambda s: scaled(s.offset_rms_m, s.offset_rms_95_m, 1e3),
    "R mean error, mm": lambda s: scaled(s.major_radius_bias_m, s.major_radius_bias_95_m, 1e3),
    "R RMS, mm": lambda s: scaled(s.major_radius_rms_m, s.major_radius_rms_95_m, 1e3),
    "orbital axis RMS, deg": lambda s: scaled(s.orbital_axis_rms_rad, s.orbital_axis_rms_95_rad, DEG),
    "angular axis RMS, deg": lambda s: scaled(s.angular_axis_rms_rad, s.angular_axis_rms_95_rad, DEG),
    "coverage of 95%": lambda s: (s.coverage, s.coverage_95),
    "median time, ms": lambda s: scaled(s.time_s, s.time_95_s, 1e3),
}
PAIR_NUMBERS: dict[str, Callable[[PairStudy], Number]] = {
    "RMS ratio of the offset": lambda p: (p.offset_ratio, p.offset_ratio_95),
    "share of runs in which the first is nearer": lambda p: (p.first_nearer, p.first_nearer_95),
}


def study_tables(study: Study) -> list[Table]:
    """Errors of the solvers, and of every two against each other; every number with its 95% interval."""
    title = f"Over {len(study.seeds)} simulated recordings, with 95% intervals"
    table = empty_table(title, "", *(one.solver for one in study.solvers))
    for name, of in NUMBERS.items():
        table.add_row(name, *(_shown(*of(one)) for one in study.solvers))
    table.add_row("runs without a result", *(str(one.refused) for one in study.solvers))
    pairs = empty_table("Two on the same recordings", "", *(f"{pair.first} / {pair.second}" for pair in study.pairs))
    for name, of_pair in PAIR_NUMBERS.items():
        pairs.add_row(name, *(_shown(*of_pair(pair)) for pair in study.pairs))
    return [table, pairs] if study.pairs else [table]


def study_rows(study: Study) -> list[dict[str, Cell]]:
    """A row for every solver, or two of them, and number."""
    found = [(one.solver, name, of(one)) for one in study.solvers for name, of in NUMBERS.items()]
    found += [(f"{p.first} / {p.second}", name, of(p)) for p in study.pairs for name, of in PAIR_NUMBERS.items()]
    return [
        {"solver": who, "number": name, "value": value, "low_95": low, "high_95": high}
        for who, name, (value, ends) in found
        for low, high in [ends or (None, None)]
    ]


def _shown(value: float | None, interval: Interval | None) -> str:
    if value is None:
        return NONE
    return f"{value:.3g}" + ("" if interval is None else f" [{interval[0]:.3g}, {interval[1]:.3g}]")
