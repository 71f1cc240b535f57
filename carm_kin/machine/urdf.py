"""URDF files: find, read, patch, write, and hand the bare chain to other libraries.

Every file takes the strict pass of `carm_kin.machine.urdf_check` before anything else sees it. Lengths are m,
angles rad. A patch changes the numbers of one ``<origin>`` and leaves every other byte as it was.
"""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import lxml.etree as etree
import numpy as np
from numpy.typing import ArrayLike

from carm_kin.errors import InputError, wrong_type
from carm_kin.machine.urdf_check import JOINT_TYPES, Joint, UrdfFile, check_urdf, listing
from carm_kin.steps import step
from solvers.se3 import Array

__all__ = [
    "JOINT_TYPES",
    "Joint",
    "UrdfFile",
    "add_comment",
    "add_fixed_link",
    "as_urdf",
    "bundled_urdfs",
    "find_urdf",
    "kinematic_text",
    "listing",
    "parse_urdf",
    "patch_origins",
    "read_urdf",
    "write_urdf",
]

MAX_BYTES = 20_000_000

_TAG = re.compile(rb"""(?P<tag><(?:[^>"']|"[^"]*"|'[^']*')*>)\s*""")
_ATTRIBUTE = re.compile(rb"""(\s+)([^\s=]+)(\s*=\s*)("[^"]*"|'[^']*')""")
_PROLOG = re.compile(rb"\s+|<\?.*?\?>|<!--.*?-->", re.DOTALL)


def bundled_urdfs() -> dict[str, Path]:
    """The C-arm family that comes with the package: name -> path."""
    installed = Path(__file__).parents[1] / "urdf_files"
    folder = installed if installed.is_dir() else Path(__file__).parents[2] / "urdf"
    return {path.stem: path for path in sorted(folder.glob("*.urdf"))}


def find_urdf(name_or_path: str | os.PathLike) -> Path:
    """The path of a bundled machine by its name, or the path itself where a file is, else `InputError`."""
    path, bundled = Path(name_or_path), bundled_urdfs()
    if str(name_or_path) in bundled and not path.is_file():
        return bundled[str(name_or_path)]
    if not path.exists():
        raise InputError(f"no such file; bundled machines: {listing(bundled)}", file=path)
    return path


def as_urdf(urdf: UrdfFile | str | os.PathLike) -> UrdfFile:
    """A checked URDF as it is; a path or a bundled name read. Raises InputError for anything else."""
    return urdf if isinstance(urdf, UrdfFile) else read_urdf(urdf)


def read_urdf(name_or_path: str | os.PathLike) -> UrdfFile:
    """Read and check a URDF, given by its path or bundled name. Raises `InputError` with the line."""
    if not isinstance(name_or_path, (str, os.PathLike)):
        raise wrong_type(name_or_path, "a URDF (its path, or the name of a bundled machine)")
    path = find_urdf(name_or_path)
    if path.is_dir():
        raise InputError("is a folder; give a URDF file", file=path)
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from error
    if len(data) > MAX_BYTES:
        raise InputError(f"is larger than {MAX_BYTES // 1_000_000} MB, which is no URDF of a machine", file=path)
    with step(f"read {path}"):
        return parse_urdf(data, path)


def parse_urdf(data: bytes, path: Path) -> UrdfFile:
    """Check the bytes of a URDF; ``path`` is for messages. Raises `InputError` with the line."""
    return check_urdf(_parse(data, path), data, path)


def write_urdf(urdf: UrdfFile, path: str | Path) -> None:
    """Write the file's bytes. Raises `InputError` where that is not possible."""
    try:
        Path(path).write_bytes(urdf.data)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=path) from error


def kinematic_text(urdf: UrdfFile, link: str) -> str:
    """A bare URDF of the chain from base to ``link``: joints with unit axes, no shapes, no masses.

    Made from the checked numbers alone, so nothing else of the file reaches the library that reads it.
    Raises `InputError` as `UrdfFile.joints_to` does.
    """
    robot = etree.Element("robot", name="chain")
    etree.SubElement(robot, "link", name=urdf.base)
    for joint in urdf.joints_to(link):
        etree.SubElement(robot, "link", name=joint.child)
        element = etree.SubElement(robot, "joint", name=joint.name, type=joint.type)
        etree.SubElement(element, "parent", link=joint.parent)
        etree.SubElement(element, "child", link=joint.child)
        etree.SubElement(element, "origin", xyz=_words(joint.xyz), rpy=_words(joint.rpy))
        etree.SubElement(element, "axis", xyz=_words(joint.axis))
        limits = {"lower": f"{joint.lower:.17g}", "upper": f"{joint.upper:.17g}"} if np.isfinite(joint.lower) else {}
        etree.SubElement(element, "limit", limits, effort="0", velocity="0")
    return etree.tostring(robot, encoding="unicode")


def patch_origins(urdf: UrdfFile, origins: Mapping[str, ArrayLike]) -> UrdfFile:
    """The same file with other numbers in the ``<origin>`` of some joints, every other byte as it was.

    ``origins`` maps a joint's name to T_parent_joint (4, 4), m. A joint without an ``<origin>`` gets one.
    Raises `InputError` for an unknown joint or a matrix that is no rigid motion.
    """
    known = [joint.name for joint in urdf.joints]
    for name in origins:
        if name not in known:
            raise InputError(f"no joint is named {name!r}; valid: {listing(known)}", file=urdf.path)
    tags = _tag_offsets(urdf)
    data = urdf.data
    for name in sorted(origins, key=lambda name: tags[name][0], reverse=True):
        attributes = _origin_attributes(urdf.path, name, np.asarray(origins[name], dtype=float))
        data = _patched(data, *tags[name], attributes)
    return parse_urdf(data, urdf.path)


def add_fixed_link(urdf: UrdfFile, parent: str, name: str, T_parent_link: ArrayLike) -> UrdfFile:
    """The same file with one more link at its end, fixed to ``parent`` by the joint ``NAME_mount``.

    ``T_parent_link`` is (4, 4), m. Every other byte stays. Raises InputError for an unknown parent, a name that is
    taken, or a matrix that is no rigid motion.
    """
    if parent not in urdf.links:
        raise InputError(f"no link is named {parent!r}; valid: {listing(urdf.links)}", file=urdf.path)
    numbers = _origin_attributes(urdf.path, f"{name}_mount", np.asarray(T_parent_link, dtype=float))
    end = urdf.data.rindex(b"</")
    newline = b"\r\n" if b"\r\n" in urdf.data[:end] else b"\n"
    start = urdf.data.rindex(b"\n", 0, end) + 1 if b"\n" in urdf.data[:end] else end
    before = urdf.data[:end] if urdf.data[start:end].strip() else urdf.data[:start]
    indented = re.findall(rb"\n([ \t]*)<(?:link|joint)\b", urdf.data)
    indent = indented[-1] if indented else b"  "
    step = indent or b"  "
    origin = b" ".join(key + b'="' + value + b'"' for key, value in numbers.items())
    lines = [
        indent + f"<link name={quoteattr(name)}/>".encode(),
        indent + f'<joint name={quoteattr(name + "_mount")} type="fixed">'.encode(),
        indent + step + f"<parent link={quoteattr(parent)}/>".encode(),
        indent + step + f"<child link={quoteattr(name)}/>".encode(),
        indent + step + b"<origin " + origin + b"/>",
        indent + b"</joint>",
    ]
    return parse_urdf(before + newline.join(lines) + newline + urdf.data[len(before) :].lstrip(b" \t"), urdf.path)


def add_comment(urdf: UrdfFile, lines: Sequence[str]) -> UrdfFile:
    """The same file with one more comment in front of its root; two hyphens in a row must not be in it."""
    start = _end_of_prolog(urdf.data)
    newline = b"\r\n" if b"\r\n" in urdf.data else b"\n"
    text = [line.encode("ascii", "backslashreplace") for line in lines]
    comment = newline.join([b"<!--", *(b"  " + line for line in text), b"-->", b""])
    return parse_urdf(urdf.data[:start] + comment + urdf.data[start:], urdf.path)


def _parse(data: bytes, path: Path) -> Any:
    if not data.strip():
        raise InputError("the file is empty", file=path, line=1)
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise InputError("holds NUL bytes: a binary file? A URDF is XML text in UTF-8", file=path, line=line)
    doctype = _end_of_prolog(data)
    if data.startswith(b"<!DOCTYPE", doctype):
        line = data.count(b"\n", 0, doctype) + 1
        raise InputError("has a DOCTYPE, which is not accepted; delete it", file=path, line=line)
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, recover=False)
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        reason = re.sub(r", line \d+, column \d+.*", "", " ".join(str(error.msg).split()))
        raise InputError(f"is not well-formed XML: {reason}", file=path, line=error.lineno) from error
    if root.getroottree().docinfo.doctype:
        raise InputError("has a DOCTYPE, which is not accepted; delete it", file=path, line=1)
    return root


def _end_of_prolog(data: bytes) -> int:
    """Where the first markup other than declarations, processing instructions and comments begins."""
    at = 3 if data.startswith(b"\xef\xbb\xbf") else 0
    while part := _PROLOG.match(data, at):
        at = part.end()
    return at


def _words(values: ArrayLike) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values) + 0.0)


def _origin_attributes(path: Path, name: str, T: Array) -> dict[bytes, bytes]:
    """xyz and rpy of T (4, 4), in the form that keeps its precision where the pitch is 90 degrees."""
    if T.shape != (4, 4) or not np.isfinite(T).all() or (T[3] != (0, 0, 0, 1)).any():
        raise InputError(f"the origin of joint {name!r} must be a finite 4x4 rigid motion", file=path)
    R = T[:3, :3]
    if np.abs(R.T @ R - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0:
        raise InputError(f"the origin of joint {name!r} holds no rotation matrix", file=path)
    yaw = np.arctan2(R[1, 0], R[0, 0])
    cosine, sine = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    roll = np.arctan2(sine * R[0, 2] - cosine * R[1, 2], cosine * R[1, 1] - sine * R[0, 1])
    return {b"xyz": _words(T[:3, 3]).encode(), b"rpy": _words([roll, pitch, yaw]).encode()}


def _tag_offsets(urdf: UrdfFile) -> dict[str, tuple[int, int | None]]:
    """Byte offsets of each joint's start tag and of its origin's, if it has one."""
    offsets: dict[str, tuple[int, int | None]] = {}
    stack: list[tuple[str, str]] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        stack.append((tag, attributes.get("name", "")))
        tags = [tag for tag, _ in stack]
        if tags == ["robot", "joint"]:
            offsets[stack[1][1]] = (parser.CurrentByteIndex, None)
        elif tags == ["robot", "joint", "origin"]:
            offsets[stack[1][1]] = (offsets[stack[1][1]][0], parser.CurrentByteIndex)

    def end(_: str) -> None:
        stack.pop()

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(urdf.data, True)
    except expat.ExpatError as error:
        raise InputError(f"cannot be patched: {error}; save it as UTF-8", file=urdf.path) from error
    return offsets


def _patched(data: bytes, joint: int, origin: int | None, attributes: dict[bytes, bytes]) -> bytes:
    """``data`` with these attributes in the tag at ``origin``, or in a new one behind the tag at ``joint``."""
    tag = next(_TAG.finditer(data, joint if origin is None else origin))
    if origin is None:
        return data[: tag.end()] + _with_attributes(b"<origin/>", attributes) + data[tag.end("tag") :]
    return data[:origin] + _with_attributes(tag["tag"], attributes) + data[tag.end("tag") :]


def _with_attributes(tag: bytes, attributes: dict[bytes, bytes]) -> bytes:
    """The start tag with these attribute values, in place where they are there, else added in front."""
    missing = dict(attributes)

    def put(match: re.Match[bytes]) -> bytes:
        space, key, equals, value = match.groups()
        if key not in missing:
            return match[0]
        return space + key + equals + value[:1] + missing.pop(key) + value[:1]

    tag = _ATTRIBUTE.sub(put, tag)
    added = b"".join(b' %s="%s"' % item for item in missing.items())
    return tag[: len(b"<origin")] + added + tag[len(b"<origin") :]
