"""The reproduction page: what our solvers make of the paper's experiments, beside the published figures."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from carm_kin.study import published
from carm_kin.study.experiments import DEG, MM, SOLVERS, Outcome, Ransac

TITLES = {
    "noise_translation": ("position noise, mm", "Experiment 1: position noise"),
    "noise_rotation": ("orientation noise, deg", "Experiment 1: orientation noise"),
    "trajectories_orbital": ("orbital sweeps", "Experiment 2: number of orbital sweeps"),
    "trajectories_angular": ("angular sweeps", "Experiment 2: number of angular sweeps"),
    "density": ("poses", "Experiment 3: density of the poses"),
}
"""Experiment -> the name of its abscissa and of itself."""
TURNS = ("kinematic", "decomposed")
"""Solvers whose orientation error stands in the tables."""


@dataclass(frozen=True)
class Point:
    """All seeds of one condition."""

    value: float
    t_rms_m: dict[str, float]
    """Solver -> root mean square error of the offset."""
    t_half_width_m: dict[str, float]
    """Half-width of its 95% interval over the seeds."""
    turn_rms_rad: dict[str, float]
    bound_m: float
    time_s: dict[str, float]
    """Median."""


def points(found: Sequence[Outcome], experiment: str) -> list[Point]:
    """The conditions of an experiment in the order of its abscissa."""
    rows = [o for o in found if o.condition.experiment == experiment]
    return [_point([o for o in rows if o.condition.value == v], v) for v in sorted({o.condition.value for o in rows})]


def _point(rows: list[Outcome], value: float) -> Point:
    def by_solver(of) -> dict[str, float]:
        return {name: float(of([o for o in rows if o.solver == name])) for name in SOLVERS}

    return Point(
        value,
        by_solver(lambda own: _rms([o.t_error_m for o in own])),
        by_solver(lambda own: _half_width([o.t_error_m for o in own])),
        by_solver(lambda own: _rms([o.orientation_error_rad for o in own])),
        _rms([o.bound_m for o in rows]),
        by_solver(lambda own: np.median([o.time_s for o in own])),
    )


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _half_width(values: list[float]) -> float:
    """Of the 95% interval of the root mean square, by the spread of the squares."""
    squares = np.square(values)
    mean = squares.mean()
    if len(values) < 2 or mean == 0:
        return 0.0
    return float(1.96 * squares.std(ddof=1) / np.sqrt(len(values)) / (2 * np.sqrt(mean)))


def page(found: Sequence[Outcome], table1: Sequence[Ransac], pictures: dict[str, str], command: str, seeds: int) -> str:
    """The Markdown of the page; ``pictures`` are experiment -> file name."""
    parts = [_head(command, seeds)]
    for experiment, (_, title) in TITLES.items():
        rows = points(found, experiment)
        if rows:
            picture = f"![{title}]({pictures[experiment]})\n\n" if experiment in pictures else ""
            parts.append(f"## {title}\n\n{picture}{_verdict(experiment, rows)}\n\n{_table(experiment, rows)}")
    if table1:
        parts.append(_ransac_section(table1))
    return "\n\n".join(parts) + "\n"


def _head(command: str, seeds: int) -> str:
    return f"""# The paper's experiments, reproduced

Lee, Seibold et al., "Pivot calibration concept for sensor attached mobile C-arms", SPIE 2020, with the paper's own
sweeps and noise. Made by `{command}`, {date.today():%Y-%m-%d}.

The paper does not state its geometries; ours are random (R 50 to 200 mm, the sensor 600 to 800 mm from the pivot),
{seeds} for each condition, where the paper averages two. Errors are root mean squares over the seeds: of the length of
the offset's error, ± the half-width of its 95% interval, and of the rotation between the estimated and the true torus
frame. The bound is the Cramér-Rao bound of the offset, labels known. The published figures are read from the paper's
plots."""


def _number(value_m: float, half_width_m: float | None = None) -> str:
    text = f"{value_m / MM:.4f}" if value_m / MM >= 1e-5 else f"{value_m / MM:.0e}"
    return text if half_width_m is None or value_m / MM < 1e-5 else f"{text} ± {half_width_m / MM:.4f}"


def _table(experiment: str, rows: list[Point]) -> str:
    abscissa = TITLES[experiment][0]
    header = [abscissa, "paper mm", *(f"{name} mm" for name in SOLVERS), "bound mm"]
    header += ["paper deg", *(f"{name} deg" for name in TURNS)]
    lines = [
        [
            f"{row.value:g}",
            _published(experiment, "t_error_mm", row.value),
            *(_number(row.t_rms_m[name], row.t_half_width_m[name]) for name in SOLVERS),
            _number(row.bound_m),
            _published(experiment, "orientation_error_deg", row.value),
            *(f"{row.turn_rms_rad[name] / DEG:.5f}" for name in TURNS),
        ]
        for row in rows
    ]
    return _markdown(header, lines)


def _markdown(header: list[str], lines: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(line) + " |" for line in (header, ["---:"] * len(header), *lines))


def _published(experiment: str, quantity: str, value: float) -> str:
    """The published value; the mean of those within 2% of the abscissa, - where there is none."""
    curve = published.curve(experiment, quantity)
    near = [y for x, y in zip(curve.abscissa, curve.value, strict=True) if abs(x - value) <= 0.02 * abs(value) + 1e-9]
    return f"{np.mean(near):.3g}" if near else "-"


def _verdict(experiment: str, rows: list[Point]) -> str:
    """What agrees and what differs, in one paragraph."""
    ratios: dict[str, list[float]] = {name: [] for name in SOLVERS}
    for row in rows:
        text = _published(experiment, "t_error_mm", row.value)
        for name in SOLVERS:
            if text != "-" and row.t_rms_m[name] > 1e-8:
                ratios[name].append(float(text) * MM / row.t_rms_m[name])
    least = {name: min(row.t_rms_m[name] / row.bound_m for row in rows if row.bound_m > 1e-8) for name in SOLVERS}
    most = {name: max(row.t_rms_m[name] / row.bound_m for row in rows if row.bound_m > 1e-8) for name in SOLVERS}
    better = ", ".join(f"{np.median(ratios[name]):.0f} times {name}'s" for name in SOLVERS if ratios[name])
    bound = ", ".join(f"{name} {least[name]:.2f} to {most[name]:.2f}" for name in SOLVERS)
    return f"The published error of the offset is {better} (median over the abscissa). RMS over the bound: {bound}."


def _ransac_section(rows: Sequence[Ransac]) -> str:
    header = ["noise", "required", "ours", "detected", "ours", "mean of inliers mm", "ours", "mean of all mm", "ours"]
    lines = []
    for row in published.table1():
        moves = row.kind == "translation_mm"
        name, unit = ("table1_translation", "mm") if moves else ("table1_rotation", "deg")
        own = [o for o in rows if o.condition.experiment == name and np.isclose(o.condition.value, row.sigma)]
        if not own:
            continue
        inliers, every = (np.mean([getattr(o, key) for o in own]) / MM for key in ("mean_inliers_m", "mean_all_m"))
        counts = str(row.required), str(own[0].required) if moves else "-", str(row.detected)
        detected = f"{np.mean([o.detected for o in own]):.0f}"
        means = f"{row.mean_inliers_mm:.4f}", f"{inliers:.4f}", f"{row.mean_all_mm:.4f}", f"{every:.4f}"
        lines.append([f"{row.sigma:g} {unit}", *counts, detected, *means])
    return f"{_RANSAC}\n\n{_markdown(header, lines)}"


_RANSAC = """## Table 1: RANSAC

500 hypotheses about the decomposition; an inlier lies within 0.5 mm of the torus surface (the paper's threshold of
1 mm is the full width); required are 80% of the inliers that position noise leaves, erf(0.5 mm / (sigma sqrt 2)). With
position noise the numbers of required inliers agree to the pose, and the others follow: the mean distance of all poses
is 0.80 sigma, that of a normal distribution. With orientation noise they differ: ours turns the sensor about itself,
which leaves the positions on the torus. The paper's mean of 1.31 mm at 0.1 deg is 0.80 times 0.1 deg at a lever of
0.94 m, so its noise turns the poses about a distant point, such as the tracker's origin."""


def write_outcomes(found: Sequence[Outcome], path: Path) -> None:
    """All single results as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            ["experiment", "value", "seed", "solver", "t_error_mm", "R_error_mm", "orientation_error_deg", "bound_mm"]
        )
        for o in found:
            numbers = (o.t_error_m / MM, o.R_error_m / MM, o.orientation_error_rad / DEG, o.bound_m / MM)
            c = o.condition
            writer.writerow([c.experiment, f"{c.value:g}", o.seed, o.solver, *(f"{x:.9g}" for x in numbers)])
