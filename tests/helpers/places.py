"""Where things lie: the project, its tests, and recordings that are not part of it."""

import os
from pathlib import Path

TESTS = Path(__file__).parents[1]
ROOT = TESTS.parent
URDF = ROOT / "urdf"
DATA = ROOT.parent / "shared" / "data"
"""Recordings of real trackers beside the project; tests that use them skip where they are absent."""


def pythonpath(*more: Path) -> str:
    """The search path of another Python that shall import the project, and the helpers as the tests do."""
    return os.pathsep.join(filter(None, [str(ROOT), str(TESTS), *map(str, more), os.environ.get("PYTHONPATH", "")]))
