"""Poses in OpenIGTLink messages: TRANSFORM, TDATA, QTDATA and POSITION, in millimetres by the protocol."""

import struct
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from carm_kin.recording.checks import ROTATION_TOLERANCE
from carm_kin.streams.openigtlink import Message, text
from solvers.se3 import Array, project_so3, quat_wxyz_from_rotation, rotation_from_quat_wxyz, transform

TYPES = ("TRANSFORM", "TDATA", "QTDATA", "POSITION", "QTRANS")
"""The types of messages that hold poses; QTRANS is another name of POSITION."""
SIX_DEGREES = 2
"""The kind of a tool with a full pose, in TDATA and QTDATA."""

NOT_FINITE, NO_ROTATION, NO_ORIENTATION = "not finite", "not a rotation", "no orientation"
PLACEHOLDER, INVALID, FAR = "identity placeholder", "invalid", "out of range"
MAX_STATUS = 30
"""Letters of a status that are kept."""
REACH_M = 100.0
"""A pose farther off is none of a tracker."""

_TDATA = np.dtype([("name", "S20"), ("kind", "u1"), ("reserved", "u1"), ("matrix", ">f4", (4, 3))])
_QTDATA = np.dtype(
    [("name", "S20"), ("kind", "u1"), ("reserved", "u1"), ("position", ">f4", 3), ("quat_xyzw", ">f4", 4)]
)


@dataclass(frozen=True, eq=False)
class Observation:
    """One tool as one message has it."""

    tool: str
    stamp_s: float | None
    number: int
    T: Array | None
    """(4, 4) the tool in the frame of the server, m; None where it is not to be used."""
    fault: str = ""
    """Why not."""


def observations(message: Message) -> list[Observation]:
    """The tools in a message of one of `TYPES`. Raises ValueError where its size is none of its type."""
    content = message.content
    if message.type == "TDATA":
        rows = np.frombuffer(content, _TDATA)
        return [_observed(message, text(row["name"]), *_of_matrix(row["matrix"])) for row in rows]
    if message.type == "QTDATA":
        rows = np.frombuffer(content, _QTDATA)
        return [_observed(message, text(r["name"]), *_of_quaternion(r["position"], r["quat_xyzw"])) for r in rows]
    numbers = np.frombuffer(content, ">f4")
    if message.type == "TRANSFORM" and len(numbers) == 12:
        return [_observed(message, message.device, *_of_matrix(numbers.reshape(4, 3)))]
    if message.type in ("POSITION", "QTRANS") and len(numbers) in (3, 6, 7):
        return [_observed(message, message.device, *_of_quaternion(numbers[:3], numbers[3:]))]
    raise ValueError(f"{message.type} of {len(content)} bytes")


def _of_matrix(columns: Array) -> tuple[Array, Array]:
    """p in mm and R from the (4, 3) columns of the matrix."""
    return columns[3].astype(float), columns[:3].T.astype(float)


def _of_quaternion(position: Array, quat_xyzw: Array) -> tuple[Array, Array | None]:
    """The same from a quaternion, whose w may be left out where it is not negative."""
    q = quat_xyzw.astype(float)
    if not len(q):
        return position.astype(float), None
    w = q[3] if len(q) == 4 else np.sqrt(max(1 - q @ q, 0.0))
    wxyz = np.array([w, *q[:3]])
    length = np.linalg.norm(wxyz)
    unit = abs(length - 1) <= ROTATION_TOLERANCE
    return position.astype(float), rotation_from_quat_wxyz(wxyz) if unit else np.full((3, 3), float(length))


def _observed(message: Message, tool: str, position: Array, R: Array | None) -> Observation:
    fault = _fault(message, position, R)
    T = None if fault or R is None else transform(project_so3(R), position / 1000)
    return Observation(tool, message.stamp_s, message.number, T, fault)


def _fault(message: Message, position: Array, R: Array | None) -> str:
    """Why the pose is not to be used; "" where it is."""
    status = message.metadata.get("TransformStatus", "OK").upper()
    if status not in ("OK", ""):
        return status[:MAX_STATUS]
    if message.metadata.get("TransformValid", "true").lower() in ("false", "0"):
        return INVALID
    if R is None:
        return NO_ORIENTATION
    if not (np.isfinite(position).all() and np.isfinite(R).all()):
        return NOT_FINITE
    if np.abs(R).max() > 2 or np.abs(R @ R.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(R) < 0:
        return NO_ROTATION
    if np.abs(position).max() > REACH_M * 1000:
        return FAR
    return "" if position.any() or (np.eye(3) != R).any() else PLACEHOLDER


def transform_message(tool: str, T: Array | None, stamp_s: float, number: int = 0) -> Message:
    """TRANSFORM of a pose (4, 4), m; of None: the identity, marked as invalid."""
    return Message("TRANSFORM", tool, _columns(T), stamp_s, number, _validity(T is not None))


def tdata_message(device: str, tools: Iterable[tuple[str, Array]], stamp_s: float, number: int = 0) -> Message:
    """TDATA of the tools that are seen; those that are not are left out, as the protocol has it."""
    content = b"".join(_element(name) + _columns(T) for name, T in tools)
    return Message("TDATA", device, content, stamp_s, number)


def qtdata_message(device: str, tools: Iterable[tuple[str, Array]], stamp_s: float, number: int = 0) -> Message:
    """The same as QTDATA."""
    content = b""
    for name, T in tools:
        w, x, y, z = quat_wxyz_from_rotation(T[:3, :3])
        content += _element(name) + np.array([*T[:3, 3] * 1000, x, y, z, w], ">f4").tobytes()
    return Message("QTDATA", device, content, stamp_s, number)


def start_tdata(step_ms: int) -> Message:
    """Asks a server to send TDATA with at least so much time between; 0 is as fast as it can."""
    return Message("STT_TDATA", "carm-kin", struct.pack(">I32s", step_ms, b""))


def _element(name: str) -> bytes:
    return name.encode()[:20].ljust(20, b"\0") + bytes([SIX_DEGREES, 0])


def _columns(T: Array | None) -> bytes:
    T = np.eye(4) if T is None else T
    return np.concatenate([T[:3, :3].T, T[None, :3, 3] * 1000]).astype(">f4").tobytes()


def _validity(valid: bool) -> dict[str, str]:
    return {"TransformValid": str(valid), "TransformStatus": "OK" if valid else "MISSING"}
