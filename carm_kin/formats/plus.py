"""PLUS and Slicer sequences: the fields ``Seq_Frame0000_ProbeToTrackerTransform`` in the header of a MetaImage or NRRD.

Matrices are row by row and in mm. The status is ``..TransformStatus``; in older files it is missing, or ``Status`` for
all tools. The image, if there is one, is not looked at.
"""

import hashlib
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from carm_kin.declarations import Declarations
from carm_kin.errors import InputError
from carm_kin.raw import Raw, Track
from carm_kin.recording import Recording, Source
from carm_kin.result_json import write_atomically
from solvers.se3 import Array, transform

SUMMARY = "PLUS or Slicer sequence: .mha, .mhd, .nrrd, .igs.mha, .seq.nrrd"
EXTENSIONS = (".mha", ".mhd", ".nrrd")
HOLDS = ("time_s",)

MAX_BYTES = 2 * 10**9
"""A longer header is refused."""
TOOL = "Sensor"
"""What the tool is called in files written here."""

_CHUNK = 1 << 24
_FIELD = re.compile(rb"^Seq_Frame(\d{1,9})_(\w+)[ \t]*:?=[ \t]*([^\r\n]*)", re.MULTILINE)
_OTHER = re.compile(rb"^(DimSize|Kinds|sizes|kinds)[ \t]*[:=]+[ \t]*([^\r\n]*)", re.MULTILINE)
_META_IMAGE = re.compile(rb"^(\xef\xbb\xbf)?(ObjectType|NDims)[ \t]*=", re.MULTILINE)
_END = {True: re.compile(rb"\r?\n\r?\n"), False: re.compile(rb"^ElementDataFile[^\n]*", re.MULTILINE)}
"""Of the header of an NRRD file, and of a MetaImage."""
_NAME = re.compile(r"(?P<tool>.+)To(?P<parent>[A-Z].*)")

_Field = list[tuple[int, bytes, int]]
"""Frame number, value and place in the header, of every frame that has the field."""


def matches(path: Path, head: bytes) -> bool:
    """The first line of an NRRD file or the first fields of a MetaImage."""
    return _is_nrrd(head) or _META_IMAGE.search(head[:2000]) is not None


def read(path: Path, declared: Declarations) -> Raw:
    """The transforms of every frame. Raises InputError with the line where a matrix is none."""
    header, whole = _header(path)
    fields: dict[str, _Field] = defaultdict(list)
    for match in _FIELD.finditer(header):
        fields[match[2].decode()].append((int(match[1]), match[3], match.start()))
    frames = np.unique([frame for field in fields.values() for frame, _, _ in field])
    names = [name for name, field in fields.items() if _is_transform(name, field)]
    if not names:
        raise InputError("holds no tracked transform (Seq_Frame0000_...Transform); it is an image alone", file=path)
    tracks = {}
    for name, (tool, parent) in _tools(names).items():
        status = fields.get(f"{name}Status") or fields.get("Status")
        tracks[tool] = _track(path, header, whole, frames, fields[name], status, parent)
    announced = _announced(header)
    return Raw(
        tracks,
        Source(str(path), hashlib.sha256(header).hexdigest()),
        "mm",
        time_s=_times(path, header, frames, fields["Timestamp"]) if "Timestamp" in fields else None,
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


def _is_transform(name: str, field: _Field) -> bool:
    return name.endswith("Transform") or (not name.endswith("Status") and len(field[0][1].split()) == 16)


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


def _track(
    path: Path, header: bytes, whole: bool, frames: np.ndarray, field: _Field, status: _Field | None, parent: str
) -> Track:
    last = field[-1]
    if not whole and len(last[1].split()) < 16 and last[2] + len(last[1]) + 100 > len(header):
        field = field[:-1]
    words = np.full(len(frames), "", object)
    for frame, value, _ in status or ():
        words[np.searchsorted(frames, frame)] = value.strip().decode("ascii", "replace").upper()
    row = np.searchsorted(frames, [frame for frame, _, _ in field])
    T = np.full((len(frames), 16), np.nan)
    T[row] = _matrices(path, header, field)
    T = T.reshape(-1, 4, 4)
    without = np.ones(len(frames), dtype=bool)
    without[row] = False
    words[without & np.isin(words, ("", "OK"))] = "without a transform"
    return Track(T[:, :3, 3], T[:, :3, :3], words, parent)


def _matrices(path: Path, header: bytes, field: _Field) -> Array:
    """(M, 16) numbers of a field."""
    values = b" ".join(value for _, value, _ in field).split()
    if len(values) == 16 * len(field):
        try:
            return np.fromiter(map(float, values), float, len(values)).reshape(-1, 16)
        except ValueError:
            pass
    return np.array([_numbers(path, header, value, at, 16) for _, value, at in field]).reshape(-1, 16)


def _numbers(path: Path, header: bytes, value: bytes, at: int, count: int) -> list[float]:
    try:
        numbers = [float(word) for word in value.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        shown = value[:40].decode("ascii", "replace")
        raise InputError(f"'{shown}' is not {count} numbers", file=path, line=header.count(b"\n", 0, at) + 1)
    return numbers


def _times(path: Path, header: bytes, frames: np.ndarray, field: _Field) -> Array:
    """(N,), NaN where a frame has none."""
    time = np.full(len(frames), np.nan)
    for frame, value, at in field:
        time[np.searchsorted(frames, frame)] = _numbers(path, header, value, at, 1)[0]
    return time


def _announced(header: bytes) -> int:
    """How many frames the header says that there are; 0 where it does not."""
    other = {match[1].lower(): match[2].split() for match in _OTHER.finditer(header)}
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
