"""TUM trajectories: ``time x y z qx qy qz qw`` a line, seconds and metres, ``#`` for comments."""

from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from carm_kin.files import write_atomically
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats._foreign import head_lines, lines_of, read_cells
from carm_kin.recording.raw import Raw, Track
from carm_kin.recording.recording import Recording
from solvers.se3 import quat_wxyz_from_rotation

SUMMARY = "TUM trajectory, as of SLAM and visual odometry: time x y z qx qy qz qw"
EXTENSIONS = (".tum",)
HOLDS = ("time_s",)

TOOL = "trajectory"
_NAMES = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")


def matches(path: Path, head: bytes) -> bool:
    """Eight numbers between spaces in the first line that is no comment."""
    lines = head_lines(head, 1)
    cells = lines[0].split() if lines else []
    return len(cells) == len(_NAMES) and all(_is_number(cell) for cell in cells)


def read(path: Path, declared: Declarations) -> Raw:
    """The poses of the one trajectory in the file."""
    lines, source = lines_of(path, "a line 'time x y z qx qy qz qw'", " ")
    cells = read_cells(lines, _NAMES, _NAMES)
    track = Track(cells.stack(_NAMES[1:4]), cells.stack(_NAMES[4:]))
    return Raw({TOOL: track}, source, "m", "xyzw", time_s=cells.numbers["time"], cut_off=cells.cut_off)


def write(recording: Recording, path: Path) -> None:
    """Write poses and times. Raises InputError where the recording has no orientations or no times."""
    if recording.R_world_sensor is None or recording.time_s is None:
        raise InputError("a TUM trajectory needs orientations and times (time_s)", file=path)
    quat_xyzw = np.roll(quat_wxyz_from_rotation(recording.R_world_sensor), -1, axis=1)
    rows = np.column_stack([recording.time_s, recording.p_world_sensor, quat_xyzw]).tolist()
    write_atomically(path, "# " + " ".join(_NAMES) + "\n" + "".join(" ".join(map(repr, row)) + "\n" for row in rows))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
