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
from carm_kin.machine.urdf import UrdfFile
from carm_kin.results.result import CalibrationResult, ResultLike, as_result
from solvers.plugins import Kind

__all__ = [
    "EXPORTS",
    "SENSOR_CARM",
    "TRANSFORMS",
    "WORLD_TORUS",
    "Export",
    "Wanted",
    "export",
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


def export(
    result: ResultLike,
    to: str,
    out: str | os.PathLike,
    *,
    transform: str = SENSOR_CARM,
    placement: str | None = None,
    parent_frame: str | None = None,
    child_frame: str | None = None,
    urdf: UrdfFile | str | os.PathLike | None = None,
) -> CalibrationResult:
    """Write a calibration, or the one in a file, for another program, and give it back; ``to`` is one of `exports`.

    The rest is what `Wanted` says. Raises RefusedError for a refused or partial calibration; InputError for an unknown
    name, for something that this export has no use for, for what the result does not hold, and where the place cannot
    be written.
    """
    result, wanted = as_result(result), Wanted(transform, placement, parent_frame, child_frame, urdf)
    known = exports()
    if to not in known:
        raise InputError(f"no export '{to}'; choose from {', '.join(known)}")
    if result.refusal:
        words = f"a refused calibration is not exported: {result.refusal.message}"
        raise RefusedError(result.refusal.code, words)
    if result.status == "partial":
        untold = "; ".join(result.observability.unobservable)
        raise RefusedError("partial", f"a partial calibration is not exported, its own JSON has what is told: {untold}")
    default = Wanted()
    for name in (field.name for field in fields(Wanted)):
        if getattr(wanted, name) != getattr(default, name) and name not in known[to].takes:
            raise InputError(f"the export '{to}' has no use for '{name.replace('_', '-')}'")
    known[to].write(result, Path(out), wanted)
    return result
