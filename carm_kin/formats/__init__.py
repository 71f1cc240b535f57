"""Recording formats, found by name: every public module of this package that has a `read` is one.

A format module has ``read(path) -> Recording``, and may have ``write(recording, path)`` and ``EXTENSIONS``,
the file name endings (".csv") by which it is chosen where no format is named.
"""

import importlib
import os
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from carm_kin.errors import InputError
from carm_kin.recording import Recording


@dataclass(frozen=True)
class Format:
    """One way to store a recording."""

    name: str
    read: Callable[..., Recording]
    write: Callable[..., None] | None
    """None where the format can only be read."""
    extensions: tuple[str, ...]


def formats() -> dict[str, Format]:
    """Every format by its name."""
    found = {}
    names = [module.name for module in pkgutil.iter_modules(__path__)]
    for name in sorted(name for name in names if not name.startswith("_")):
        module = importlib.import_module(f"{__name__}.{name}")
        if hasattr(module, "read"):
            extensions = tuple(getattr(module, "EXTENSIONS", ()))
            found[name] = Format(name, module.read, getattr(module, "write", None), extensions)
    return found


def read_recording(path: str | os.PathLike, format: str | None = None) -> Recording:
    """The recording in a file, in the named format or in the one that the file's extension tells.

    Raises InputError where the format is unknown or the file is not sound.
    """
    return _choose(path, format, formats()).read(path)


def write_recording(recording: Recording, path: str | os.PathLike, format: str | None = None) -> None:
    """Write a recording in the named format or in the one that the file's extension tells.

    Raises InputError where the format is unknown or cannot be written, or the file cannot be.
    """
    writable = {name: found for name, found in formats().items() if found.write is not None}
    write = _choose(path, format, writable).write
    assert write is not None
    write(recording, path)


def _choose(path: str | os.PathLike, name: str | None, known: dict[str, Format]) -> Format:
    """The named format, else the one with the longest extension that the file's name ends with."""
    if name is not None:
        if name not in known:
            raise InputError(f"no format '{name}' here; choose from {', '.join(known)}", file=path)
        return known[name]
    file = Path(path).name.lower()
    fits = [(len(end), found) for found in known.values() for end in found.extensions if file.endswith(end)]
    best = [found for length, found in fits if length == max(fits, key=lambda fit: fit[0])[0]]
    if len(best) != 1:
        likely = ", ".join(found.name for found in best or known.values())
        raise InputError(f"the extension does not tell the format; choose from {likely}", file=path)
    return best[0]
