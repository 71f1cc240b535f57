"""Live capture over loopback: losses, delay and CPU share, from pyigtl's server and from our own replay.

    python -m benchmarks.live [--messages 10000] [--rate-hz 240]

The command `carm-kin capture` runs in a process of its own with its view on a pseudo-terminal (POSIX, Linux for the
CPU share); another process sends. pyigtl's server is stopped and started again half way.
"""

import argparse
import os
import pty
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import carm_kin
from benchmarks import scenes
from benchmarks.igtl_peer import TOOL
from carm_kin.recording.recording import Recording
from solvers.se3 import Array, transform

SIGMA_T_M, SIGMA_R_RAD = 0.3e-3, float(np.radians(0.05))
MARGIN_S = 60.0
"""What a run may take beyond the time of its messages."""
WATCH_S = 0.001
"""How often the file is looked at."""
ROOT = Path(__file__).parents[1]


@dataclass(frozen=True, eq=False)
class Run:
    """One capture."""

    name: str
    sent: int
    received: int
    equal: bool
    """Whether all poses are there once, in order, as they were sent."""
    arrived_s: Array
    """From the server's stamp to the arrival, every message."""
    written_s: Array
    """From the server's stamp until another process sees the line in the file."""
    cpu_share: float
    """Of one core, from the first pose to the last."""


class Watcher(threading.Thread):
    """Notes when each line of a growing file is first seen, and the CPU time that a process had then."""

    def __init__(self, path: Path, process: int, lines: int) -> None:
        super().__init__(daemon=True)
        self.seen_s: list[float] = []
        self.cpu_s: list[float] = []
        self._path, self._process, self._lines = path, process, lines

    def run(self) -> None:
        while not self._path.exists():
            time.sleep(WATCH_S)
        with self._path.open("rb") as file:
            while len(self.seen_s) <= self._lines:
                ends = file.read().count(b"\n")
                self.seen_s += [time.time()] * ends
                self.cpu_s += [cpu_s(self._process)] * bool(ends)
                time.sleep(WATCH_S)


def cpu_s(process: int) -> float:
    """CPU time of a process so far; NaN once it is gone."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return float("nan")
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def recording(messages: int) -> Recording:
    """Poses of the paper's protocol, repeated as often as needed."""
    made, _ = carm_kin.simulate(
        "mobile_nonisocentric", "paper", sigma_t_m=SIGMA_T_M, sigma_r_rad=SIGMA_R_RAD, labels=False, seed=0
    )
    return made.select(np.arange(messages) % len(made))


def measured(name: str, sender: Sequence[str], port: int, tool: str, poses: Array, rate_hz: float, path: Path) -> Run:
    """Run the sender, capture from it, compare with the ``poses`` (N, 4, 4), mm."""
    server = subprocess.Popen(
        [sys.executable, "-m", *sender], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=ROOT
    )
    assert server.stdout is not None
    server.stdout.readline()
    terminal, end = pty.openpty()
    command = [sys.executable, "-m", "carm_kin", "capture", f"127.0.0.1:{port}", "-o", str(path), "--tool", tool]
    begin = time.monotonic()
    capture = subprocess.Popen([*command, "--max-poses", str(len(poses))], stdin=end, stdout=end, stderr=end, cwd=ROOT)
    os.close(end)
    threading.Thread(target=_drain, args=(terminal,), daemon=True).start()
    watcher = Watcher(path, capture.pid, len(poses))
    watcher.start()
    try:
        capture.wait(len(poses) / rate_hz + MARGIN_S)
        watcher.join(1.0)
    finally:
        capture.kill()
        server.kill()
    print(f"{name}: {time.monotonic() - begin:.0f} s")
    return _compared(name, poses, path, watcher)


def _drain(terminal: int) -> None:
    """Read what the view draws, as a terminal does."""
    try:
        while os.read(terminal, 1 << 16):
            pass
    except OSError:
        os.close(terminal)


def _compared(name: str, poses: Array, path: Path, watcher: Watcher) -> Run:
    found = carm_kin.read_recording(path)
    received_s = found.metadata["received_s"].astype(float)
    assert found.time_s is not None
    sent = poses[:, :3, 3].astype(np.float32)
    equal = len(found) == len(sent) and bool(np.abs(found.p_world_sensor * 1e3 - sent).max() < 1e-6)
    seen = np.array(watcher.seen_s[1 : len(found) + 1])
    cpu, span = np.array(watcher.cpu_s), seen[-1] - seen[0]
    share = (np.nanmax(cpu) - cpu[0]) / span
    written = seen - found.time_s[: len(seen)]
    return Run(name, len(poses), len(found), equal, received_s - found.time_s, written, float(share))


def free_port() -> int:
    """A TCP port that nothing listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


NOTES = """Poses of the paper's protocol with 0.3 mm and 0.05 deg of noise, sent as TRANSFORM over loopback. Delays run
from the sender's stamp: until the command has the message, and until another process sees its line in the file, which
the command then still forces to the disk before the view and the calibration get the pose. pyigtl looks at its queue
every 10 ms or so, which is in its delays. The CPU share, of one core, includes the view and the calibration. Where
other processes keep the cores or the disk busy, poses come later."""


def table(runs: list[Run], rate_hz: float, seconds: float, load_before: float, command: str) -> str:
    """The runs as a table on the terminal and as Markdown."""
    header = ["server", "sent", "stored", "equal, in order", "arrived, ms: median", "99%", "most"]
    header += ["in the file, ms: median", "99%", "CPU share"]
    rows = []
    for run in runs:
        delays = [f"{np.quantile(run.arrived_s, q) * 1e3:.1f}" for q in (0.5, 0.99, 1.0)]
        delays += [f"{np.quantile(run.written_s, q) * 1e3:.1f}" for q in (0.5, 0.99)]
        equal = "yes" if run.equal else "NO"
        rows.append([run.name, f"{run.sent:,}", f"{run.received:,}", equal, *delays, f"{run.cpu_share:.0%}"])
    text = scenes.show(f"Live capture at {rate_hz:g} Hz", header, rows)
    load = f"The load average of the machine was {load_before:.1f} before and {os.getloadavg()[0]:.1f} at the end."
    return f"## Live capture\n\n{scenes.provenance(command, seconds)} {load}\n\n{NOTES}\n\n{text}"


def main() -> None:
    """Measure, print, and write the section of RESULTS.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--messages", type=int, default=10_000)
    parser.add_argument("--rate-hz", type=float, default=240.0)
    given = parser.parse_args()
    start, load = time.perf_counter(), os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        runs = _runs(Path(folder), given.messages, given.rate_hz)
    command = f"python -m benchmarks.live --messages {given.messages} --rate-hz {given.rate_hz:g}"
    scenes.write_section("live", table(runs, given.rate_hz, time.perf_counter() - start, load, command))


def _runs(folder: Path, messages: int, rate_hz: float) -> list[Run]:
    made = recording(messages)
    assert made.R_world_sensor is not None
    poses = transform(made.R_world_sensor, made.p_world_sensor * 1e3)
    np.save(folder / "poses.npy", poses)
    carm_kin.write_recording(made, folder / "poses.csv")
    ports = free_port(), free_port()
    peer = ["benchmarks.igtl_peer", str(ports[0]), str(folder / "poses.npy"), f"{rate_hz:g}", str(messages // 2)]
    ours = ["carm_kin", "replay", str(folder / "poses.csv"), "--port", str(ports[1]), "--rate-hz", f"{rate_hz:g}"]
    return [
        measured("pyigtl, stopped half way", peer, ports[0], TOOL, poses, rate_hz, folder / "peer.csv"),
        measured("carm-kin replay", ours, ports[1], "Sensor", poses, rate_hz, folder / "ours.csv"),
    ]


if __name__ == "__main__":
    main()
