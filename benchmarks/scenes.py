"""Random C-arms and recordings for the studies, and what the studies share: workers, tables, RESULTS.md.

Geometries are those of the design: the torus pose uniform, R in 50 to 200 mm, the sensor in the carm
frame within 300 mm across and 600 to 800 mm along z, its orientation uniform. Metres and radians.
"""

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from solvers.problem import Problem
from solvers.se3 import Array, exp_so3, inverse, rotation_from_quat_wxyz, transform
from solvers.torus import Torus

RESULTS = Path(__file__).with_name("RESULTS.md")
OUTLIER_M = (0.05, 0.5)
"""A gross outlier lies off by a distance between these and has a random orientation."""
NOISELESS = 1e-7
"""Stands for a noise of zero in the bound, m or rad."""


@dataclass(frozen=True, eq=False)
class Motion:
    """True angles of N poses and what the recording tells of them, as in `Problem`."""

    angles: Array
    held: np.ndarray
    label: Array
    placement: np.ndarray


def random_frame(rng: np.random.Generator, half_width_m: float = 1.0) -> Array:
    """(4, 4): a uniform rotation, a position in a cube."""
    return transform(rotation_from_quat_wxyz(rng.normal(size=4)), rng.uniform(-half_width_m, half_width_m, 3))


def random_torus(
    rng: np.random.Generator,
    major_radius: float | None = None,
    ring: bool = False,
    epsilon: float = 0.0,
    placements: int = 1,
) -> Torus:
    """A machine of the design's table; ``ring``: R is 1.1 to 1.5 times the minor radius."""
    T_world_torus = np.stack([random_frame(rng) for _ in range(placements)])
    T_carm_sensor = random_frame(rng, 0.0)
    T_carm_sensor[:3, 3] = [*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.6, 0.8)]
    R = rng.uniform(0.05, 0.2) if major_radius is None else major_radius
    if ring:
        R = rng.uniform(1.1, 1.5) * np.hypot(T_carm_sensor[0, 3], T_carm_sensor[2, 3])
    return Torus(T_world_torus, float(R), epsilon, inverse(T_carm_sensor), np.ones(placements, dtype=bool), True)


def sweeps_deg(
    alphas: Iterable[float],
    beta_path: Sequence[float] | Array,
    betas: Iterable[float],
    alpha_path: Sequence[float] | Array,
    placement: int = 0,
    first_sweep: int = 0,
) -> Motion:
    """An orbital sweep at each alpha, then an angular one at each beta, the held angle labelled; degrees."""
    angles, held, label = [], [], []
    for joint, values, path in ((0, alphas, beta_path), (1, betas, alpha_path)):
        for value in values:
            part = np.empty((len(path), 2))
            part[:, joint], part[:, 1 - joint] = np.radians(value), np.radians(path)
            number, known = np.full((len(path), 2), -1), np.full((len(path), 2), np.nan)
            number[:, joint], known[:, joint] = first_sweep + len(angles), np.radians(value)
            angles, held, label = [*angles, part], [*held, number], [*label, known]
    stacked = np.concatenate(angles)
    return Motion(stacked, np.concatenate(held), np.concatenate(label), np.full(len(stacked), placement))


def joined(first: Motion, second: Motion) -> Motion:
    """One motion after the other."""
    names = ("angles", "held", "label", "placement")
    return Motion(*(np.concatenate([getattr(first, name), getattr(second, name)]) for name in names))


def paper(alphas: Iterable[float] = range(-90, 91, 10), betas: Iterable[float] = range(0, 161, 20)) -> Motion:
    """The paper's protocol: full circles, a pose every degree; all sweeps are 10,080 poses."""
    return sweeps_deg(alphas, np.arange(360.0), betas, np.arange(360.0))


def observed(
    torus: Torus, motion: Motion, sigma_t: float, sigma_r: float, rng: np.random.Generator, outliers: float = 0.0
) -> tuple[Problem, np.ndarray]:
    """The recording with its noise, and the mask (N,) of the poses replaced by gross outliers."""
    T = torus.poses(motion.angles, motion.placement)
    n = len(T)
    p = T[:, :3, 3] + sigma_t * rng.normal(size=(n, 3))
    R = T[:, :3, :3] @ exp_so3(sigma_r * rng.normal(size=(n, 3)))
    gross = np.zeros(n, dtype=bool)
    gross[rng.permutation(n)[: round(outliers * n)]] = True
    k = int(gross.sum())
    direction = rng.normal(size=(k, 3))
    p[gross] += direction / np.linalg.norm(direction, axis=1, keepdims=True) * rng.uniform(*OUTLIER_M, (k, 1))
    R[gross] = rotation_from_quat_wxyz(rng.normal(size=(k, 4)))
    return Problem(p, R, motion.placement, motion.held, motion.label), gross


def signs(torus: Torus, truth: Torus) -> tuple[int, int]:
    """+1 or -1 for n and a: whether the estimate's axes point as the truth's; (n, a) and (-n, -a) are one machine."""
    n = np.sign(torus.angular_axis[0] @ truth.angular_axis[0])
    return int(n), int(np.sign(torus.orbital_axis @ truth.orbital_axis))


def noise_or_floor(sigma: float) -> float:
    """The noise for the bound, which needs one above zero."""
    return max(sigma, NOISELESS)


def run_all(job: Callable[[Any], Any], jobs: Sequence[Any], workers: int) -> list[Any]:
    """The results of ``job`` in order, from worker processes."""
    if workers <= 1:
        return [job(one) for one in jobs]
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(job, jobs, chunksize=4))


def without_held(problem: Problem) -> Problem:
    """The problem as `closed_form` and `direct` see it: no labels, no sweeps."""
    return replace(problem.without_labels(), placement=problem.placement)


def show(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Print a table; returns the same as Markdown."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title)
    for k, name in enumerate(header):
        table.add_column(name, justify="left" if k == 0 else "right")
    for row in rows:
        table.add_row(*row)
    Console(width=max(Console().width, 150)).print(table)
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" + " ---: |" * (len(header) - 1)]
    return "\n".join([f"**{title}**", "", *lines, *("| " + " | ".join(row) + " |" for row in rows)])


def provenance(command: str, seconds: float) -> str:
    """A sentence: the command, the date, the machine, the time it took."""
    import platform

    machine = f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}, Python {platform.python_version()}"
    return f"`{command}`, {date.today():%Y-%m-%d}, {machine}, NumPy {np.__version__}; took {seconds:.0f} s."


def write_section(name: str, text: str, path: Path = RESULTS) -> None:
    """Replace the text between the section's markers in RESULTS.md, or append the section."""
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    old = path.read_text(encoding="utf-8") if path.exists() else "# Results of the benchmarks\n"
    section = f"{begin}\n{text.strip()}\n{end}"
    if begin in old and end in old:
        new = old[: old.index(begin)] + section + old[old.index(end) + len(end) :]
    else:
        new = f"{old.rstrip()}\n\n{section}\n"
    path.write_text(new, encoding="utf-8")
