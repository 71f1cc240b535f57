"""The ``<Transform>`` of a PLUS configuration file."""

import re
from datetime import datetime
from pathlib import Path
from xml.sax.saxutils import quoteattr

from carm_kin.errors import InputError
from carm_kin.exports._wanted import Subject, Wanted, facts, in_xml_comment, subject_of
from carm_kin.files import write_atomically
from carm_kin.results.result import CalibrationResult

ENDING = ".xml"
SUMMARY = "PLUS configuration: a Transform element with matrix (mm), error and date."
TAKES = ("transform", "placement", "parent_frame", "child_frame")

_SEPARATOR = re.compile(r"To[^a-z]")
"""How PLUS tells the two frames in the name of a transform."""


def write(result: CalibrationResult, out: Path, wanted: Wanted) -> None:
    """Write the file."""
    subject = subject_of(result, wanted)
    child, parent = (_frame(name) for name in (subject.child, subject.parent))
    convention = f"p_{parent} = Matrix p_{child}; row after row; Error is the rms position residual, mm; Date is in UTC"
    lines = ["<PlusConfiguration>"]
    lines += [f"  <!-- {in_xml_comment(line)} -->" for line in facts(result, subject, convention, "mm")]
    lines += [
        "  <CoordinateDefinitions>",
        f'    <Transform From="{child}" To="{parent}"',
        f'      Matrix="{_matrix(subject)}"',
        f'      Error="{result.residuals.translation_rms_m * 1e3:.9g}" Date={quoteattr(_date(result))} />',
        "  </CoordinateDefinitions>",
        "</PlusConfiguration>",
    ]
    write_atomically(out, "\n".join(lines) + "\n")


def _matrix(subject: Subject) -> str:
    T = subject.T_parent_child.copy()
    T[:3, 3] *= 1e3
    rows = (" ".join(repr(float(value)) for value in row) for row in T + 0.0)
    return "".join(f"\n        {row}" for row in rows)


def _frame(name: str) -> str:
    """PLUS begins the names of frames with a capital."""
    if not name.isalnum() or _SEPARATOR.search(name):
        raise InputError(f"'{name}' is no name of a frame for PLUS: letters and digits, without 'To' before a capital")
    return name[0].upper() + name[1:]


def _date(result: CalibrationResult) -> str:
    """MMDDYY_HHMMSS; the text itself where it is no date."""
    try:
        return f"{datetime.fromisoformat(result.provenance.date):%m%d%y_%H%M%S}"
    except ValueError:
        return result.provenance.date
