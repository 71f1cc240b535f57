"""What a command says of its result: the result itself, warnings, files written, its verdict on one line."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from carm_kin.cli.arguments import writable
from carm_kin.cli.terminal import WIDE, Errors, Stderr, Stdout, is_quiet, to_stdout

if TYPE_CHECKING:
    from solvers.estimate import Note


def ended(status: int, verdict: str, message: str) -> int:
    """Say on one line why the command ended, and give back its status."""
    console = Errors()
    console.print(f"{verdict}: ", style="bold red", end="")
    console.print(message.replace("\n", "\\n"), soft_wrap=True)
    return status


def results(*places: str | Path | None) -> Console:
    """Where people read the result: stdout, or stderr where stdout takes its JSON (a place ``-``).

    ``places`` are those where it is written as a whole; with --quiet it is said nowhere else.
    """
    return Stderr(width=WIDE) if "-" in places else Stdout(quiet=is_quiet() and any(places))


def written(path: str | Path, what: str = "") -> None:
    """Say that a file was written, and what it holds."""
    Stderr().print(f"written: {path}" + (f" ({what})" if what else ""), soft_wrap=True)


def warn(notes: "Iterable[Note]") -> None:
    """Say the warnings of a result."""
    from carm_kin.results.summary import show_warnings

    show_warnings(notes, Stderr())


def check_place(as_json: str | None) -> None:
    """Raise InputError where the JSON could not be written, before the work starts."""
    if as_json not in (None, "-"):
        writable(Path(as_json))


def deliver(result: Any, as_json: str | None) -> None:
    """Write the JSON of a result where it was asked for."""
    if as_json == "-":
        to_stdout(result.to_json())
    elif as_json is not None:
        result.to_json(as_json)
        written(as_json)
