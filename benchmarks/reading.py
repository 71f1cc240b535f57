"""Poses read a second, of every text format, from the file to the checked recording.

python -m benchmarks.reading [--poses 100000]
"""

import argparse
import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import scenes
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats import read_recording

POSES = 100_000
LARGE = 1_000_000
"""Poses of the one large file, some 110 MB."""
RUNS = 5
LEAST = 100_000
"""Poses a second to reach."""

NOTES = """Poses a second of every text format, from the file to the checked recording. The files have 6 digits after
the point and lie on a ram disk; medians of 5 runs in one process of one thread, whose processor time is that by the
clock on a machine that does nothing else. The last row is one file of about 100 MB."""

Poses = tuple[np.ndarray, Rotation, np.ndarray]


def poses(n: int) -> Poses:
    """Positions (n, 3), m, orientations and times, s, of a sensor on an arc."""
    angle = np.linspace(0, 60, n)
    p = np.column_stack([0.7 * np.cos(angle), 0.7 * np.sin(angle), 1.5 + 0.1 * np.sin(angle / 9)])
    return p, Rotation.from_euler("ZYX", np.column_stack([angle, 0.3 * np.sin(angle), 0.1 * angle])), angle


def _rows(before: str, values: np.ndarray, delimiter: str = ",") -> Iterator[str]:
    form = delimiter.join(["%.6f"] * values.shape[1])
    return (before + form % tuple(row) for row in values.tolist())


def native(p: np.ndarray, R: Rotation, t: np.ndarray) -> Iterator[str]:
    yield "x_mm,y_mm,z_mm,qw,qx,qy,qz,time_s"
    yield from _rows("", np.column_stack([p * 1e3, np.roll(R.as_quat(), 1, axis=1), t]))


def plus(p: np.ndarray, R: Rotation, t: np.ndarray) -> Iterator[str]:
    yield from ("ObjectType = Image", "NDims = 3", f"DimSize = 0 0 {len(p)}")
    T = np.tile(np.eye(4), (len(p), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R.as_matrix(), p * 1e3
    for i, matrix in enumerate(_rows("", T.reshape(-1, 16), " ")):
        yield f"Seq_Frame{i:04d}_ProbeToTrackerTransform = {matrix}"
        yield f"Seq_Frame{i:04d}_ProbeToTrackerTransformStatus = OK"
        yield f"Seq_Frame{i:04d}_Timestamp = {t[i]:.6f}"
    yield "ElementDataFile = LOCAL"


def ndi(p: np.ndarray, R: Rotation, t: np.ndarray) -> Iterator[str]:
    yield "Tools,Port 2: Probe s/n:1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error"
    yield from _rows("1,2,500,1,OK,", np.column_stack([np.roll(R.as_quat(), 1, axis=1), p * 1e3, t]))


def ndi_euler(p: np.ndarray, R: Rotation, t: np.ndarray) -> Iterator[str]:
    yield "Tools,Port 2: Probe s/n:1,Frame,Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error,Markers"
    yield from _rows("1,2,500,1,OK,", np.column_stack([R.as_euler("ZYX", degrees=True), p * 1e3, t, t]))


def ndi_capi(p: np.ndarray, R: Rotation, t: np.ndarray) -> Iterator[str]:
    yield "#Tools,ToolInfo,Frame#,PortHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,#Markers"
    rows = _rows("1,Probe s/n:1,500,Port:2,0,OK,", np.column_stack([np.roll(R.as_quat(), 1, axis=1), p * 1e3, t]))
    yield from (f"{row},0" for row in rows)


def motive(p: np.ndarray, R: Rotation, t: np.ndarray) -> Iterator[str]:
    yield "Format Version,1.23,Rotation Type,Quaternion,Length Units,Meters"
    yield from (",," + ",".join([word] * 7) for word in ("Rigid Body", "C-arm", "4A"))
    yield ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position"
    yield "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z"
    yield from _rows("", np.column_stack([t, t, R.as_quat(), p]))


def tum(p: np.ndarray, R: Rotation, t: np.ndarray) -> Iterator[str]:
    yield from _rows("", np.column_stack([t, p, R.as_quat()]), " ")


def table(p: np.ndarray, R: Rotation, t: np.ndarray) -> Iterator[str]:
    yield "time_s,x,y,z,qw,qx,qy,qz"
    yield from _rows("", np.column_stack([t, p * 1e3, np.roll(R.as_quat(), 1, axis=1)]))


def hololens_json(p: np.ndarray, R: Rotation, t: np.ndarray) -> Iterator[str]:
    keys = ("time_s", "Tx", "Ty", "Tz", "Ry", "Rx", "Rz")
    values = np.column_stack([t, p, R.as_euler("YXZ", degrees=True)])
    yield from (json.dumps(dict(zip(keys, row, strict=True))) for row in values.round(6).tolist())


def hololens_lines(p: np.ndarray, R: Rotation, t: np.ndarray) -> Iterator[str]:
    T = np.tile(np.eye(4), (len(p), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R.as_matrix(), p
    yield from _rows("", np.column_stack([t * 1e7, T.reshape(-1, 16)]))


def tfm(p: np.ndarray, R: Rotation, t: np.ndarray) -> Iterator[str]:
    yield "#Insight Transform File V1.0"
    for row in _rows("", np.column_stack([R.as_matrix().reshape(-1, 9), p * 1e3]), " "):
        yield "Transform: AffineTransform_double_3_3"
        yield f"Parameters: {row}"
        yield "FixedParameters: 0 0 0"


FORMATS: dict[Callable[..., Iterator[str]], tuple[str, Declarations]] = {
    native: ("rec.csv", Declarations()),
    plus: ("rec.igs.mha", Declarations()),
    ndi: ("ndi.csv", Declarations()),
    ndi_euler: ("euler.csv", Declarations()),
    ndi_capi: ("capi.csv", Declarations()),
    motive: ("take.csv", Declarations()),
    tum: ("rec.tum", Declarations()),
    table: ("log.csv", Declarations(unit="mm")),
    hololens_json: ("head.json", Declarations(left_handed=True)),
    hololens_lines: ("rig.txt", Declarations()),
    tfm: ("poses.tfm", Declarations()),
}
"""How a format is written, its file and what must be declared of it."""


def measured(write: Callable[..., Iterator[str]], n: int, folder: Path, runs: int) -> list[str]:
    """The row of the table of one format: MB, s by the clock and of the processor, poses a second of the latter."""
    file, declared = FORMATS[write]
    path = folder / file
    path.write_text("\n".join(write(*poses(n))) + "\n", encoding="utf-8")
    wall, processor = [], []
    for _ in range(runs):
        start, start_processor = time.perf_counter(), time.process_time()
        recording = read_recording(path, declared=declared)
        wall.append(time.perf_counter() - start)
        processor.append(time.process_time() - start_processor)
        assert len(recording) == n, (file, len(recording))
    size = path.stat().st_size / 1e6
    path.unlink()
    seconds = statistics.median(processor)
    shown = f"{statistics.median(wall):.2f}"
    return [write.__name__, f"{n:,}", f"{size:.0f}", shown, f"{seconds:.2f}", f"{n / seconds:,.0f}"]


def main() -> None:
    """Measure, print, and write the section of RESULTS.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--poses", type=int, default=POSES)
    n = parser.parse_args().poses
    start = time.perf_counter()
    ram = "/dev/shm"
    with tempfile.TemporaryDirectory(dir=ram if os.path.isdir(ram) else None) as folder:
        rows = [measured(write, n, Path(folder), RUNS) for write in FORMATS]
        rows.append(measured(ndi, LARGE, Path(folder), 1))
    header = ["format", "poses", "MB", "s by the clock", "s of the processor", "poses a second"]
    text = scenes.show(f"Reading; to reach: {LEAST:,} poses a second", header, rows)
    told = scenes.provenance(f"python -m benchmarks.reading --poses {n}", time.perf_counter() - start)
    scenes.write_section("reading", f"## Reading\n\n{told}\n\n{NOTES}\n\n{text}")


if __name__ == "__main__":
    main()
