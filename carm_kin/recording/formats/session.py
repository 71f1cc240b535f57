"""Sessions: a TOML file that names the tracker's files, their sweeps and labels; or a folder with such a file."""

from pathlib import Path

from carm_kin.recording import session_recording
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.recording import Recording
from carm_kin.recording.session import NAME

SUMMARY = "session: a TOML file of sweeps, each a file of any format or a part of one, with labels"
EXTENSIONS = (".toml",)


def matches(path: Path, head: bytes) -> bool:
    """A TOML file with a table of sweeps, or a folder with a session."""
    if path.is_dir():
        return (path / NAME).is_file()
    return path.suffix.lower() == ".toml" and b"[[sweep]]" in head


def read(path: Path, declared: Declarations) -> Recording:
    """The recording of all sweeps. Raises InputError that names the key and the line."""
    return session_recording.read(path / NAME if path.is_dir() else path)
