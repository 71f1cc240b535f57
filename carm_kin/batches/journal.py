"""The journal of a batch: a line for every recording that is done, so that the rest can be done later."""

import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from carm_kin.errors import InputError
from carm_kin.files import write_atomically
from carm_kin.typed import record

OK, DOUBTFUL, PARTIAL, REFUSED = "ok", "doubtful", "partial", "refused"
BAD_INPUT, FAILED, KILLED = "bad_input", "failed", "killed"
FINAL = (OK, DOUBTFUL, PARTIAL, REFUSED, BAD_INPUT)
"""What would come out again, the input being the same."""
MAX_BYTES = 1_000_000_000


@dataclass(frozen=True)
class Line:
    """How one recording of a batch ended."""

    label: str
    input: str
    """Its path as it was given."""
    status: str
    """ok, doubtful, partial (a part of the offset is told), refused, bad_input, failed (a defect of ours, or no memory
    left) or killed (its worker died)."""
    code: str
    """That of the refusal, or the name of the error; "" where the reason needs none."""
    reason: str
    """Why there is no result; "" where there is one."""
    key: str | None
    """Digest of the input, the settings and the versions; None where nothing is known to be final."""
    result_sha256: str | None
    """Digest of the result's file; None where there is none."""


@dataclass(frozen=True)
class Journal:
    """The journal in a file. A line that was cut off by a kill counts as not written."""

    path: Path

    def read(self) -> dict[str, Line]:
        """The last line of each label; empty where there is no file. Raises InputError for a file of another kind."""
        if not self.path.exists():
            return {}
        try:
            if self.path.stat().st_size > MAX_BYTES:
                raise InputError(f"is larger than {MAX_BYTES // 1_000_000} MB, which is no journal", file=self.path)
            text = self.path.read_bytes().decode(errors="replace")
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}", file=self.path) from None
        found: dict[str, Line] = {}
        for line in text.split("\n"):
            with suppress(InputError, ValueError, RecursionError):
                entry = record(Line, json.loads(line), "the line")
                found[entry.label] = entry
        return found

    def append(self, line: Line) -> None:
        """Write one more line. Raises InputError where the file cannot be written."""
        try:
            with self.path.open("a", encoding="utf-8", newline="\n") as file:
                file.write(_text(line))
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", file=self.path) from None

    def rewrite(self, lines: Iterable[Line]) -> None:
        """Replace the file by these lines. Raises InputError where it cannot be written."""
        write_atomically(self.path, "".join(map(_text, lines)))


def _text(line: Line) -> str:
    return json.dumps(asdict(line)) + "\n"
