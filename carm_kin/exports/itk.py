"""An ITK transform file, as 3D Slicer loads it.

Such a file holds, in LPS coordinates and millimetres, the transform *from the parent*: with D = diag(-1, -1, 1, 1),
the matrix in it is D inv(T_parent_child) D. Slicer turns it back and shows T_parent_child, in RAS, as "to parent".
"""

from pathlib import Path

import numpy as np

from carm_kin.exports._wanted import Wanted, facts, subject_of
from carm_kin.files import write_atomically
from carm_kin.results.result import CalibrationResult
from solvers.se3 import Array, inverse

ENDING = ".tfm"
SUMMARY = "ITK and 3D Slicer transform (mm, LPS, from parent)."
TAKES = ("transform", "placement", "parent_frame", "child_frame")

_LPS_OF_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


def write(result: CalibrationResult, out: Path, wanted: Wanted) -> None:
    """Write the file."""
    subject = subject_of(result, wanted)
    convention = (
        f"LPS, from parent: the matrix below is D inv(T) D with D = diag(-1,-1,1,1) and p_{subject.parent} = "
        f"T p_{subject.child}; 3D Slicer shows T, in RAS, as the transform to parent"
    )
    words = facts(result, subject, convention, "mm")
    M = _LPS_OF_RAS @ inverse(subject.T_parent_child) @ _LPS_OF_RAS
    lines = [
        "#Insight Transform File V1.0",
        *(f"# {word}" for word in words),
        "Transform: AffineTransform_double_3_3",
        f"Parameters: {_words(M[:3, :3].ravel())} {_words(M[:3, 3] * 1e3)}",
        "FixedParameters: 0 0 0",
    ]
    write_atomically(out, "\n".join(lines) + "\n")


def _words(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values + 0.0)
