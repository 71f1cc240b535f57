"""Static pictures by matplotlib, which is asked for where it is missing."""

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carm_kin.canvas import figure
from carm_kin.errors import InputError
from carm_kin.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["COLOURS", "FORMATS", "check_figure", "figure", "save"]

COLOURS = ("#0b6e4f", "#1f6feb", "#c2410c", "#6b7280", "#9333ea", "#b45309", "#0e7490", "#be185d")
FORMATS = ("svg", "png", "pdf")


def check_figure(path: Path) -> Path:
    """The path of a figure that can be drawn, checked before the work starts.

    Raises InputError for another extension than those of `FORMATS`, MissingDependencyError without matplotlib.
    """
    if path.suffix[1:].lower() not in FORMATS:
        raise InputError(f"the extension of a figure is one of {', '.join(FORMATS)}", file=path)
    figure(1, 1)
    return path


def save(drawn: "Figure", path: Path) -> None:
    """Write a figure whole or not at all; the same figure gives the same bytes. Raises InputError as `check_figure`."""
    import matplotlib

    kind, data = check_figure(path).suffix[1:].lower(), io.BytesIO()
    metadata: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind, {})
    with matplotlib.rc_context({"svg.hashsalt": "carm-kin", "svg.fonttype": "none"}):
        drawn.savefig(data, format=kind, dpi=150, metadata=metadata)
    write_atomically(path, data.getvalue())
