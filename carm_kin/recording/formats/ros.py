"""ROS 1 and ROS 2 bags and MCAP files: trees of frames in ``tf``, poses and transforms on topics of their own.

Needs the extra ``ros``. Frames of the tree and topics are tools by their names; a frame is given in the reference that
is asked for, the tree composed, or in the root of its tree.
"""

import hashlib
import re
import struct
import sys
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from carm_kin.errors import InputError, MissingDependencyError
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats._tf import Edge, path_to_root, pose_in
from carm_kin.recording.ingest import QUATERNION_TOLERANCE, named
from carm_kin.recording.raw import Raw, Track
from carm_kin.recording.recording import Source
from solvers.se3 import rotation_from_quat_wxyz, transform

SUMMARY = "ROS 1 bag, ROS 2 bag (folder), MCAP: tf trees, PoseStamped, TransformStamped (extra 'ros')"
EXTENSIONS = (".bag", ".mcap", ".db3")

GAP = "gap in time"
"""Why a pose is dropped whose tree is not known at its time."""

_BROKEN = (
    *(OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, AssertionError),
    *(struct.error, EOFError, MemoryError, OverflowError, RuntimeError),
)
_MAGIC = (b"#ROSBAG V", b"\x89MCAP0", b"SQLite format 3\0")
_TYPES = re.compile(r"(tf2_msgs/msg/TFMessage|tf/msg/tfMessage|geometry_msgs/msg/(Transform|Pose)Stamped)")


@dataclass
class _Found:
    """Times, parents and poses of every frame of the tree and of every topic."""

    frames: dict[str, list[tuple]] = field(default_factory=lambda: defaultdict(list))
    static: set[str] = field(default_factory=set)
    topics: dict[str, list[tuple]] = field(default_factory=lambda: defaultdict(list))


def matches(path: Path, head: bytes) -> bool:
    """The first bytes of a bag, or a folder with the description of a ROS 2 bag."""
    return head.startswith(_MAGIC) or (path.is_dir() and (path / "metadata.yaml").is_file())


def read(path: Path, declared: Declarations) -> Raw:
    """The tool that is asked for, or the only one that moves. Raises InputError that lists what there is."""
    found = _found(path)
    try:
        return _raw(found, declared, Source(str(path), _digest(path)))
    except InputError as error:
        raise InputError(str(error), file=path) from None


def _raw(found: _Found, declared: Declarations, source: Source) -> Raw:
    edges = {frame: _edge(frame, rows, frame in found.static) for frame, rows in found.frames.items()}
    moving = [frame for frame, edge in edges.items() if not edge.static]
    names = {**dict.fromkeys(edges), **dict.fromkeys(found.topics)}
    if not names:
        raise InputError("the bag holds no tf, PoseStamped or TransformStamped")
    choice = [*moving, *found.topics]
    if declared.tool is None and len(choice) != 1:
        raise InputError(f"say with --tool which frame or topic is the sensor: {', '.join(choice or names)}")
    tool = choice[0] if declared.tool is None else named("tool", declared.tool, names)
    if tool in found.topics:
        return _of_topic(tool, found.topics[tool], source)
    reference = path_to_root(edges, tool)[-1]
    if declared.reference is not None:
        frames = dict.fromkeys([*edges, *(edge.parent for edge in edges.values())])
        reference = named("reference", declared.reference, frames)
    time_s, T, known = pose_in(edges, tool, reference)
    status = np.where(known, "", GAP).astype(object)
    track = Track(T[:, :3, 3], T[:, :3, :3], status, declared.reference or reference)
    return Raw({tool: track}, source, "m", time_s=time_s)


def _of_topic(topic: str, rows: list[tuple], source: Source) -> Raw:
    values = np.array([row[2:] for row in rows])
    parents = dict.fromkeys(row[1] for row in rows)
    if len(parents) > 1:
        raise InputError(f"the poses of '{topic}' are in several frames: {', '.join(parents)}")
    track = Track(values[:, :3], values[:, 3:], parent=rows[0][1])
    return Raw({topic: track}, source, "m", "xyzw", time_s=np.array([row[0] for row in rows]))


def _edge(frame: str, rows: list[tuple], static: bool) -> Edge:
    """Of several messages of the same time the first."""
    parents = dict.fromkeys(row[1] for row in rows)
    if len(parents) > 1:
        raise InputError(f"the frame '{frame}' has several parents: {', '.join(parents)}")
    stamps = np.sort([row[0] for row in rows])
    time, first = np.unique([row[0] for row in rows], return_index=True)
    values = np.array([rows[i][2:] for i in first])
    quat_wxyz = np.roll(values[:, 3:], 1, axis=1)
    unit = np.abs(np.linalg.norm(quat_wxyz, axis=1) - 1) <= QUATERNION_TOLERANCE
    T = transform(rotation_from_quat_wxyz(np.where(unit[:, None], quat_wxyz, np.nan)), values[:, :3])
    return Edge(rows[0][1], T, time, stamps, static)


def _found(path: Path) -> _Found:
    """All poses in the bag. Raises InputError where it is broken."""
    try:
        import apsw

        if sys.version_info >= (3, 14):
            from compression import zstd
        else:
            from backports import zstd
        from rosbags import rosbag1, rosbag2
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, TypesysError, get_typestore
    except ImportError:
        raise MissingDependencyError("reading ROS bags needs rosbags: pip install 'carm-kin[ros]'") from None
    found, readers = _Found(), (rosbag1.ReaderError, rosbag2.ReaderError)
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            wanted = [connection for connection in reader.connections if _TYPES.fullmatch(connection.msgtype)]
            for connection, _, data in reader.messages(wanted) if wanted else ():
                _add(found, connection.topic, reader.deserialize(data, connection.msgtype))
    except (AnyReaderError, *readers, TypesysError, apsw.Error, zstd.ZstdError, *_BROKEN) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is no sound ROS bag: {reason}", file=path) from None
    return found


def _add(found: _Found, topic: str, message: Any) -> None:
    if hasattr(message, "transforms"):
        for one in message.transforms:
            frame = one.child_frame_id.lstrip("/")
            found.frames[frame].append(_row(one.header, one.transform.translation, one.transform.rotation))
            if topic.endswith("tf_static"):
                found.static.add(frame)
    elif hasattr(message, "transform"):
        name = f"{topic} {message.child_frame_id}".strip()
        found.topics[name].append(_row(message.header, message.transform.translation, message.transform.rotation))
    else:
        found.topics[topic].append(_row(message.header, message.pose.position, message.pose.orientation))


def _row(header: Any, p: Any, q: Any) -> tuple:
    """Time, s, parent, position, quaternion xyzw."""
    stamp = header.stamp.sec + header.stamp.nanosec * 1e-9
    return stamp, header.frame_id.lstrip("/"), p.x, p.y, p.z, q.x, q.y, q.z, q.w


def _digest(path: Path) -> str:
    """Of the file, or of all files of the folder in the order of their names."""
    total = hashlib.sha256()
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as opened:
                while chunk := opened.read(1 << 20):
                    total.update(chunk)
    return total.hexdigest()
