"""Exports of a calibration to other programs, found by name: every public module of this package is one, and every
module that an entry point of the group ``carm_kin.exports`` names.

An export module has ``ENDING`` (of its file name), ``SUMMARY`` (one line), ``TAKES`` (which of the fields of `Wanted`
it looks at) and ``write(result, out, wanted)``. Every file holds the convention, the units, the standard deviations,
the date and the hash of the recording: `facts` has them in words.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

from carm_kin.errors import InputError, RefusedError
from carm_kin.exports._wanted import SENSOR_CARM, TRANSFORMS, WORLD_TORUS, Wanted, facts, subject_of
from carm_kin.results.result import CalibrationResult
from solvers.plugins import Kind

__all__ = [
    "EXPORTS",
    "SENSOR_CARM",
    "TRANSFORMS",
    "WORLD_TORUS",
    "Export",
    "Wanted",
    "export_result",
    "exports",
    "facts",
    "subject_of",
]

EXPORTS = Kind(__name__, "carm_kin.exports", needs=("ENDING", "SUMMARY", "TAKES", "write"))


@dataclass(frozen=True)
class Export:
    """One kind of file that a calibration is written to."""

    name: str
    ending: str
    summary: str
    takes: frozenset[str]
    """The fields of `Wanted` that it looks at."""
    write: Callable[[CalibrationResult, Path, Wanted], None]


def exports() -> dict[str, Export]:
    """Every export by its name."""
    modules = {name: EXPORTS.find(name) for name in EXPORTS.names()}
    return {
        name: Export(name, module.ENDING, module.SUMMARY, frozenset(module.TAKES), module.write)
        for name, module in modules.items()
    }


def export_result(
    result: CalibrationResult, to: str, out: str | os.PathLike, wanted: Wanted = Wanted()
) -> CalibrationResult:
    """Write a calibration for another program, and give it back; ``to`` is one of `exports`.

    Raises RefusedError for a refused calibration; InputError for an unknown name, for a field of ``wanted`` that
    this export has no use for, for what the result does not hold, and where the place cannot be written.
    """
    known = exports()
    if to not in known:
        raise InputError(f"no export '{to}'; choose from {', '.join(known)}")
    if result.refusal:
        words = f"a refused calibration is not exported: {result.refusal.message}"
        raise RefusedError(result.refusal.code, words)
    default = Wanted()
    for name in (field.name for field in fields(Wanted)):
        if getattr(wanted, name) != getattr(default, name) and name not in known[to].takes:
            raise InputError(f"the export '{to}' has no use for '{name.replace('_', '-')}'")
    known[to].write(result, Path(out), wanted)
    return result
