"""The command `carm-kin experiment`: the paper's experiments, their figures and the page that compares them."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from carm_kin.cli.batch import workers_of
from carm_kin.cli.output import written
from carm_kin.cli.terminal import Stderr
from carm_kin.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command(epilog="Example: carm-kin experiment noise -o reproduction --seeds 20")(experiment)


def experiment(
    names: Annotated[list[str], typer.Argument(help="noise, trajectories, density, table1, or all.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the page, the figures and the numbers.")],
    seeds: Annotated[int, typer.Option(min=1, max=10_000, help="Random machines for each condition.")] = 20,
    jobs: Annotated[int | None, typer.Option(min=1, max=1024, help="Worker processes; default: all cores.")] = None,
    cluster: Annotated[str | None, typer.Option(help="Address of a running Dask scheduler, tcp://HOST:PORT.")] = None,
) -> None:
    """Run the experiments of Lee et al. (SPIE 2020) with every solver, beside the published figures."""
    from carm_kin.results.provenance import command_line
    from carm_kin.study.experiment_run import run

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"the folder cannot be made: {error.strerror}", file=out) from None
    for file in run(names, out, seeds, workers_of(jobs, cluster), command_line(sys.argv[1:]), Stderr()):
        written(file)
