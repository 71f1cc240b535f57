"""The contract of an export, each check a function of its name; an AssertionError says what is broken."""

import re
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from carm_kin.calibration.calibrate import calibrate
from carm_kin.errors import CarmKinError, InputError, RefusedError
from carm_kin.exports import Wanted, export, exports
from carm_kin.recording.recording import Recording
from carm_kin.results.parts import Provenance
from carm_kin.results.result import CalibrationResult
from carm_kin.testing.truth import machine, problem, sweeps_deg

DATE, SHA256 = "2031-02-03T04:05:06+00:00", "5c" * 32
HOSTILE = "x-->\n<c/>\r\nTransform: --"
"""What a file's name or a version could hold."""


def check_export(name: str) -> None:
    """Every check below. Raises AssertionError for a broken promise, KeyError where no export has that name."""
    for check in (
        says_what_it_is,
        facts_are_in_the_file,
        hostile_provenance_stays_a_comment,
        without_a_sigma_it_says_so,
        refused_calibration_is_not_exported,
        result_without_a_chain_is_not_exported,
    ):
        check(name)


def says_what_it_is(name: str) -> None:
    """An ending, a sentence, and which fields of `Wanted` it looks at."""
    one = exports()[name]
    assert re.fullmatch(r"\.[a-z0-9]+", one.ending), f"the ending '{one.ending}' is not like '.tfm'"
    assert one.summary.endswith("."), "the summary is no sentence"
    unknown = one.takes - {field.name for field in fields(Wanted)}
    assert not unknown, f"TAKES has {', '.join(sorted(unknown))}, which `Wanted` has not"


def facts_are_in_the_file(name: str) -> None:
    """Convention, units, standard deviations, date, hash of the recording, and what the transform means."""
    text = exported(result(), name)
    for fact in ("convention", "units", "sigma"):
        assert fact in text.lower(), f"the file does not state its {fact}"
    assert re.search(r"\bmm\b|\bmetres\b|\bm, rad\b", text), "the file states no unit of length"
    assert SHA256 in text, "the file has not the hash of the recording"
    assert DATE[:10] in text, "the file has no date"
    assert "rotation centre" in text, "the file does not say what the transform means"


def hostile_provenance_stays_a_comment(name: str) -> None:
    """Line breaks in a name, a date or a version begin no line of the file."""
    versions = {"carm-kin": HOSTILE}
    origin = replace(result().provenance, input_name=HOSTILE, input_sha256=HOSTILE, date=HOSTILE, versions=versions)
    text = exported(replace(result(), provenance=origin), name)
    for line in HOSTILE.splitlines()[1:]:
        assert f"\n{line}" not in text, f"'{line}' has become a line of the file"


def without_a_sigma_it_says_so(name: str) -> None:
    """In the result of a solver that gives none."""
    closed = calibrate(recording(), "closed_form")
    assert re.search(r"unknown|null", exported(closed, name)), "the file does not say that sigma is unknown"


def refused_calibration_is_not_exported(name: str) -> None:
    """And no file is begun."""
    whole = recording()
    refused = calibrate(whole.select(slice(10)))
    assert refused.refusal is not None
    _is_not_exported(refused, name, RefusedError)


def result_without_a_chain_is_not_exported(name: str) -> None:
    """Such as one of the solver ``surface``, which has no orientations."""
    _is_not_exported(calibrate(recording(), "surface"), name, InputError)


def exported(found: CalibrationResult, name: str) -> str:
    """The text of the file."""
    return _in_a_file(exports()[name].ending, lambda out: export(found, name, out))


def _in_a_file(ending: str, write: Callable[[Path], object]) -> str:
    with TemporaryDirectory() as folder:
        out = Path(folder) / f"out{ending}"
        write(out)
        return out.read_text(encoding="utf-8")


def _is_not_exported(found: CalibrationResult, name: str, kind: type[CarmKinError]) -> None:
    with TemporaryDirectory() as folder:
        try:
            export(found, name, Path(folder) / "out")
        except kind:
            assert not list(Path(folder).iterdir()), "a file was begun"
        else:
            raise AssertionError("it was exported")


@cache
def recording() -> Recording:
    """Sixty exact poses of a C-arm in closed form, but for noise far below what an export prints."""
    turn = range(0, 360, 30)
    poses = problem(machine(5, 0.06, 0.01), sweeps_deg((-90, 0, 90), turn, (0, 70), turn), 1e-9, 1e-9)
    return Recording(poses.p_world_sensor, poses.R_world_sensor)


@cache
def result() -> CalibrationResult:
    """Of `recording`, of a date and a hash that are known."""
    origin = Provenance({"carm-kin": "9.8.7", "numpy": "1"}, "a -- b\n<c>.csv", SHA256, None, None, DATE)
    return replace(calibrate(recording()), provenance=origin)
