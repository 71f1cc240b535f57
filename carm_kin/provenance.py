"""Where a result comes from: versions, input, command, seed and date."""

from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from platform import python_version

from carm_kin.recording import Recording
from carm_kin.result import Provenance


def provenance_of(recording: Recording | None, command: str | None, seed: int | None) -> Provenance:
    """Provenance of a result; of the input only the file's name and digest, never its folder."""
    versions = {"python": python_version()}
    for package in ("carm-kin", "numpy", "casadi", "pin"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    source = recording.source if recording else None
    return Provenance(
        versions=versions,
        input_name=source.path.replace("\\", "/").rsplit("/", 1)[-1] if source else None,
        input_sha256=source.sha256 if source else None,
        command=command,
        seed=seed,
        date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
    )
