"""Many recordings calibrated: a result for each, a summary, and a journal by which an interrupted batch goes on."""

import contextlib
import json
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from carm_kin.batches.entries import Entry, entries
from carm_kin.batches.job import Report, calibrate_file, key_of, versions
from carm_kin.batches.journal import DOUBTFUL, FAILED, FINAL, KILLED, OK, PARTIAL, REFUSED, Journal, Line
from carm_kin.batches.pool import Job, Outcome, WorkerKilledError, Workers, run
from carm_kin.batches.summary import row_of, summary_files, write_summary
from carm_kin.errors import InputError
from carm_kin.files import write_atomically

JOURNAL, SUMMARY = "state.jsonl", "summary"
FOLDERS = {OK: "results", DOUBTFUL: "doubtful", PARTIAL: "partial", REFUSED: "refused"}
"""Where the result of each status goes, so that ``results`` has what can be used and nothing else."""


def batch(
    paths: str | os.PathLike | Sequence[str | os.PathLike],
    out: str | os.PathLike,
    *,
    jobs: int | Workers = 1,
    resume: bool = False,
    told: Callable[[Line], None] = lambda line: None,
    **settings: Any,
) -> list[Line]:
    """Calibrate many recordings into the folder ``out``, as docs/batch.md says; what became of each, sorted by label.

    ``paths`` are files, folders, patterns or TOML lists. ``settings`` are those of `carm_kin.Settings` by name, such
    as ``solver="direct"``. ``jobs`` is the number of worker processes, or the workers, such as
    `carm_kin.batches.cluster.ClusterWorkers`. With ``resume`` a batch in the folder goes on. ``told`` hears of each
    recording as it ends. The workers import the calling script: call this under ``if __name__ == "__main__":``.

    Raises InputError for paths without a recording, wrong settings, and a folder that holds a batch or cannot be
    written.
    """
    if isinstance(jobs, int):
        if jobs < 1:
            raise InputError(f"jobs must be at least 1, not {jobs}")
        from carm_kin.batches.local_workers import LocalWorkers

        jobs = LocalWorkers(jobs)
    whole = batch_of(paths, settings, Path(out))
    return whole.run(jobs, whole.begun(resume, "resume=True"), told)


def batch_of(paths: str | os.PathLike | Sequence[str | os.PathLike], given: Mapping[str, Any], folder: Path) -> "Batch":
    """The batch of these recordings, with the settings ``given`` by name. Raises InputError as `entries` does."""
    every = [paths] if isinstance(paths, (str, os.PathLike)) else list(paths)
    return Batch(tuple(entries([Path(path) for path in every], given, folder)), folder)


@dataclass(frozen=True)
class Batch:
    """A batch and its folder."""

    entries: tuple[Entry, ...]
    folder: Path

    @property
    def journal(self) -> Journal:
        """What is done."""
        return Journal(self.folder / JOURNAL)

    @property
    def summaries(self) -> tuple[Path, ...]:
        """The files of the summary, the CSV first."""
        return summary_files(self.folder / SUMMARY)

    def written(self, lines: Sequence[Line]) -> dict[Path, str]:
        """The folders and files that a batch which ended like this has written, and in words what they hold."""
        counts = Counter(FOLDERS[line.status] for line in lines if line.status in FOLDERS)
        found = {self.folder / name: f"results of {count} recordings" for name, count in counts.items()}
        return {**found, **dict.fromkeys(self.summaries, "the summary"), self.folder / JOURNAL: "the journal"}

    def started(self) -> bool:
        """Whether the folder holds what an earlier batch has done."""
        return bool(self.journal.read())

    def begun(self, resume: bool, how: str) -> dict[str, Line]:
        """What is done already. Raises InputError as `done` does, and where that is something although the batch is not
        to ``resume``; ``how`` says in what way it would be."""
        if self.started() and not resume:
            raise InputError(f"holds a batch; go on with it by {how}, or take another folder", file=self.folder)
        return self.done()

    def done(self) -> dict[str, Line]:
        """The recordings by label that need not be done again: same input, settings and versions, result in place.

        Raises InputError where the folder holds other recordings.
        """
        known, wanted, here = self.journal.read(), {entry.label for entry in self.entries}, versions()
        if others := sorted(known.keys() - wanted):
            listed = f"'{others[0]}'" + (f" and {len(others) - 1} more" if len(others) > 1 else "")
            problem = f"holds results of {listed}, not among the recordings given; add those, or take another folder"
            raise InputError(problem, file=self.folder)
        return {
            entry.label: known[entry.label]
            for entry in self.entries
            if entry.label in known and self._holds(known[entry.label], entry, here)
        }

    def run(
        self, workers: Workers, done: dict[str, Line], told: Callable[[Line], None] = lambda line: None
    ) -> list[Line]:
        """Do all recordings but those ``done``; ``told`` hears of each as it ends. The summary comes last.

        Whatever ends this early (KeyboardInterrupt, WorkersLostError, a kill), what is done stays in the journal.
        Raises InputError where the folder cannot be written.
        """
        self._prepare(done)
        rest = {entry.label: entry for entry in self.entries if entry.label not in done}
        here, lines = versions(), dict(done)
        jobs = [Job(label, calibrate_file, (entry.path, entry.settings, here)) for label, entry in rest.items()]
        with contextlib.closing(run(jobs, workers)) as outcomes:
            for outcome in outcomes:
                line = self._settle(rest[outcome.job.name], outcome)
                lines[line.label] = line
                told(line)
        return self._conclude([lines[entry.label] for entry in self.entries])

    def _holds(self, line: Line, entry: Entry, here: dict[str, str]) -> bool:
        has_result = line.result_sha256 is not None
        if line.status not in FINAL or line.input != entry.shown or has_result != (line.status in FOLDERS):
            return False
        with contextlib.suppress(InputError, OSError):
            if line.key == key_of(entry.path, entry.settings, here):
                return not has_result or _digest(self.result_file(line).read_bytes()) == line.result_sha256
        return False

    def _prepare(self, done: dict[str, Line]) -> None:
        """The folders, without the results of what is to be done again."""
        try:
            for status in (OK, REFUSED):
                (self.folder / FOLDERS[status]).mkdir(parents=True, exist_ok=True)
            for name in FOLDERS.values():
                for entry in self.entries:
                    line = done.get(entry.label)
                    if line is None or FOLDERS.get(line.status) != name:
                        (self.folder / name / f"{entry.label}.json").unlink(missing_ok=True)
        except OSError as error:
            raise InputError(f"the folder cannot be used: {error.strerror}", file=self.folder) from None
        self.journal.rewrite(done.values())

    def _settle(self, entry: Entry, outcome: Outcome) -> Line:
        """Write the result and then the line, so that the line says what is there."""
        report: Report = _failure(outcome.error) if outcome.error else outcome.value
        digest = None if report.text is None else _digest(report.text.encode())
        reason = report.reason.replace(str(entry.path), entry.shown)
        line = Line(entry.label, entry.shown, report.status, report.code, reason, report.key, digest)
        if report.text is not None:
            self.result_file(line).parent.mkdir(exist_ok=True)
            write_atomically(self.result_file(line), report.text)
        self.journal.append(line)
        return line

    def _conclude(self, lines: list[Line]) -> list[Line]:
        rows = [row_of(line, self._content(line)) for line in lines]
        write_summary(rows, self.folder / SUMMARY)
        self.journal.rewrite(lines)
        return lines

    def _content(self, line: Line) -> Any:
        return json.loads(self.result_file(line).read_bytes()) if line.result_sha256 else None

    def result_file(self, line: Line) -> Path:
        """Where the result of a recording is."""
        return self.folder / FOLDERS[line.status] / f"{line.label}.json"


def _failure(error: BaseException) -> Report:
    """The report of a job that could not make one; it is done again when the batch goes on."""
    status = KILLED if isinstance(error, WorkerKilledError) else FAILED
    words = str(error) or "no message"
    return Report(status, "" if status == KILLED else type(error).__name__, words, None, None)


def _digest(data: bytes) -> str:
    return sha256(data).hexdigest()
