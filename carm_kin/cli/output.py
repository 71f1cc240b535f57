"""How a command ends: its result where it was asked for, its verdict on one line."""

from pathlib import Path
from typing import Any

from carm_kin.cli.arguments import writable
from carm_kin.cli.terminal import Stderr, to_stdout


def ended(status: int, verdict: str, message: str) -> int:
    """Say on one line why the command ended, and give back its status."""
    console = Stderr()
    console.print(f"{verdict}: ", style="bold red", end="")
    console.print(message.replace("\n", "\\n"), soft_wrap=True)
    return status


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
