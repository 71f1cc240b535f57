"""Runs the command in this process."""

from dataclasses import dataclass
from unittest.mock import patch

import pytest

from carm_kin.cli import main as cli


@dataclass(frozen=True)
class Ended:
    """How the command ended."""

    status: int
    out: str
    err: str


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> Ended:
    """``carm-kin ARGUMENTS``; what it printed before is discarded."""
    capsys.readouterr()
    with patch("sys.argv", ["carm-kin", *map(str, arguments)]), pytest.raises(SystemExit) as ended:
        cli.main()
    captured = capsys.readouterr()
    return Ended(int(ended.value.code or 0), captured.out, captured.err)


def fails(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line of a command that ends on bad input, without ``error: ``."""
    ended = run(capsys, *arguments)
    lines = ended.err.splitlines()
    assert ended.status == 2, ended
    assert ended.out == ""
    assert len(lines) == 1, ended.err
    assert lines[0].startswith("error: ")
    return lines[0].removeprefix("error: ")
