"""Time and peak memory of every solver, beside SciPy on the paper's energy, in one run.

    python -m benchmarks.speed [--largest 1000000]

Times are medians of warm runs in one process; peak memory is that of a fresh process that solves once,
less that of one that only makes the poses.
"""

import argparse
import multiprocessing
import resource
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import solvers
from benchmarks import scenes
from solvers.problem import Problem
from solvers.se3 import Array

SIZES = (1000, 10_080, 100_000, 1_000_000)
MILLION = 1_000_000
RUNS = {1000: 9, 10_080: 9, 100_000: 3, MILLION: 1}
SKIPPED = {(name, n) for name in ("surface", "scipy, Eq. 6") for n in (100_000, MILLION)}
"""What takes minutes and tells nothing more."""


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
    return scenes.observed(torus, motion, 1e-3, float(np.radians(0.1)), rng)[0]


def eq6_by_scipy(problem: Problem) -> Array:
    """The paper's Eq. 6 over c, n, R, t by `scipy.optimize.least_squares(method="lm")`, residuals vectorised."""
    from scipy.optimize import least_squares

    p, R = problem.p_world_sensor, problem.rotations

    def residuals(x: Array) -> Array:
        arm = R @ x[7:10] + p - x[:3]
        n = x[3:6] / np.linalg.norm(x[3:6])
        return np.concatenate([np.linalg.norm(arm, axis=1) - x[6], arm @ n])

    start = np.concatenate([p.mean(axis=0), [0.0, 0.0, 1.0], [0.1], np.zeros(3)])
    return least_squares(residuals, start, method="lm").x


def contenders() -> dict[str, Callable[[Problem], object]]:
    """Every solver by name with its defaults, then the peer."""
    found: dict[str, Callable[[Problem], object]] = {n: solvers.solver(n).solve for n in solvers.solver_names()}
    return {**found, "scipy, Eq. 6": eq6_by_scipy}


def measured(name: str, poses: int) -> Row:
    """Median time of warm runs and peak memory of a fresh process."""
    problem, solve = recording(poses), contenders()[name]
    if poses < MILLION:
        solve(problem)
    times = []
    for _ in range(RUNS[poses]):
        start = time.perf_counter()
        solve(problem)
        times.append(time.perf_counter() - start)
    memory = _peak_mb(name, poses) - _peak_mb("", poses)
    return Row(name, poses, statistics.median(times) * 1e3, memory)


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
    send.send(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def table(rows: list[Row], seconds: float, command: str) -> str:
    """The rows as a rich table on the terminal and as Markdown, sizes side by side."""
    sizes = sorted({row.poses for row in rows})
    header = ["solver", *(f"{n:,} poses: ms (MB)" for n in sizes)]
    names = list(dict.fromkeys(row.name for row in rows))
    found = {(row.name, row.poses): f"{row.time_ms:.1f} ({row.memory_mb:.0f})" for row in rows}
    lines = [[name, *(found.get((name, n), "-") for n in sizes)] for name in names]
    text = scenes.show("Time (ms) and peak memory (MB)", header, lines)
    return f"## Speed and growth\n\n{scenes.provenance(command, seconds)}\n\n{text}"


def main() -> None:
    """Measure, print, and write the section of RESULTS.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--largest", type=int, default=100_000, help="most poses, up to 1,000,000")
    largest = parser.parse_args().largest
    start = time.perf_counter()
    sizes = [n for n in SIZES if n <= largest]
    rows = [measured(name, n) for n in sizes for name in contenders() if (name, n) not in SKIPPED]
    command = f"python -m benchmarks.speed --largest {largest}"
    scenes.write_section("speed", table(rows, time.perf_counter() - start, command))


if __name__ == "__main__":
    main()
