"""Many recordings to calibrate in a batch, some of which are broken, refused, or kill their worker."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import carm_kin
from carm_kin.recording.recording import Recording
from helpers.places import TESTS, pythonpath

ENVIRONMENT = os.environ | {"PYTHONPATH": pythonpath(TESTS / "helpers" / "killer")}
"""With it a worker that opens ``kills.csv`` dies."""


@dataclass(frozen=True)
class Many:
    """What is in a folder, by label."""

    folder: Path
    truth: dict[str, np.ndarray]
    """Label -> the true offset, m, of the recordings that can be calibrated."""
    corrupt: tuple[str, ...]
    refused: tuple[str, ...]
    kills: tuple[str, ...] = ("kills",)

    @property
    def labels(self) -> set[str]:
        return {*self.truth, *self.corrupt, *self.refused, *self.kills}


def simulated(seed: int, step: int) -> tuple[Recording, np.ndarray]:
    """Every ``step``-th pose of three orbital and one angular circles, and the true offset in m."""
    recording, truth = carm_kin.simulate("mobile_nonisocentric", "minimal", sigma_t_m=3e-4, sigma_r_rad=1e-3, seed=seed)
    assert truth.offset_sensor_pivot_m is not None
    return recording.select(slice(None, None, step)), truth.offset_sensor_pivot_m


def make(folder: Path, good: int, corrupt: int, refused: int, step: int = 6) -> Many:
    """``good`` recordings, ``corrupt`` and ``refused`` ones, and one whose worker is killed."""
    folder.mkdir()
    truth = {}
    for k in range(good):
        recording, truth[f"good{k:03}"] = simulated(k, step)
        carm_kin.write_recording(recording, folder / f"good{k:03}.csv")
    for k in range(refused):
        recording, _ = simulated(1000 + k, step)
        orbital = recording.select(recording.sweep == recording.sweeps[k].label)
        carm_kin.write_recording(orbital, folder / f"one-axis{k}.csv")
    text = (folder / "good000.csv").read_text()
    broken = [text[: len(text) // 2], "", text.replace("0.", "O.", 1), text.replace(",", "\0", 3)]
    for k in range(corrupt):
        (folder / f"broken{k}.csv").write_text(broken[k])
    (folder / "kills.csv").write_text(text)
    names = tuple(f"broken{k}" for k in range(corrupt)), tuple(f"one-axis{k}" for k in range(refused))
    return Many(folder, truth, *names)


def command(folder: Path, out: Path, *more: object) -> list[str]:
    return [sys.executable, "-m", "carm_kin", "batch", str(folder), "-o", str(out), *map(str, more)]


def batch(folder: Path, out: Path, *more: object) -> subprocess.CompletedProcess:
    """``carm-kin batch`` in a process of its own."""
    return subprocess.run(
        command(folder, out, *more), env=ENVIRONMENT, capture_output=True, text=True, timeout=600, check=False
    )


def interrupted(folder: Path, out: Path, after: int, by: signal.Signals, *more: object) -> tuple[int, str]:
    """The same, ended by a signal once its journal has ``after`` lines; its status and what it said."""
    process = subprocess.Popen(
        command(folder, out, *more), env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    journal, deadline = out / "state.jsonl", time.monotonic() + 120
    while process.poll() is None and time.monotonic() < deadline:
        if journal.exists() and journal.read_text().count("\n") >= after:
            process.send_signal(by)
            break
        time.sleep(0.005)
    _, err = process.communicate(timeout=60)
    return process.returncode, err


def content(out: Path) -> dict[str, object]:
    """Every file of a batch's folder, without what depends on the date."""
    found: dict[str, object] = {}
    for file in sorted(path for path in out.rglob("*") if path.is_file()):
        name = str(file.relative_to(out))
        if file.suffix == ".json":
            data = json.loads(file.read_text())
            assert data["provenance"].pop("date")
            found[name] = json.dumps(data)
        elif name == "state.jsonl":
            lines = [json.loads(line) for line in file.read_text().splitlines()]
            found[name] = [{k: v for k, v in line.items() if k != "result_sha256"} for line in lines]
        else:
            found[name] = file.read_bytes()
    return found
