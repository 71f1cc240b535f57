"""A first session file for a folder of recordings, with what the files tell filled in and the rest left to the user."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from carm_kin.errors import InputError, MissingDependencyError
from carm_kin.files import write_atomically
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats import Format, format_of
from carm_kin.recording.formats._folder import files_of
from carm_kin.recording.raw import Raw
from carm_kin.recording.recording import Recording
from carm_kin.recording.session import NAME

JOINTS = ("angular", "orbital")
"""A file whose name holds one of these is taken for a sweep of that joint."""
_SILENT = {
    "unit": ("mm", "mm, cm or m"),
    "quaternion": ("wxyz", "wxyz or xyzw"),
    "euler": ("ZYX", "order of Euler angles; ZYX is Rz Ry Rx"),
    "left_handed": (True, "true or false"),
}
"""What a file may not tell: an example and what is valid."""


@dataclass(frozen=True)
class _Found:
    path: Path
    format: Format
    content: Raw | Recording | str
    """A message where it could not be read."""


def init(folder: Path) -> tuple[Path, int]:
    """Write ``session.toml`` into a folder; its path and the number of sweeps.

    Raises InputError where there is one already, or no recording.
    """
    path = folder / NAME
    if path.exists():
        raise InputError("is there already; edit it, or remove it first", file=path)
    if not folder.is_dir():
        raise InputError("is not a folder" if folder.exists() else "no such folder", file=folder)
    found = list(_recordings(folder))
    if not found:
        raise InputError("the folder holds no file in a known format", file=folder)
    lines = [*_head(found), *(line for one in found for line in _sweep(one))]
    write_atomically(path, "".join(" ".join(line.splitlines()) + "\n" for line in lines))
    return path, len(found)


def _recordings(folder: Path) -> Iterator[_Found]:
    for path in files_of(folder):
        try:
            format = format_of(path)
        except InputError:
            continue
        if format is not None:
            yield _Found(path, format, _content(path, format))


def _content(path: Path, format: Format) -> Raw | Recording | str:
    try:
        return format.read(path, Declarations())
    except (InputError, MissingDependencyError) as error:
        return str(error)


def _head(found: list[_Found]) -> Iterator[str]:
    names = list(dict.fromkeys(one.format.name for one in found))
    yield "# What the files do not tell stands behind '#': fill it in and remove the '#'."
    yield f'tracker = "{names[0]}"' if len(names) == 1 else f"# the files are of several formats: {', '.join(names)}"
    raws = [one.content for one in found if isinstance(one.content, Raw)]
    tools = list(dict.fromkeys(tool for raw in raws for tool in raw.tracks))
    if len(tools) == 1:
        yield f"tool = {_quoted(tools[0])}"
    elif tools:
        yield f"# tool = {_quoted(tools[0])}  # the one on the C: {', '.join(tools)}"
        yield f"# reference = {_quoted(tools[1])}  # if the poses shall be relative to another"
    for key, (example, valid) in _SILENT.items():
        if any(_silent(raw, key) for raw in raws):
            shown = str(example).lower() if isinstance(example, bool) else _quoted(example)
            yield f"# {key} = {shown}  # {valid}"
    yield from ("", "[defaults]", '# placement = "A"', "# held_deg = { angular = 0 }")


def _silent(raw: Raw, key: str) -> bool:
    """Whether the file does not tell this and has need of it."""
    widths = {track.rotation.shape[1:] for track in raw.tracks.values()}
    needed = {"quaternion": (4,) in widths, "euler": (3,) in widths}.get(key, True)
    return needed and getattr(raw, key) is None


def _sweep(one: _Found) -> Iterator[str]:
    label = one.path.name.split(".")[0]
    moving = next((joint for joint in JOINTS if joint in label.lower()), "")
    yield from ("", "[[sweep]]", f"file = {_quoted(one.path.name)}")
    if isinstance(one.content, str):
        yield f"# {one.content}"
    yield f"label = {_quoted(label)}"
    yield f'moving = "{moving}"' if moving else '# moving = "orbital"  # or "angular"; leave it out where both move'
    held = next((joint for joint in JOINTS if moving and joint != moving), "angular")
    yield f"# held_deg = {{ {held} = 0 }}"


def _quoted(text: str) -> str:
    """A TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in escaped) + '"'
