"""What the studies share: workers, tables, RESULTS.md.

Random C-arms and recordings are those of `carm_kin.simulation.scenes`.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from carm_kin.simulation.scenes import Motion, joined, observed, paper, random_frame, random_torus, signs, sweeps_deg
from solvers.problem import Problem

__all__ = ["Motion", "joined", "observed", "paper", "random_frame", "random_torus", "signs", "sweeps_deg"]

RESULTS = Path(__file__).with_name("RESULTS.md")
NOISELESS = 1e-7
"""Stands for a noise of zero in the bound, m or rad."""


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
