"""Where a result comes from: versions, input, command, seed and date."""

import shlex
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from platform import python_version

from carm_kin.recording.recording import Recording
from carm_kin.results.parts import Provenance

PACKAGES = ("carm-kin", "numpy", "casadi", "pin")


def provenance_of(recording: Recording | None, command: str | None, seed: int | None) -> Provenance:
    """Provenance of a result; of the input only the file's name and digest, never its folder."""
    source = recording.source if recording else None
    return Provenance(
        versions=versions(),
        input_name=_name(source.path) if source else None,
        input_sha256=source.sha256 if source else None,
        command=command,
        seed=seed,
        date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        intakes=recording.intakes if recording else (),
    )


def versions(packages: Sequence[str] = PACKAGES) -> dict[str, str]:
    """The versions of Python and of those packages that are installed."""
    found = {"python": python_version()}
    for package in packages:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def command_line(arguments: Sequence[str]) -> str:
    """The command as it could be typed again, every path cut to its file name."""
    return shlex.join(["carm-kin", *map(_without_folder, arguments)])


def _without_folder(argument: str) -> str:
    """``--json=/home/me/out.json`` becomes ``--json=out.json``."""
    option, equals, value = argument.partition("=") if argument.startswith("-") else ("", "", argument)
    if option and not equals:
        short = option[:2] if not option.startswith("--") and "/" in option else ""
        return short + _name(option)
    return option + equals + _name(value)


def _name(path: str) -> str:
    return path.replace("\\", "/").rstrip("/").rsplit("/", 1)[-1]
