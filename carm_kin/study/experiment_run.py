"""The experiments on worker processes, and what is written of them."""

from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.progress import track

from carm_kin.batches.pool import Job, Workers
from carm_kin.batches.pool import run as run_jobs
from carm_kin.study import experiments
from carm_kin.study.experiment_figures import draw
from carm_kin.study.experiment_page import page, write_outcomes
from carm_kin.study.experiments import Outcome, Ransac

PAGE, NUMBERS = "reproduction.md", "outcomes.csv"


def run(
    names: Iterable[str], folder: Path, seeds: int, workers: Workers, command: str, console: Console
) -> tuple[Path, ...]:
    """Run the named experiments, write the page, its figures and all numbers into the folder; give back the files.

    Raises InputError for an unknown name, MissingDependencyError without matplotlib, and what a failed job raised.
    """
    work = experiments.work(names, seeds)
    jobs = [Job(f"{c.experiment} {c.value:g}, seed {seed}", experiments.run_one, (c, seed)) for c, seed in work]
    found: list[Outcome] = []
    table1: list[Ransac] = []
    for outcome in track(run_jobs(jobs, workers), "experiments", len(jobs), console=console, transient=True):
        if outcome.error is not None:
            raise outcome.error
        if isinstance(outcome.value, Ransac):
            table1.append(outcome.value)
        else:
            found += outcome.value
    found.sort(key=lambda o: (o.condition.experiment, o.condition.value, o.seed))
    write_outcomes(found, folder / NUMBERS)
    drawn = draw(found, folder)
    (folder / PAGE).write_text(page(found, table1, drawn, command, seeds), encoding="utf-8")
    return tuple(folder / name for name in (PAGE, NUMBERS, *drawn.values()))
