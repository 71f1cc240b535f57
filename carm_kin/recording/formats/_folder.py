"""A folder of files of one format, as of one pose or one stop of the C each. No format itself."""

import hashlib
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats._format import Format
from carm_kin.recording.raw import Raw, joined
from carm_kin.recording.recording import Source
from solvers.estimate import Note

MAX_FILES = 100_000
FILE = "file"
"""The metadata that tell from which file of the folder a pose is."""


def read(folder: Path, format_of: Callable[[Path], Format | None], declared: Declarations) -> tuple[Raw, str]:
    """The frames of all files in a folder, in the order of their names with numbers counted, and the format's name.

    Files of no known format are left out and named in a note. Raises InputError where there is no recording in the
    folder, or files of several formats.
    """
    formats, others = {}, []
    for path in files_of(folder):
        try:
            found = format_of(path)
        except InputError:
            found = None
        if found is None:
            others.append(path.name)
        else:
            formats[path] = found
    names = sorted({found.name for found in formats.values()})
    if not names:
        raise InputError("the folder holds no file in a known format", file=folder)
    if len(names) > 1:
        raise InputError(f"the folder holds files of several formats: {', '.join(names)}; see --format", file=folder)
    raws = []
    for path, found in formats.items():
        raw = found.read(path, declared)
        if not isinstance(raw, Raw):
            raise InputError(f"files in the format '{found.name}' are read one by one, or through a session", file=path)
        raws.append(replace(raw, metadata={**raw.metadata, FILE: np.full(len(raw), path.name, object)}))
    digest = hashlib.sha256("".join(raw.source.sha256 for raw in raws).encode()).hexdigest()
    whole = joined(raws, Source(str(folder), digest))
    return (replace(whole, notes=(*whole.notes, _left_out(others))) if others else whole), names[0]


def files_of(folder: Path) -> list[Path]:
    """The visible files in a folder: ``NDI_2`` before ``NDI_10``."""
    try:
        files = [path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")]
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=folder) from None
    if len(files) > MAX_FILES:
        raise InputError(f"has {len(files)} files; at most {MAX_FILES} are read", file=folder)
    return sorted(files, key=lambda path: [(int(n or 0), text) for text, n in re.findall(r"(\D+)|(\d+)", path.name)])


def _left_out(names: list[str]) -> Note:
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return Note("files_left_out", f"{len(names)} files in the folder are no recordings: {', '.join(names[:5])}{more}")
