"""Time, peak memory and growth of every solver, beside SciPy on the paper's energy and on the same likelihood.

    python -m benchmarks.speed [--largest 1000000]

Times are medians of warm runs in one process; peak memory is that of a fresh process that solves once,
less that of one that only makes the poses (Linux).
"""

import argparse
import multiprocessing
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import solvers
from benchmarks import peers, plots, scenes
from solvers.problem import Problem

PAPER, MILLION = 10_080, 1_000_000
SIZES = (1000, PAPER, 100_000, MILLION)
SIGMA_T, SIGMA_R = 1e-3, float(np.radians(0.1))
RUNS = {1000: 21, PAPER: 21, 100_000: 5, MILLION: 3}
SLOW = 5.0
"""A contender that takes longer than this, s, is measured once."""
SKIPPED = {("SciPy, Eq. 6", MILLION)}
"""What takes many minutes and tells nothing more."""


@dataclass(frozen=True)
class Row:
    """One contender at one size."""

    name: str
    poses: int
    time_ms: float
    memory_mb: float


def recording(poses: int) -> Problem:
    """The paper's protocol at another density: as many poses in the same sweeps; 1 mm and 0.1 deg noise."""
    rng = np.random.default_rng(0)
    torus = scenes.random_torus(rng)
    step = 360.0 * 28 / poses
    motion = scenes.sweeps_deg(range(-90, 91, 10), np.arange(0, 360, step), range(0, 161, 20), np.arange(0, 360, step))
    return scenes.observed(torus, motion, SIGMA_T, SIGMA_R, rng)[0]


def contenders() -> dict[str, Callable[[Problem], object]]:
    """Every solver by name with its defaults, the closed form without its search for outliers, and the peers."""
    found: dict[str, Callable[[Problem], object]] = {n: solvers.solver(n).solve for n in solvers.solver_names()}
    alone = solvers.solver("closed_form").Options(reject_outliers=False)
    found["closed_form, all poses"] = lambda problem: solvers.solver("closed_form").solve(problem, alone)
    found["SciPy, same likelihood, sparse"] = lambda problem: peers.sparse_likelihood(
        replace(problem, sigma_t=SIGMA_T, sigma_r=SIGMA_R)
    )
    found["SciPy, Eq. 6"] = peers.eq6
    return found


def measured(name: str, poses: int) -> Row:
    """Median time of warm runs and peak memory of a fresh process."""
    problem, solve = recording(poses), contenders()[name]
    times = [_seconds(solve, problem)]
    if times[0] < SLOW:
        times = [_seconds(solve, problem) for _ in range(RUNS[poses])]
    memory = _peak_mb(name, poses) - _peak_mb("", poses)
    return Row(name, poses, statistics.median(times) * 1e3, memory)


def _seconds(solve: Callable[[Problem], object], problem: Problem) -> float:
    start = time.perf_counter()
    solve(problem)
    return time.perf_counter() - start


def _peak_mb(name: str, poses: int) -> float:
    context = multiprocessing.get_context("spawn")
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=_solve_once, args=(name, poses, send))
    process.start()
    peak = receive.recv()
    process.join()
    return float(peak)


def _solve_once(name: str, poses: int, send) -> None:
    problem = recording(poses)
    if name:
        contenders()[name](problem)
    send.send(_high_water_mb())


def _high_water_mb() -> float:
    """Peak resident set of this process alone; `ru_maxrss` would be that of the parent if greater."""
    line = next(x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith("VmHWM:"))
    return int(line.split()[1]) / 1024


NOTES = """Medians of warm runs in one process, one thread; a contender that takes more than 5 s is run once. Memory is
the peak of a fresh process that solves once, less that of one that only makes the poses. `closed_form` first searches
for outliers; the row below is the closed form alone. SciPy's sparse peer minimises the likelihood of `kinematic` (every
angle an unknown, `trf` with `lsmr`) from the closed form, the noise being given; its lm on Eq. 6 starts at the centre
of the positions. Growth is time per pose at the most poses over that at 10,080: 1 is linear."""


def table(rows: list[Row], seconds: float, command: str) -> str:
    """The rows as a rich table on the terminal and as Markdown, sizes side by side."""
    sizes = sorted({row.poses for row in rows})
    header = ["solver", *(f"{n:,} poses: ms (MB)" for n in sizes), "growth"]
    names = list(dict.fromkeys(row.name for row in rows))
    found = {(row.name, row.poses): f"{row.time_ms:.1f} ({row.memory_mb:.0f})" for row in rows}
    lines = [[name, *(found.get((name, n), "-") for n in sizes), _growth(rows, name)] for name in names]
    text = scenes.show("Time (ms) and peak memory (MB)", header, lines)
    curves = {name: [(row.poses, row.time_ms) for row in rows if row.name == name] for name in names}
    chart = plots.growth("speed.svg", "Time of one calibration", "ms", curves)
    return f"## Speed and growth\n\n{scenes.provenance(command, seconds)}\n\n{NOTES}\n\n{text}\n\n{chart}"


def _growth(rows: list[Row], name: str) -> str:
    per_pose = {row.poses: row.time_ms / row.poses for row in rows if row.name == name}
    largest = max(per_pose)
    return f"{per_pose[largest] / per_pose[PAPER]:.2f}" if PAPER in per_pose and largest > PAPER else "-"


def main() -> None:
    """Measure, print, and write the section of RESULTS.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--largest", type=int, default=MILLION, help="most poses, up to 1,000,000")
    largest = parser.parse_args().largest
    start = time.perf_counter()
    sizes = [n for n in SIZES if n <= largest]
    rows = [measured(name, n) for n in sizes for name in contenders() if (name, n) not in SKIPPED]
    command = f"python -m benchmarks.speed --largest {largest}"
    scenes.write_section("speed", table(rows, time.perf_counter() - start, command))


if __name__ == "__main__":
    main()
