"""Recording formats, found by name: every public module of this package that has a `read` is one, and every module
that an entry point of the group ``carm_kin.formats`` names.

A format module has

- ``SUMMARY``, one line for the list of formats;
- ``matches(path, head) -> bool``: whether a file that begins with the bytes ``head`` is of this format;
- ``read(path, declared) -> Raw | Recording``: what the file says, which `carm_kin.recording.ingest` makes a recording
  of, or at once a recording where the file states its own conventions;

and may have ``write(recording, path)``, ``HOLDS``, the optional parts of a recording that this writes, ``EXTENSIONS``,
the file name endings (".csv") by which it is chosen where the content does not tell, and ``GENERAL = True``, where the
content fits it only if it fits no other.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from carm_kin.errors import InputError, wrong_type
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats import _folder
from carm_kin.recording.formats._foreign import lines_of, read_cells
from carm_kin.recording.formats._format import Format
from carm_kin.recording.ingest import applied, ingest
from carm_kin.recording.raw import Raw
from carm_kin.recording.recording import Recording
from carm_kin.steps import step
from solvers.plugins import Kind, PluginError, pass_over

__all__ = [
    "FORMATS",
    "Format",
    "format_of",
    "formats",
    "lines_of",
    "read_cells",
    "read_recording",
    "write_recording",
    "writer_of",
]

FORMATS = Kind(__name__, "carm_kin.formats", needs=("SUMMARY", "matches", "read"))
HEAD = 65536
"""Bytes of a file by which its format is told."""


def formats() -> dict[str, Format]:
    """Every format by its name."""
    modules = {name: FORMATS.find(name) for name in FORMATS.names()}
    return {name: _format(name, module) for name, module in modules.items() if hasattr(module, "read")}


def _format(name: str, module: ModuleType) -> Format:
    def matches(path: Path, head: bytes) -> bool:
        try:
            return bool(FORMATS.call(name, (), module.matches, path, head))
        except PluginError as error:
            pass_over(str(error))
            return False

    holds, extensions = (tuple(getattr(module, key, ())) for key in ("HOLDS", "EXTENSIONS"))
    write, general = getattr(module, "write", None), getattr(module, "GENERAL", False)
    return Format(name, module.SUMMARY, matches, module.read, write, holds, extensions, general)


RecordingLike = Recording | str | os.PathLike
"""A recording, or the path of its file."""


def as_recording(recording: RecordingLike) -> Recording:
    """A recording as it is; one in a file as `read_recording` reads it. Raises InputError as that does."""
    return recording if isinstance(recording, Recording) else read_recording(recording)


def as_recordings(recordings: RecordingLike | Sequence[RecordingLike]) -> tuple[Recording, ...]:
    """One recording or several. Raises InputError as `as_recording` does, and where there is none."""
    if isinstance(recordings, str) or not isinstance(recordings, Sequence):
        return (as_recording(recordings),)
    if not recordings:
        raise InputError("no recording is given")
    return tuple(as_recording(recording) for recording in recordings)


def read_recording(
    path: str | os.PathLike, format: str | None = None, declared: Declarations = Declarations()
) -> Recording:
    """The recording in a file, or in a folder of files of one format.

    The format is the named one, or told by the content, or by the extension. ``declared`` says what the file does not.
    Raises InputError where the format is unknown, the file is not sound, or a declaration is missing.
    """
    if not isinstance(path, (str, os.PathLike)):
        hint = "Recording.from_poses(T) makes one of poses (N, 4, 4)" if hasattr(path, "shape") else ""
        raise wrong_type(path, "a recording (a Recording, or the path of its file)", hint)
    with step(f"read {path}") as found:
        recording = _read(Path(path), format, declared)
        found(f"{len(recording)} poses")
    return recording


def _read(path: Path, format: str | None, declared: Declarations) -> Recording:
    chosen = _named(path, format) if format else format_of(path)
    if path.is_dir() and not (chosen and chosen.matches(path, b"")):
        raw, name = _folder.read(path, (lambda file: chosen) if chosen else format_of, declared)
        return ingest(raw, declared, name)
    assert chosen is not None
    raw = chosen.read(path, declared)
    return ingest(raw, declared, chosen.name) if isinstance(raw, Raw) else applied(raw, declared)


def write_recording(recording: RecordingLike, path: str | os.PathLike, format: str | None = None) -> None:
    """Write a recording, or the one in a file, in the named format or in the one that the file's extension tells.

    Raises InputError where the format is unknown or cannot be written, or the file cannot be.
    """
    write = writer_of(path, format).write
    assert write is not None
    write(as_recording(recording), Path(path))


def writer_of(path: str | os.PathLike, format: str | None = None) -> Format:
    """The named format, or the one that the file's extension tells, of those that can be written."""
    writable = {name: found for name, found in formats().items() if found.write is not None}
    if format is None:
        return _by_extension(Path(path), writable)
    if format not in writable:
        raise InputError(f"no format '{format}' here; choose from {', '.join(writable)}", file=path)
    return writable[format]


def format_of(path: Path) -> Format | None:
    """The format of a file, None for a folder of files. Raises InputError where there is none or more than one."""
    known = formats()
    try:
        head = b"" if path.is_dir() else _head(path)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    if head.startswith((b"\xff\xfe", b"\xfe\xff")) and path.suffix != ".csv":
        raise InputError("is UTF-16; save it as UTF-8", file=path)
    fits = [found for found in known.values() if found.matches(path, head)]
    if path.is_dir() and not fits:
        return None
    fits = [found for found in fits if not found.general] or fits
    if len(fits) > 1:
        names = ", ".join(found.name for found in fits)
        raise InputError(f"the content fits several formats; choose one with --format: {names}", file=path)
    return fits[0] if fits else _by_extension(path, known)


def _head(path: Path) -> bytes:
    if not path.is_file():
        raise InputError("is not a file" if path.exists() else "no such file", file=path)
    with path.open("rb") as file:
        return file.read(HEAD)


def _named(path: Path, name: str) -> Format:
    known = formats()
    if name not in known:
        raise InputError(f"no format '{name}' here; choose from {', '.join(known)}", file=path)
    return known[name]


def _by_extension(path: Path, known: dict[str, Format]) -> Format:
    """The format with the longest extension that the file's name ends with."""
    file = path.name.lower()
    fits = [(len(end), found) for found in known.values() for end in found.extensions if file.endswith(end)]
    best = [found for length, found in fits if length == max(fits, key=lambda fit: fit[0])[0]]
    if len(best) != 1:
        likely = ", ".join(found.name for found in best or known.values())
        raise InputError(f"the extension does not tell the format; choose from {likely}", file=path)
    return best[0]
