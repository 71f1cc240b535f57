"""What the command writes to: plain text on stderr, results on stdout, whoever reads them to the end or not."""

import os
import sys
import warnings
from io import TextIOWrapper
from typing import Any

from rich.console import Console


class Stderr(Console):
    """Text without markup; control characters are shown, not sent."""

    def __init__(self) -> None:
        super().__init__(stderr=True, highlight=False, markup=False, emoji=False)

    def print(self, *objects: Any, **more: Any) -> None:
        super().print(*(_printable(x) if isinstance(x, str) else x for x in objects), **more)

    def on_broken_pipe(self) -> None:
        _discard(sys.stderr)


def use_any_encoding() -> None:
    """Show what a terminal cannot encode by its number, instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def use_plain_warnings() -> None:
    """Show warnings for users, such as of a plug-in that is passed over, on a line without the place in the code."""
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, UserWarning):
            Stderr().print(f"warning: {message}", soft_wrap=True)
        else:
            usual(message, category, *where, **more)

    warnings.showwarning = show


def to_stdout(text: str) -> None:
    """Write all of it at once, so that a closed pipe is seen here and not when Python ends."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        _discard(sys.stdout)


def _printable(text: str) -> str:
    """Control characters as escapes; line breaks stay."""
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)


def _discard(stream: Any) -> None:
    """Let what is still to be written to a closed pipe vanish without a complaint."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
