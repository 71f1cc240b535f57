"""What a format of recordings is."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from carm_kin.recording.declarations import Declarations
from carm_kin.recording.raw import Raw
from carm_kin.recording.recording import Recording


@dataclass(frozen=True)
class Format:
    """One way to store a recording."""

    name: str
    summary: str
    matches: Callable[[Path, bytes], bool]
    read: Callable[[Path, Declarations], Raw | Recording]
    write: Callable[[Recording, Path], None] | None
    """None where the format can only be read."""
    holds: tuple[str, ...]
    """What it keeps of a recording beyond the poses."""
    extensions: tuple[str, ...]
    general: bool
    """Others that match go before it."""
