"""ITK transform files of Slicer: one file a pose, or several transforms in one file.

A transform maps from the parent to the child, in LPS: with M its matrix and D = diag(-1, -1, 1, 1), the pose of the
child in Slicer's RAS frame of the parent is ``T_parent_child = D inv(M) D``. The rotation is about ``FixedParameters``.
"""

import hashlib
import re
from pathlib import Path

import numpy as np

from carm_kin.declarations import Declarations
from carm_kin.formats._table import Lines, read_bytes, read_lines
from carm_kin.raw import Raw, Track
from carm_kin.recording import Source
from solvers.se3 import Array

SUMMARY = "ITK or Slicer transform (.tfm), mostly a folder of one file a pose"
EXTENSIONS = (".tfm",)

MAX_BYTES = 10**8
TOOL = "transform"

_FIRST = b"#Insight Transform File"
_KINDS = {"Affine": 12, "MatrixOffsetBase": 12, "Rigid3D": 12, "VersorRigid3D": 6, "Euler3D": 6, "Translation": 3}
"""Kind -> number of parameters."""
_KIND = re.compile(r"(\w+?)Transform(?:Base)?_(?:double|float)_3_3")
_LPS = np.array([-1.0, -1.0, 1.0])


def matches(path: Path, head: bytes) -> bool:
    """The comment that ITK writes into the first line."""
    return head.removeprefix(b"\xef\xbb\xbf").startswith(_FIRST)


def read(path: Path, declared: Declarations) -> Raw:
    """A pose for every transform of the file. Raises InputError for a transform that is not rigid in 3D."""
    data = read_bytes(path, MAX_BYTES)
    lines = read_lines(path, data, "a line 'Transform: ...'")
    poses, kind, parameters = [], None, None
    for row, line in enumerate(lines.text):
        key, _, value = line.partition(":")
        if key.strip() == "Transform":
            if parameters is not None:
                raise lines.error("FixedParameters are missing before the next transform", row)
            kind = _kind(lines, row, value.strip())
        elif key.strip() == "Parameters":
            parameters = _numbers(lines, row, value, None if kind is None else _KINDS[kind])
        elif key.strip() == "FixedParameters" and kind and parameters is not None:
            poses.append(_pose(kind, parameters, _numbers(lines, row, value, None)))
            kind, parameters = None, None
        else:
            raise lines.error("expected are Transform, Parameters and FixedParameters, in this order", row)
    R, p = (np.array([pose[k] for pose in poses]).reshape(-1, *shape) for k, shape in ((0, (3, 3)), (1, (3,))))
    source = Source(str(path), hashlib.sha256(data).hexdigest())
    return Raw({TOOL: Track(p, R)}, source, "mm", cut_off=int(kind is not None or parameters is not None))


def _kind(lines: Lines, row: int, name: str) -> str:
    match = _KIND.fullmatch(name)
    kind = match[1] if match else ""
    if kind == "MatrixOffset":
        kind = "MatrixOffsetBase"
    if kind not in _KINDS:
        valid = ", ".join(_KINDS)
        raise lines.error(f"'{name}' is no rigid transform in 3D that is read here; known are {valid}", row)
    return kind


def _numbers(lines: Lines, row: int, text: str, count: int | None) -> Array:
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        raise lines.error(f"'{text.strip()[:40]}' are not all numbers", row) from None
    if count is not None and len(numbers) != count:
        raise lines.error(f"{len(numbers)} parameters; this kind of transform has {count}", row)
    return numbers


def _pose(kind: str, parameters: Array, fixed: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,) of the child in the parent, RAS; NaN where the matrix is singular."""
    from scipy.spatial.transform import Rotation

    if kind == "VersorRigid3D":
        x, y, z = parameters[:3]
        A = Rotation.from_quat([x, y, z, np.sqrt(max(0.0, 1 - x * x - y * y - z * z))]).as_matrix()
    elif kind == "Euler3D":
        order = "ZYX" if len(fixed) > 3 and fixed[3] else "ZXY"
        A = Rotation.from_euler(order, [parameters["XYZ".index(axis)] for axis in order]).as_matrix()
    else:
        A = np.eye(3) if kind == "Translation" else parameters[:9].reshape(3, 3)
    center = fixed[:3] if len(fixed) >= 3 else np.zeros(3)
    offset = parameters[-3:] + center - A @ center
    if abs(np.linalg.det(A)) < 1e-9:
        return np.full((3, 3), np.nan), np.full(3, np.nan)
    R = np.asarray(np.linalg.inv(A), dtype=float)
    return R * np.outer(_LPS, _LPS), _LPS * (R @ -offset)
