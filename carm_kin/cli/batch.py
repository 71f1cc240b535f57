"""The command `carm-kin batch`."""

import logging
import os
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carm_kin.batches.journal import OK, Line
from carm_kin.batches.pool import Workers, WorkersLostError
from carm_kin.cli.arguments import writable
from carm_kin.cli.names import Naming
from carm_kin.cli.options import grouped
from carm_kin.cli.output import ended, results, written
from carm_kin.cli.settings import settings_options
from carm_kin.cli.terminal import Stderr
from carm_kin.errors import InputError

if TYPE_CHECKING:
    from carm_kin.batches.batch import Batch


def register(app: typer.Typer) -> None:
    """Add the command."""
    example = "Example: carm-kin batch recordings/ more/*.csv list.toml -o calibrated --jobs 4"
    app.command(cls=Naming, epilog=example)(batch)


@grouped("given", settings_options)
def batch(
    paths: Annotated[list[str], typer.Argument(help="Recordings, folders, patterns such as 'a/*.csv', TOML lists.")],
    given: dict[str, Any],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for results, summary and journal.")],
    jobs: Annotated[int | None, typer.Option(min=1, help="Worker processes; by default one for each core.")] = None,
    cluster: Annotated[str | None, typer.Option(help="Address of a Dask scheduler instead, tcp://HOST:PORT.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where an earlier batch in the folder ended.")] = False,
    report: Annotated[Path | None, typer.Option(help="Write a page of all results here, one HTML file.")] = None,
) -> None:
    """Calibrate many recordings: a result for each, a summary, and the reasons where there is none.

    Status 0: all have a result; 3: some have none.
    """
    from carm_kin.batches.batch import batch_of
    from carm_kin.cli.progress import progress

    if report:
        writable(report)
    console, whole = Stderr(), batch_of(paths, given, out)
    done, workers = whole.begun(resume, "--resume"), workers_of(jobs, cluster)
    if done:
        console.print(f"{len(done)} of {len(whole.entries)} recordings are done already")
    try:
        with progress(console, "calibrating", len(done), len(whole.entries)) as step:
            lines = whole.run(workers, done, lambda line: step(_words(line), line.status != OK))
    except (KeyboardInterrupt, WorkersLostError):
        console.print(f"what is done is kept in {out}; the same command with --resume goes on", soft_wrap=True)
        raise
    if report:
        _report(whole, lines, report)
    _conclude(whole, lines)


def _report(whole: "Batch", lines: list[Line], page: Path) -> None:
    """The page of all results and refusals."""
    from carm_kin.report import write_summary
    from carm_kin.results.result import CalibrationResult

    known = [line for line in lines if line.result_sha256 is not None]
    write_summary({line.label: CalibrationResult.from_json(whole.result_file(line)) for line in known}, page)
    written(page)


def workers_of(jobs: int | None, cluster: str | None) -> Workers:
    """Those of a cluster where one is named, else processes of this machine. Raises InputError for both."""
    if cluster is None:
        from carm_kin.batches.local_workers import LocalWorkers

        return LocalWorkers(jobs or _cores())
    if jobs is not None:
        raise InputError("--jobs and --cluster exclude each other: a cluster has its own workers")
    from carm_kin.batches.cluster import ClusterWorkers

    workers = ClusterWorkers(cluster)
    for name in ("distributed", "distributed.client", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    return workers


def _cores() -> int:
    """Those that this process may use, where the system tells."""
    with suppress(AttributeError):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _words(line: Line) -> str:
    code = f" ({line.code})" if line.code else ""
    reason = f": {line.reason}" if line.reason else ""
    return f"{line.label}: {line.status}{code}{reason}"


def _conclude(whole: "Batch", lines: list[Line]) -> None:
    """Say what came out. Raises typer.Exit with status 3 where not every recording has a result."""
    for file, what in whole.written(lines).items():
        written(file, what)
    console, count = results(whole.folder), Counter(line.status for line in lines)
    good = f"{count.pop(OK, 0)} of {len(lines)} recordings calibrated"
    if not count:
        console.print(good, style="bold green")
        return
    why = ", ".join(f"{number} {status}" for status, number in sorted(count.items()))
    console.print(f"{good}, {why}", style="bold red")
    raise typer.Exit(ended(3, "partial", f"{good}, {why}: the reasons are in {whole.summaries[0]}"))
