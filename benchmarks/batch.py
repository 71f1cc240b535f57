"""Throughput of a batch by one and by two workers, and what a job costs beyond the calibration itself.

python -m benchmarks.batch [--recordings 200] [--repeats 3]
"""

import argparse
import statistics
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import carm_kin
from benchmarks import scenes
from carm_kin.batches.batch import Batch
from carm_kin.batches.entries import entries
from carm_kin.batches.local_workers import LocalWorkers

SIGMA_T_M, SIGMA_R_RAD = 1e-3, float(np.radians(0.1))
PROTOCOLS = ("clinical", "paper")
WORKERS = (1, 2)


@dataclass(frozen=True)
class Row:
    """One protocol: seconds of whole batches, and of the calibrations alone."""

    protocol: str
    poses: int
    recordings: int
    calibration_s: float
    """Mean of the calls of `calibrate` in one warm process on one thread."""
    batch_s: dict[int, float]
    """Workers -> median time of a whole batch, the start of its processes and its summary in it."""

    @property
    def speed_up(self) -> float:
        """Throughput of two workers over that of one."""
        return self.batch_s[1] / self.batch_s[2]

    @property
    def overhead_s(self) -> float:
        """What one worker needs for a job beyond the calibration."""
        return self.batch_s[1] / self.recordings - self.calibration_s


def measured(protocol: str, recordings: int, repeats: int, folder: Path) -> Row:
    """Batches by one worker and by two in turn, each ``repeats`` times; the calibrations alone likewise."""
    poses = 0
    for seed in range(recordings):
        recording, _ = carm_kin.simulate(
            "mobile_nonisocentric", protocol, sigma_t_m=SIGMA_T_M, sigma_r_rad=SIGMA_R_RAD, seed=seed
        )
        carm_kin.write_recording(recording, folder / f"{seed:04}.csv")
        poses = len(recording)
    alone: list[float] = []
    whole: dict[int, list[float]] = {workers: [] for workers in WORKERS}
    for repeat in range(repeats):
        alone.append(_calibrations(folder))
        for workers in WORKERS:
            whole[workers].append(_batch(folder, folder / f"out-{workers}-{repeat}", workers))
    medians = {workers: statistics.median(times) for workers, times in whole.items()}
    return Row(protocol, poses, recordings, statistics.median(alone) / recordings, medians)


def _calibrations(folder: Path) -> float:
    total = 0.0
    with threadpool_limits(1):
        for path in sorted(folder.glob("*.csv")):
            recording = carm_kin.read_recording(path)
            start = time.perf_counter()
            carm_kin.calibrate(recording)
            total += time.perf_counter() - start
    return total


def _batch(folder: Path, out: Path, workers: int) -> float:
    batch = Batch(tuple(entries([str(folder / "*.csv")], {}, out)), out)
    start = time.perf_counter()
    lines = batch.run(LocalWorkers(workers), {}, lambda line: None)
    assert {line.status for line in lines} == {"ok"}
    return time.perf_counter() - start


NOTES = """Medians of whole batches, the start of the worker processes, the files and the summary included. Overhead:
time of a job by one worker beyond `calibrate` itself in a warm process. Aimed at: two workers at least 1.7 times as
fast as one, and less than 50 ms beyond the calibration."""


def table(rows: list[Row], seconds: float, command: str) -> str:
    """The rows as a rich table on the terminal and as Markdown."""
    header = [
        "protocol",
        "poses",
        "recordings",
        "calibration ms",
        "1 worker /s",
        "2 workers /s",
        "ratio",
        "overhead ms",
    ]
    lines = [
        [
            row.protocol,
            f"{row.poses:,}",
            str(row.recordings),
            f"{row.calibration_s * 1e3:.1f}",
            *(f"{row.recordings / row.batch_s[workers]:.1f}" for workers in WORKERS),
            f"{row.speed_up:.2f}",
            f"{row.overhead_s * 1e3:.1f}",
        ]
        for row in rows
    ]
    text = scenes.show("Throughput of a batch", header, lines)
    return f"## Batch\n\n{scenes.provenance(command, seconds)}\n\n{NOTES}\n\n{text}"


def main() -> None:
    """Measure, print, and write the section of RESULTS.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    start, rows = time.perf_counter(), []
    for protocol in PROTOCOLS:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(measured(protocol, given.recordings, given.repeats, Path(folder)))
    command = f"python -m benchmarks.batch --recordings {given.recordings} --repeats {given.repeats}"
    scenes.write_section("batch", table(rows, time.perf_counter() - start, command))


if __name__ == "__main__":
    main()
