"""How much a command says on stderr: the options -q and -v, which stand before or after its name."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Annotated, Any

import typer

from carm_kin.cli.options import Command, grouped
from carm_kin.cli.terminal import Stderr
from carm_kin.errors import InputError
from carm_kin.steps import LOG

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say errors alone; no summary of what a file holds.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Say what is being done, with times.")]


class App(typer.Typer):
    """A group of commands, each with -h, -q and -v."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(context_settings={"help_option_names": ["-h", "--help"]}, **settings)

    def command(self, *given: Any, **named: Any) -> Any:
        """As typer has it."""
        register = super().command(*given, **named)

        def registered(command: Command) -> Command:
            @wraps(command)
            def whole(*given: Any, loudness: None, **named: Any) -> Any:
                return command(*given, **named)

            return register(grouped("loudness", set_loudness)(whole))

        return registered


def set_loudness(quiet: Quiet = False, verbose: Verbose = False) -> None:
    """Take what was asked for. Raises InputError where both are."""
    if quiet and verbose:
        raise InputError("--quiet and --verbose exclude each other")
    if quiet or verbose:
        LOG.setLevel(logging.ERROR if quiet else logging.INFO)


@contextmanager
def heard() -> Iterator[None]:
    """While a command runs, say on stderr what is logged: warnings, and more where that is asked for."""
    handler, level = _Handler(), LOG.level
    LOG.addHandler(handler)
    LOG.setLevel(logging.WARNING)
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)


class _Handler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        Stderr().print(self.format(record), soft_wrap=True)
