"""MATLAB files up to version 7: arrays of 4x4 matrices (N, 4, 4) or (4, 4, N), or of positions and rotations."""

import hashlib
import io
import zlib
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats._arrays import raw_of
from carm_kin.recording.formats._table import read_bytes
from carm_kin.recording.raw import Raw
from carm_kin.recording.recording import Source

SUMMARY = "MATLAB file (.mat, up to -v7) of matrices, or of positions and rotations"
EXTENSIONS = (".mat",)

MAX_BYTES = 5 * 10**8
_BROKEN = (ValueError, TypeError, KeyError, IndexError, OSError, EOFError, MemoryError, OverflowError)


def matches(path: Path, head: bytes) -> bool:
    """The text that MATLAB writes into the first bytes."""
    return head.startswith((b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"))


def read(path: Path, declared: Declarations) -> Raw:
    """Every tool in the file. Raises InputError where it is broken, of version 7.3, or holds no poses."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    data = read_bytes(path, MAX_BYTES)
    if data.startswith(b"MATLAB 7.3"):
        raise InputError("is of version 7.3; save it in MATLAB with save(..., '-v7')", file=path)
    try:
        found = loadmat(io.BytesIO(data))
    except (MatReadError, *_BROKEN, zlib.error) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is no sound MATLAB file: {reason}", file=path) from None
    arrays = {name: np.asarray(values) for name, values in found.items() if not name.startswith("__")}
    return raw_of(arrays, Source(str(path), hashlib.sha256(data).hexdigest()), path)
