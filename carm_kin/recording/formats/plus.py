"""PLUS and Slicer sequences: the fields ``Seq_Frame0000_ProbeToTrackerTransform`` in the header of a MetaImage or NRRD.

Matrices are row by row and in mm. The status is ``..TransformStatus``; in older files it is missing, or ``Status`` for
all tools. The image, if there is one, is not looked at.
"""

import hashlib
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from carm_kin.files import write_atomically
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.raw import Raw, Track
from carm_kin.recording.recording import Recording, Source
from solvers.se3 import Array, transform

SUMMARY = "PLUS or Slicer sequence: .mha, .mhd, .nrrd, .igs.mha, .seq.nrrd"
EXTENSIONS = (".mha", ".mhd", ".nrrd")
HOLDS = ("time_s",)

MAX_BYTES = 2 * 10**9
"""A longer header is refused."""
MATRIX = 16
"""Numbers of a transform."""
TOOL = "Sensor"
"""What the tool is called in files written here."""

_CHUNK = 1 << 24
_ENDS = 1 << 16
"""Bytes at the beginning and at the end of the header where the sizes stand."""
_FIELD = re.compile(rb"^Seq_Frame(\d{1,9})_(\w+)[ \t]*:?=[ \t]*([^\r\n]*)", re.MULTILINE)
_OTHER = re.compile(rb"^(DimSize|Kinds|sizes|kinds)[ \t]*[:=]+[ \t]*([^\r\n]*)", re.MULTILINE)
_META_IMAGE = re.compile(rb"^(\xef\xbb\xbf)?(ObjectType|NDims)[ \t]*=", re.MULTILINE)
_END = {True: re.compile(rb"\r?\n\r?\n"), False: re.compile(rb"^ElementDataFile[^\n]*", re.MULTILINE)}
"""Of the header of an NRRD file, and of a MetaImage."""
_NAME = re.compile(r"(?P<tool>.+)To(?P<parent>[A-Z].*)")


@dataclass(frozen=True)
class _Field:
    """The values of a field in every frame that has it."""

    name: str
    frames: list[int]
    values: list[bytes]


def matches(path: Path, head: bytes) -> bool:
    """The first line of an NRRD file or the first fields of a MetaImage."""
    return _is_nrrd(head) or _META_IMAGE.search(head[:2000]) is not None


def read(path: Path, declared: Declarations) -> Raw:
    """The transforms of every frame. Raises InputError with the line where a matrix is none."""
    header, whole = _header(path)
    fields = _fields(header)
    frames = np.unique([frame for field in fields.values() for frame in field.frames])
    names = [name for name, field in fields.items() if _is_transform(field)]
    if not names:
        raise InputError("holds no tracked transform (Seq_Frame0000_...Transform); it is an image alone", file=path)
    tracks = {}
    for name, (tool, parent) in _tools(names).items():
        status = fields.get(f"{name}Status") or fields.get("Status")
        field = fields[name] if whole else _without_cut_off(fields[name], header)
        tracks[tool] = _track(path, header, frames, field, status, parent)
    announced = _announced(header)
    return Raw(
        tracks,
        Source(str(path), hashlib.sha256(header).hexdigest()),
        "mm",
        time_s=_spread(path, header, frames, fields["Timestamp"], 1)[:, 0] if "Timestamp" in fields else None,
        cut_off=max(0, announced - len(frames)),
    )


def write(recording: Recording, path: Path) -> None:
    """Write poses and times; missing frames are INVALID with the identity. Raises InputError without orientations."""
    if recording.R_world_sensor is None:
        raise InputError("a PLUS sequence needs orientations", file=path)
    frames = len(recording) + recording.missing
    number = recording.pose_number if recording.missing else np.arange(frames)
    T = np.tile(np.eye(4), (frames, 1, 1))
    T[number] = transform(recording.R_world_sensor, recording.p_world_sensor * 1e3)
    seen = np.isin(np.arange(frames), number)
    time = np.full(frames, np.nan)
    if recording.time_s is not None:
        time[number] = recording.time_s
    lines = list(_lines(T.reshape(-1, 16), seen, time))
    nrrd = path.name.lower().endswith(".nrrd")
    write_atomically(path, _nrrd(frames, lines) if nrrd else _meta_image(frames, lines))


def _is_nrrd(head: bytes) -> bool:
    return head.removeprefix(b"\xef\xbb\xbf").startswith(b"NRRD")


def _header(path: Path) -> tuple[bytes, bool]:
    """The bytes before the image, and whether they are all there."""
    try:
        with path.open("rb") as file:
            data = bytearray(file.read(_CHUNK))
            end = _END[_is_nrrd(bytes(data[:10]))]
            start = 0
            while (found := end.search(data, start)) is None and (more := file.read(_CHUNK)):
                start = max(0, len(data) - 100)
                data += more
                if len(data) > MAX_BYTES:
                    raise InputError(f"the header is longer than {MAX_BYTES / 1e9:.0f} GB", file=path)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    return bytes(data[: found.end()] if found else data), found is not None


def _fields(header: bytes) -> dict[str, _Field]:
    """The fields of frames by their names."""
    found: dict[bytes, tuple[list[int], list[bytes]]] = defaultdict(lambda: ([], []))
    for frame, name, value in _FIELD.findall(header):
        frames, values = found[name]
        frames.append(int(frame))
        values.append(value)
    return {name.decode(): _Field(name.decode(), frames, values) for name, (frames, values) in found.items()}


def _is_transform(field: _Field) -> bool:
    return field.name.endswith("Transform") or (
        not field.name.endswith("Status") and len(field.values[0].split()) == MATRIX
    )


def _without_cut_off(field: _Field, header: bytes) -> _Field:
    """Without a last matrix at whose middle the file ends."""
    if len(field.values[-1].split()) >= MATRIX or not header.rstrip().endswith(field.values[-1].rstrip()):
        return field
    return replace(field, frames=field.frames[:-1], values=field.values[:-1])


def _tools(names: list[str]) -> Mapping[str, tuple[str, str]]:
    """Field name -> tool and parent: ``StylusToTrackerTransform`` is the Stylus in the Tracker.

    Where a tool has several parents it goes by the field's name.
    """
    parts = {}
    for name in names:
        short = name.removesuffix("Transform")
        match = _NAME.fullmatch(short)
        parts[name] = (match["tool"], match["parent"], short) if match else (short, "", short)
    tools = [tool for tool, _, _ in parts.values()]
    return {n: (tool if tools.count(tool) == 1 else short, parent) for n, (tool, parent, short) in parts.items()}


def _track(path: Path, header: bytes, frames: np.ndarray, field: _Field, status: _Field | None, parent: str) -> Track:
    words = np.full(len(frames), "", object)
    if status:
        said = {value: value.strip().decode("ascii", "replace").upper() for value in set(status.values)}
        words[np.searchsorted(frames, status.frames)] = [said[value] for value in status.values]
    T = _spread(path, header, frames, field, MATRIX).reshape(-1, 4, 4)
    without = np.ones(len(frames), dtype=bool)
    without[np.searchsorted(frames, field.frames)] = False
    words[without & np.isin(words, ("", "OK"))] = "without a transform"
    return Track(T[:, :3, 3], T[:, :3, :3], words, parent)


def _spread(path: Path, header: bytes, frames: np.ndarray, field: _Field, count: int) -> Array:
    """(N, count) numbers of a field, NaN where a frame has none. Raises InputError with the line of others."""
    spread = np.full((len(frames), count), np.nan)
    words = b" ".join(field.values).split()
    if len(words) == count * len(field.values):
        try:
            numbers = np.fromiter(map(float, words), float, len(words))
        except ValueError:
            pass
        else:
            spread[np.searchsorted(frames, field.frames)] = numbers.reshape(-1, count)
            return spread
    for frame, value in zip(field.frames, field.values, strict=True):
        spread[np.searchsorted(frames, frame)] = _numbers(path, header, field.name, frame, value, count)
    return spread


def _numbers(path: Path, header: bytes, name: str, frame: int, value: bytes, count: int) -> list[float]:
    try:
        numbers = [float(word) for word in value.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        at = re.search(rb"^Seq_Frame0*%d_%s\b" % (frame, name.encode()), header, re.MULTILINE)
        line = header.count(b"\n", 0, at.start()) + 1 if at else None
        shown = value[:40].decode("ascii", "replace")
        raise InputError(f"'{shown}' is not {count} numbers", file=path, line=line)
    return numbers


def _announced(header: bytes) -> int:
    """How many frames the header says that there are; 0 where it does not."""
    other = {match[1].lower(): match[2].split() for match in _OTHER.finditer(header[:_ENDS] + b"\n" + header[-_ENDS:])}
    sizes = other.get(b"dimsize") or other.get(b"sizes") or []
    kinds = other.get(b"kinds") or []
    listed = kinds.index(b"list") if b"list" in kinds else len(sizes)
    return int(sizes[listed]) if listed < len(sizes) and sizes[listed].isdigit() else 0


def _lines(matrices: Array, seen: np.ndarray, time: Array) -> Iterator[tuple[str, str]]:
    """Field and value, frame by frame."""
    field = f"{TOOL}ToTrackerTransform"
    for frame, (row, here, t) in enumerate(zip(matrices.tolist(), seen.tolist(), time.tolist(), strict=True)):
        yield f"Seq_Frame{frame:04d}_{field}", " ".join(map(repr, row))
        yield f"Seq_Frame{frame:04d}_{field}Status", "OK" if here else "INVALID"
        if t == t:
            yield f"Seq_Frame{frame:04d}_Timestamp", repr(t)


def _meta_image(frames: int, lines: list[tuple[str, str]]) -> str:
    head = ["ObjectType = Image", "NDims = 3", f"DimSize = 0 0 {frames}", "Kinds = domain domain list"]
    body = [f"{key} = {value}" for key, value in lines]
    return "\n".join([*head, "ElementType = MET_OTHER", *body, "ElementDataFile = LOCAL", ""])


def _nrrd(frames: int, lines: list[tuple[str, str]]) -> str:
    head = ["NRRD0005", "type: unsigned char", "dimension: 3", f"sizes: 1 1 {frames}", "kinds: domain domain list"]
    body = [f"{key}:={value}" for key, value in lines]
    return "\n".join([*head, "encoding: raw", *body, "", ""]) + "\0" * frames
