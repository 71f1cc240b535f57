"""ITK transform files of Slicer: one file a pose, or several transforms in one file.

A transform maps from the parent to the child, in LPS: with M its matrix and D = diag(-1, -1, 1, 1), the pose of the
child in Slicer's RAS frame of the parent is ``T_parent_child = D inv(M) D``. The rotation is about ``FixedParameters``.
"""

import hashlib
import re
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats._table import Lines, read_bytes, read_lines
from carm_kin.recording.raw import Raw, Track
from carm_kin.recording.recording import Source
from solvers.se3 import Array

SUMMARY = "ITK or Slicer transform (.tfm), mostly a folder of one file a pose"
EXTENSIONS = (".tfm",)

MAX_BYTES = 10**8
TOOL = "transform"
SINGULAR = 1e-9
"""A matrix of a smaller determinant is no rotation."""

_FIRST = b"#Insight Transform File"
_KINDS = {"Affine": 12, "MatrixOffsetBase": 12, "Rigid3D": 12, "VersorRigid3D": 6, "Euler3D": 6, "Translation": 3}
"""Kind -> number of parameters."""
_FIXED = (0, 3, 4)
"""Numbers of fixed parameters: none, the centre, or the centre and the order of Euler angles."""
_KIND = re.compile(r"(\w+?)Transform(?:Base)?_(?:double|float)_3_3")
_LPS = np.array([-1.0, -1.0, 1.0])


@dataclass
class _Group:
    """Transforms of one kind: which of the file they are, and their numbers one after the other."""

    index: list[int] = field(default_factory=list)
    parameters: list[float] = field(default_factory=list)
    fixed: list[float] = field(default_factory=list)

    def add(self, index: int, parameters: list[float], fixed: list[float]) -> None:
        """One more."""
        self.index.append(index)
        self.parameters.extend(parameters)
        self.fixed.extend(fixed)


def matches(path: Path, head: bytes) -> bool:
    """The comment that ITK writes into the first line."""
    return head.removeprefix(b"\xef\xbb\xbf").startswith(_FIRST)


def read(path: Path, declared: Declarations) -> Raw:
    """A pose for every transform of the file. Raises InputError for a transform that is not rigid in 3D."""
    data = read_bytes(path, MAX_BYTES)
    lines = read_lines(path, data, "a line 'Transform: ...'")
    groups: dict[tuple[str, int], _Group] = defaultdict(_Group)
    kinds: dict[str, str] = {}
    kind, parameters, count = None, None, 0
    for row, line in enumerate(lines.text):
        key, _, value = line.partition(":")
        key = key.strip()
        if key == "Transform":
            if parameters is not None:
                raise lines.error("FixedParameters are missing before the next transform", row)
            if value not in kinds:
                kinds[value] = _kind(lines, row, value.strip())
            kind = kinds[value]
        elif key == "Parameters" and kind:
            parameters = _numbers(lines, row, value)
            if len(parameters) != _KINDS[kind]:
                raise lines.error(f"{len(parameters)} parameters; {kind} has {_KINDS[kind]}", row)
        elif key == "FixedParameters" and kind and parameters is not None:
            fixed = _numbers(lines, row, value)
            if len(fixed) not in _FIXED:
                if row == len(lines) - 1:
                    break
                raise lines.error(f"{len(fixed)} fixed parameters; the centre has 3 coordinates", row)
            groups[kind, len(fixed)].add(count, parameters, fixed)
            kind, parameters, count = None, None, count + 1
        else:
            raise lines.error("expected are Transform, Parameters and FixedParameters, in this order", row)
    R, p = np.full((count, 3, 3), np.nan), np.full((count, 3), np.nan)
    for (kind_of_some, width), some in groups.items():
        values = np.array(some.parameters).reshape(-1, _KINDS[kind_of_some])
        R[some.index], p[some.index] = _poses(kind_of_some, values, np.array(some.fixed).reshape(len(values), width))
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


def _numbers(lines: Lines, row: int, text: str) -> list[float]:
    try:
        return list(map(float, text.split()))
    except ValueError:
        raise lines.error(f"'{text.strip()[:40]}' are not all numbers", row) from None


def _poses(kind: str, parameters: Array, fixed: Array) -> tuple[Array, Array]:
    """Rotations (M, 3, 3) and positions (M, 3) of the child in the parent, RAS; NaN where the matrix is singular."""
    A = _matrices(kind, parameters, fixed)
    A[~np.isfinite(A).all(axis=(1, 2))] = 0
    A[np.abs(np.linalg.det(A)) < SINGULAR] = np.nan
    center = fixed[:, :3] if fixed.shape[1] >= 3 else np.zeros(3)
    offset = parameters[:, -3:] + center - np.einsum("nij,nj->ni", A, np.broadcast_to(center, (len(A), 3)))
    R = np.asarray(np.linalg.inv(A), dtype=float)
    return R * np.outer(_LPS, _LPS), -_LPS * np.einsum("nij,nj->ni", R, offset)


def _matrices(kind: str, parameters: Array, fixed: Array) -> Array:
    """(M, 3, 3)."""
    from scipy.spatial.transform import Rotation

    if kind == "VersorRigid3D":
        xyz = parameters[:, :3]
        w = np.sqrt(np.maximum(0.0, 1 - (xyz**2).sum(axis=1)))
        return Rotation.from_quat(np.column_stack([xyz, w])).as_matrix()
    if kind == "Euler3D":
        zyx, zxy = (Rotation.from_euler(o, parameters[:, ["XYZ".index(a) for a in o]]) for o in ("ZYX", "ZXY"))
        flag = fixed[:, 3] != 0 if fixed.shape[1] > 3 else np.zeros(len(fixed), dtype=bool)
        return np.where(flag[:, None, None], zyx.as_matrix(), zxy.as_matrix())
    if kind == "Translation":
        return np.tile(np.eye(3), (len(parameters), 1, 1))
    return parameters[:, :9].reshape(-1, 3, 3).copy()
