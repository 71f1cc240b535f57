"""How long a whole process takes: the help of the command, the import of the library, a plain calibration.

python -m benchmarks.startup [--runs 15]
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks import scenes
from carm_kin.cli.demo import MACHINE, SIGMA_R_RAD, SIGMA_T_M
from carm_kin.recording.formats import write_recording
from carm_kin.simulation.simulate import simulate

ROOT = Path(__file__).parents[1]
RUNS = 15

NOTES = """Medians of whole processes, from their start to their end, one after the other in turns, each of one thread,
with the compiled files of Python in place. The calibration is that of the demo's recording, its result written as JSON.
The last rows are what nothing of this project can lower: Python itself, NumPy, and a command of typer with nothing in
it, as its help and as a run. On a machine that does nothing else the time by the
clock is that of the processor."""

EMPTY = """import typer
app = typer.Typer(add_completion=False)
app.command()(lambda: None)
app.command("other")(lambda: None)
app()
"""

Process = tuple[str, list[str], float | None]
"""Its name, its arguments of Python, and the seconds to reach."""


def processes(folder: Path) -> list[Process]:
    """What is measured; the recording and the empty command are written into ``folder``."""
    recording, empty = folder / "recording.csv", folder / "empty.py"
    simulated, _ = simulate(MACHINE, "clinical", sigma_t_m=SIGMA_T_M, sigma_r_rad=SIGMA_R_RAD, seed=0)
    write_recording(simulated, recording)
    empty.write_text(EMPTY, encoding="utf-8")
    calibrate = ["-m", "carm_kin", "calibrate", str(recording), "--json", str(folder / "result.json")]
    return [
        ("carm-kin --help", ["-m", "carm_kin", "--help"], 0.25),
        ("import carm_kin", ["-c", "import carm_kin"], 0.25),
        (f"carm-kin calibrate, {len(simulated):,} poses", calibrate, 0.55),
        ("Python alone", ["-c", "pass"], None),
        ("import numpy", ["-c", "import numpy"], None),
        ("typer alone, its help", [str(empty), "--help"], None),
        ("typer alone, a run", [str(empty), "other"], None),
    ]


def measured(arguments: list[str]) -> tuple[float, float]:
    """Seconds by the clock and of the processor of one process. Raises CalledProcessError where it fails."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, *arguments], cwd=ROOT, env=environment, check=True, capture_output=True)
    seconds, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return seconds, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Measure, print, and write the section of RESULTS.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=RUNS)
    runs, start, load = parser.parse_args().runs, time.perf_counter(), os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        chosen = processes(Path(folder))
        for _, arguments, _ in chosen:
            measured(arguments)
        times = [[measured(arguments) for _, arguments, _ in chosen] for _ in range(runs)]
    rows = []
    for (name, _, reach), of_one in zip(chosen, zip(*times, strict=True), strict=True):
        wall, processor = (statistics.median(values) for values in zip(*of_one, strict=True))
        rows.append([name, f"{wall:.2f}", f"{processor:.2f}", "" if reach is None else f"{reach:.2f}"])
    header = ["process", "s by the clock", "s of the processor", "to reach"]
    text = scenes.show(f"Start-up, medians of {runs} runs", header, rows)
    told = scenes.provenance(f"python -m benchmarks.startup --runs {runs}", time.perf_counter() - start)
    told += f" The load average of the machine was {load:.1f} before."
    scenes.write_section("startup", f"## Start-up\n\n{told}\n\n{NOTES}\n\n{text}")


if __name__ == "__main__":
    main()
