"""NumPy archives: arrays of 4x4 matrices, or of positions and rotations; nothing pickled is read."""

import hashlib
import io
import zipfile
import zlib
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats._arrays import raw_of
from carm_kin.recording.formats._table import read_bytes
from carm_kin.recording.raw import Raw
from carm_kin.recording.recording import Source

SUMMARY = "NumPy archive (.npz) of matrices, or of positions and rotations"
EXTENSIONS = (".npz",)

MAX_BYTES = 2 * 10**9
"""Of the file and of what it unpacks to."""


def matches(path: Path, head: bytes) -> bool:
    """A zip archive whose first entry is an array."""
    return head.startswith(b"PK\x03\x04") and b".npy" in head[:300]


def read(path: Path, declared: Declarations) -> Raw:
    """Every tool in the archive. Raises InputError where it is broken or holds no poses."""
    data = read_bytes(path, MAX_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > MAX_BYTES:
                raise InputError(f"unpacks to more than {MAX_BYTES / 1e9:.0f} GB", file=path)
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, KeyError, EOFError, SyntaxError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is no sound NumPy archive: {reason}", file=path) from None
    arrays = {name: values for name, values in arrays.items() if isinstance(values, np.ndarray)}
    return raw_of(arrays, Source(str(path), hashlib.sha256(data).hexdigest()), path)
