"""Files: TOML from outside, read with its size bounded; any file written whole or not at all."""

import contextlib
import sys
import uuid
from pathlib import Path
from typing import Any

from carm_kin.errors import InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pyright: ignore[reportMissingImports]

MAX_BYTES = 10_000_000


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """The tables of a file that should be ``what``. Raises InputError, without the file's name."""
    try:
        if not path.is_file():
            raise InputError("is not a file" if path.exists() else "no such file")
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"is larger than {MAX_BYTES // 1_000_000} MB, which is no {what}")
        return tables_of(path.read_bytes())
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}") from None


def tables_of(data: bytes) -> dict[str, Any]:
    """The tables of a file's bytes, UTF-8 with or without its mark. Raises InputError."""
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except RecursionError:
        raise InputError("no valid TOML: nested too deeply") from None
    except ValueError as error:
        raise InputError(f"no valid TOML: {error}") from None


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write a whole file or nothing, text as UTF-8. Raises InputError where the place cannot be written."""
    if path.is_dir():
        raise InputError("is a folder; give the name of a file", file=path)
    temporary = path.with_name(f".{uuid.uuid4().hex}.part")
    try:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=path) from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
