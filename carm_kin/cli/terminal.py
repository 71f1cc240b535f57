"""What the command writes to: results on stdout, all else on stderr, whoever reads them to the end or not."""

import logging
import os
import sys
import warnings
from io import TextIOWrapper
from typing import Any

from rich.console import Console

from carm_kin.errors import printable
from carm_kin.steps import LOG

WIDE = 10_000
"""Columns of a place where nothing is cut or wrapped."""


class _Plain(Console):
    """Text without markup; control characters are shown, not sent."""

    def __init__(self, *, stderr: bool, quiet: bool = False, width: int | None = None) -> None:
        super().__init__(stderr=stderr, quiet=quiet, width=width, highlight=False, markup=False, emoji=False)

    def print(self, *objects: Any, **more: Any) -> None:
        super().print(*(printable(x) if isinstance(x, str) else x for x in objects), **more)

    def on_broken_pipe(self) -> None:
        _discard(sys.stderr if self.stderr else sys.stdout)


class Stdout(_Plain):
    """Results, as wide as they are."""

    def __init__(self, *, quiet: bool = False) -> None:
        super().__init__(stderr=False, quiet=quiet, width=WIDE)


class Stderr(_Plain):
    """Warnings, progress, what was written: nothing with --quiet."""

    def __init__(self, *, width: int | None = None) -> None:
        super().__init__(stderr=True, quiet=is_quiet(), width=width)


class Errors(_Plain):
    """Why a command ended, --quiet or not."""

    def __init__(self) -> None:
        super().__init__(stderr=True)


def is_quiet() -> bool:
    """Whether errors alone are to be said."""
    return not LOG.isEnabledFor(logging.WARNING)


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


def _discard(stream: Any) -> None:
    """Let what is still to be written to a closed pipe vanish without a complaint."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
