"""The recording that a capture writes: the native CSV, line by line, on the disk before anything is done with it.

At any moment, a kill or a power cut included, the file holds every line that `CaptureFile.append` was done with; at
most the line after them is torn, which going on with the file repairs.
"""

import contextlib
import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from carm_kin.errors import InputError
from carm_kin.streams.frames import Frame
from carm_kin.streams.marks import Marks
from solvers.se3 import quat_wxyz_from_rotation

_POSE = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
_to_disk = getattr(os, "fdatasync", os.fsync)


def header(marks: Marks) -> bytes:
    """The first line."""
    joints = (f"q_{marks.angular}_deg", f"q_{marks.orbital}_deg")
    columns = (*_POSE, "time_s", "sweep", "moving", "placement", *joints, "received_s", "fault")
    return (",".join(columns) + "\n").encode()


def line(frame: Frame, marks: Marks) -> bytes:
    """The line of a frame: nanometres, 1e-9 of the quaternion, microseconds."""
    pose = [""] * len(_POSE)
    if frame.T is not None:
        pose = [f"{x:.6f}" for x in frame.T[:3, 3] * 1000]
        pose += [f"{q:.9f}" for q in quat_wxyz_from_rotation(frame.T[:3, :3])]
    fault = "".join(c if c.isalnum() or c in " _-()" else "_" for c in frame.fault)
    cells = (*pose, f"{frame.time_s:.6f}", *marks.cells, f"{frame.received_s:.6f}", fault)
    return (",".join(cells) + "\n").encode()


@dataclass(frozen=True, eq=False)
class CaptureFile:
    """A recording that grows; use it as a context."""

    path: Path
    file: BinaryIO
    marks: Marks
    """Those with which the capture begins."""
    begun: int
    """Bytes that were there before the first line."""

    @staticmethod
    def create(path: Path, marks: Marks) -> "CaptureFile":
        """A file with a header. Raises InputError where it is there, or cannot be made."""
        try:
            file = path.open("xb", buffering=0)
        except FileExistsError:
            raise InputError("the file exists; give another name, or --append to go on with it", file=path) from None
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", file=path) from None
        made = CaptureFile(path, file, marks, len(header(marks)))
        made._write(header(marks))
        _directory_to_disk(path.parent)
        return made

    @staticmethod
    def resume(path: Path, marks: Marks) -> "CaptureFile":
        """The file to go on with, its torn last line cut off; its sweeps and placements count on.

        Raises InputError where the file is none that a capture with the same joints wrote.
        """
        if not path.exists():
            return CaptureFile.create(path, marks)
        first = header(marks)
        try:
            file = path.open("r+b", buffering=0)
            start = file.read(len(first))
            if not first.startswith(start):
                file.close()
                raise InputError("was not written by a capture of these joints; give another name", file=path)
            end = _end_of_lines(file)
            file.truncate(end)
            file.seek(0)
            if end:
                return CaptureFile(path, file, _counted_on(file, marks), len(first))
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", file=path) from None
        made = CaptureFile(path, file, marks, len(first))
        made._write(first)
        return made

    def append(self, frames: Iterable[Frame], marks: Marks) -> None:
        """Write the frames; they are on the disk when this returns. Raises InputError where they cannot be."""
        self._write(b"".join(line(frame, marks) for frame in frames))

    def __enter__(self) -> "CaptureFile":
        return self

    def __exit__(self, *_: object) -> None:
        """Close it; a file without a single frame is removed."""
        empty = self.file.tell() <= self.begun
        self.file.close()
        if empty:
            self.path.unlink(missing_ok=True)

    def _write(self, data: bytes) -> None:
        try:
            while data:
                data = data[self.file.write(data) :]
            _to_disk(self.file.fileno())
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", file=self.path) from None


def _end_of_lines(file: BinaryIO) -> int:
    """Where the last complete line ends."""
    size = file.seek(0, os.SEEK_END)
    begin = max(size - 4096, 0)
    file.seek(begin)
    return begin + file.read().rfind(b"\n") + 1


def _counted_on(file: BinaryIO, marks: Marks) -> Marks:
    """The marks with sweeps and placements after those of the file, which is left at its end."""
    names = file.readline().decode().rstrip().split(",")
    sweep, placement = names.index("sweep"), names.index("placement")
    last, cells = marks.sweep, []
    for cells in (row.split(b",") for row in file):
        last = max(last, int(cells[sweep] or 0))
    return replace(marks, sweep=last, placement=int(cells[placement]) if cells else marks.placement)


def _directory_to_disk(folder: Path) -> None:
    """Make a new file's name survive a power cut, where the system knows how."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
