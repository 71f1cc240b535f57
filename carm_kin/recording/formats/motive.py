"""OptiTrack Motive exports: rows of names above the columns, rigid bodies among markers.

The first line may tell the unit (``Length Units``) and the kind of rotation (``Rotation Type``); where it does not,
these must be declared. Columns go by the labels above them, so that their order does not matter.
"""

from pathlib import Path

from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats._foreign import Cells, lines_of, read_cells
from carm_kin.recording.formats._table import Lines
from carm_kin.recording.raw import Raw, Track

SUMMARY = "OptiTrack Motive export (.csv) with rigid bodies"

_UNITS = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}
_HEADER_ROWS = 12
_BODY = "rigid body"
_POSITION, _ROTATION = "position", "rotation"


def matches(path: Path, head: bytes) -> bool:
    """The first cell is ``Format Version``."""
    return head.removeprefix(b"\xef\xbb\xbf").lstrip(b'"').startswith(b"Format Version")


def read(path: Path, declared: Declarations) -> Raw:
    """Every rigid body. Raises InputError where there is none, or with line and column where a cell is no number."""
    lines, source = lines_of(path, "an export with a first line 'Format Version,...'", comment="")
    rows = [[cell.strip() for cell in cells] for cells in lines.cells(0, _HEADER_ROWS)]
    facts = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    axes = next((i for i, row in enumerate(rows) if row[0].lower() == "frame"), None)
    if axes is None or axes < 2:
        raise lines.error("no line 'Frame,Time (Seconds),X,Y,Z,...' below the first; export with the header", 0)
    kinds = next((row for row in rows[1:axes] if _BODY in map(str.lower, row)), None)
    if kinds is None:
        raise lines.error("no column is of the type 'Rigid Body'; export the rigid bodies too", axes)
    header, lines = lines.split(axes + 1)
    if not lines.text:
        raise header.error("the file has a header but no poses below it", axes)
    bodies = _bodies(header, kinds, rows[rows.index(kinds) + 1], rows[axes - 1], rows[axes])
    names = [f"column {i}" for i in range(1, len(rows[axes]) + 1)]
    for body, columns in bodies.items():
        for label, i in columns.items():
            names[i] = f"{body} {label}"
    time = next((i for i, cell in enumerate(rows[axes]) if cell.lower().startswith("time")), None)
    wanted = [names[i] for columns in bodies.values() for i in columns.values()]
    found = read_cells(lines, names, [*wanted, *([names[time]] if time is not None else [])])
    announced = facts.get("Total Exported Frames", "")
    frames = len(found.numbers[wanted[0]])
    return Raw(
        {body: _track(found, body, columns) for body, columns in bodies.items()},
        source,
        unit=_UNITS.get(facts.get("Length Units", "").lower()),
        quaternion="wxyz",
        euler=_order(facts.get("Rotation Type", "")),
        time_s=found.numbers[names[time]] if time is not None else None,
        cut_off=max(found.cut_off, int(announced) - frames if announced.isdigit() else 0),
    )


def _bodies(
    header: Lines, kinds: list[str], names: list[str], parts: list[str], axes: list[str]
) -> dict[str, dict[str, int]]:
    """Rigid body -> ``position x`` and the like -> its column."""
    bodies: dict[str, dict[str, int]] = {}
    for i, (kind, name, part, axis) in enumerate(zip(kinds, names, parts, axes, strict=False)):
        if kind.lower() == _BODY and part.lower() in (_POSITION, _ROTATION) and axis.lower() in "xyzw":
            bodies.setdefault(name, {})[f"{part.lower()} {axis.lower()}"] = i
    for name, columns in bodies.items():
        for part in (_POSITION, _ROTATION):
            for axis in "xyz":
                if f"{part} {axis}" not in columns:
                    last = len(header) - 1
                    raise header.error(f"rigid body '{name}' has no column {part} {axis.upper()}", last)
    return bodies


def _track(found: Cells, body: str, columns: dict[str, int]) -> Track:
    parts = "wxyz" if f"{_ROTATION} w" in columns else "xyz"
    rotation = found.stack([f"{body} {_ROTATION} {axis}" for axis in parts])
    return Track(found.stack([f"{body} {_POSITION} {axis}" for axis in "xyz"]), rotation)


def _order(rotation_type: str) -> str | None:
    """The Euler order that the header tells, as ``XYZ``."""
    word = rotation_type.strip().upper().removeprefix("EULER").strip()
    return word if sorted(word) == ["X", "Y", "Z"] else None
