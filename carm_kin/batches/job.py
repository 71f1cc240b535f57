"""What a worker does for one recording of a batch: the file calibrated, and the key by which it is known as done."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path

from carm_kin.batches.journal import BAD_INPUT, DOUBTFUL, OK, PARTIAL, REFUSED
from carm_kin.calibration.by_settings import calibrate_as
from carm_kin.calibration.settings import Settings
from carm_kin.errors import InputError
from carm_kin.machine.urdf import find_urdf
from carm_kin.recording.formats import read_recording
from carm_kin.results import provenance

BLOCK = 1 << 20


@dataclass(frozen=True)
class Report:
    """What came out of one file; all of it follows from the file, the settings and the versions, but for the date."""

    status: str
    code: str
    reason: str
    key: str | None
    """None where the file cannot be read."""
    text: str | None
    """The result's JSON, also that of a refusal; None for bad input."""


@cache
def versions() -> dict[str, str]:
    """The versions of all that has a say in the numbers; they do not change while a process runs."""
    return provenance.versions((*provenance.PACKAGES, "scipy"))


def key_of(path: Path, settings: Settings, here: Mapping[str, str]) -> str:
    """Digest of the file, its URDF, the settings and the versions. Raises InputError where a file cannot be read."""
    known = asdict(settings) | {"input": _digest(path), "versions": dict(here)}
    if settings.urdf is not None:
        known["urdf"] = _digest(find_urdf(settings.urdf))
    return sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()


def calibrate_file(path: Path, settings: Settings, expected: Mapping[str, str]) -> Report:
    """Calibrate the recording in a file. What is wrong with it is a report.

    Raises InputError where the versions here are not the ``expected`` ones of who started the batch.
    """
    here = versions()
    if here != expected:
        differ = [f"{name} {here.get(name, 'missing')}" for name in expected if here.get(name) != expected[name]]
        raise InputError(f"this worker has {', '.join(differ)}: not what the batch was started with")
    key = None
    try:
        key = key_of(path, settings, here)
        result = calibrate_as(read_recording(path), settings, settings.command(str(path)))
    except InputError as error:
        return Report(BAD_INPUT, "", str(error), key, None)
    if result.refusal:
        return Report(REFUSED, result.refusal.code, result.refusal.message, key, result.to_json())
    if result.status == DOUBTFUL:
        note = next(note for note in result.warnings if note.code == "parts_disagree")
        return Report(DOUBTFUL, note.code, note.message, key, result.to_json())
    if result.status == PARTIAL:
        return Report(PARTIAL, "", f"not told: {'; '.join(result.observability.unobservable)}", key, result.to_json())
    return Report(OK, "", "", key, result.to_json())


def _digest(path: Path) -> str:
    total = sha256()
    try:
        if not path.is_file():
            raise InputError("is not a file" if path.exists() else "no such file", file=path)
        with path.open("rb") as file:
            while block := file.read(BLOCK):
                total.update(block)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    return total.hexdigest()
