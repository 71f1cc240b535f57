"""NDI ToolTracker tables: a block of columns a port, in mm; quaternions w first, or angles Rz, Ry, Rx in degrees.

Blocks begin with a cell ``Port 2: NAME s/n:...``, in the tables of NDI's CAPI sample program with ``ToolInfo``; there
the rows tell how many markers follow each tool, whatever the header says.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats._foreign import CHUNK, Cells, delimiter_of, floats, lines_of, read_cells
from carm_kin.recording.formats._table import Lines
from carm_kin.recording.raw import Raw, Track

SUMMARY = "NDI ToolTracker or CAPI sample table (.csv), also a folder of one file a pose"

_QUATERNION = ("q0", "qx", "qy", "qz")
_EULER = ("rx", "ry", "rz")
_POSITION = ("tx", "ty", "tz")
_STATE = ("state", "transformstatus")
_CAPI = (
    *("ToolInfo", "Frame#", "PortHandle", "Face#", "TransformStatus"),
    *("Q0", "Qx", "Qy", "Qz", "Tx", "Ty", "Tz", "Error"),
)
_START = re.compile(r"Port\b.*|ToolInfo", re.IGNORECASE)
_HEADER = re.compile(rb"^(\xef\xbb\xbf)?[#\"]?Tools\"?\s*[,;\t]")
_STATED = {"": "OK", "OK": "OK", "ENABLED": "OK"}


@dataclass(frozen=True)
class _Block:
    """The columns of one tool, by their unique names."""

    tool: str
    position: list[str]
    rotation: list[str]
    state: str


def matches(path: Path, head: bytes) -> bool:
    """The first cell is ``Tools`` or ``#Tools``."""
    return _HEADER.match(head) is not None


def read(path: Path, declared: Declarations) -> Raw:
    """The tools of all ports. Raises InputError with line and column where the table is not sound."""
    lines, source = lines_of(path, "a header that begins with 'Tools'", comment="")
    lines = replace(lines, delimiter=delimiter_of(lines.text[0]))
    header, lines = lines.split(1)
    cells = [" ".join(cell.split()) for cell in header.cells()[0]]
    if not lines.text:
        raise header.error("the file has a header but no poses below it")
    capi = any(cell.lower() == "toolinfo" for cell in cells)
    tracks, cut_off = _of_capi(lines) if capi else _of_ports(header, lines, cells)
    euler = next((None for track in tracks.values() if track.rotation.shape[1] == 4), "ZYX")
    return Raw(tracks, source, "mm", "wxyz", euler, cut_off=cut_off)


def _of_ports(header: Lines, lines: Lines, cells: list[str]) -> tuple[dict[str, Track], int]:
    """The table whose header names the ports."""
    starts = [i for i, cell in enumerate(cells) if _START.fullmatch(cell)]
    if not starts:
        raise header.error("no column 'Port ...' begins the columns of a tool", column=cells[-1])
    names = _unique(cells)
    blocks = [_block(header, cells, names, i, j) for i, j in zip(starts, [*starts[1:], len(cells)], strict=True)]
    wanted = [name for block in blocks for name in (*block.position, *block.rotation)]
    found = read_cells(_padded(lines, len(names)), names, wanted, [block.state for block in blocks])
    return {block.tool: _track(found, block) for block in blocks}, found.cut_off


def _block(header: Lines, cells: list[str], names: list[str], start: int, stop: int) -> _Block:
    own: dict[str, str] = {}
    for cell, name in zip(cells[start:stop], names[start:stop], strict=True):
        own.setdefault(cell.lower(), name)
    rotation = next((kind for kind in (_QUATERNION, _EULER) if all(part in own for part in kind)), _QUATERNION)
    state = next((name for name in _STATE if name in own), "state")
    for part in (*_POSITION, *rotation, state):
        if part not in own:
            needed = "State, Tx, Ty, Tz and Q0, Qx, Qy, Qz or Rz, Ry, Rx"
            raise header.error(f"'{cells[start]}' lacks the column {part.capitalize()}; needed are {needed}")
    return _Block(cells[start], [own[p] for p in _POSITION], [own[p] for p in rotation], own[state])


def _unique(cells: Sequence[str]) -> list[str]:
    """Names for the columns: repeated ones get the number of the column."""
    return [cell if cells.count(cell) == 1 else f"{cell} ({i})" for i, cell in enumerate(cells, 1)]


def _padded(lines: Lines, width: int) -> Lines:
    """With the empty cells that a row lacks behind a tool that was not seen."""
    missing = lines.delimiter

    def whole(line: str) -> str:
        short = width - 1 - line.count(missing)
        return line + missing * short if short > 0 and "missing" in line.lower() else line

    return replace(lines, text=[whole(line) for line in lines.text])


def _track(found: Cells, block: _Block) -> Track:
    words = [word.upper() for word in found.text[block.state].tolist()]
    status = np.array([_STATED.get(word, word) for word in words], dtype=object)
    return Track(found.stack(block.position), found.stack(block.rotation), status)


def _of_capi(lines: Lines) -> tuple[dict[str, Track], int]:
    """The table of the CAPI sample program: after each tool the number of its markers and four cells for each."""
    parts: dict[str, list[Cells]] = {}
    cut_off = 0
    for start in range(0, len(lines), CHUNK):
        blocks: dict[str, list[list[str]]] = {}
        for row, cells in enumerate(lines.cells(start, start + CHUNK), start):
            tools = _tools_of_row(lines, row, cells)
            cut_off += tools is None
            for tool, values in tools or ():
                blocks.setdefault(tool, []).append(values)
        counts = {tool: len(rows) for tool, rows in blocks.items()}
        if len(set(counts.values())) > 1 or (parts and blocks and parts.keys() != blocks.keys()):
            raise lines.error(f"rows from here on name other tools than the rows before: {', '.join(counts)}", start)
        for tool, rows in blocks.items():
            columns = list(zip(*rows, strict=True))
            numbers = {n: floats(lines, n, start, columns[k]) for k, n in enumerate(_CAPI) if 5 <= k < 12}
            state = np.array([word.strip() for word in columns[4]], dtype=object)
            parts.setdefault(tool, []).append(Cells(numbers, {"state": state}, 0))
    return {tool: _capi_track(tool, found) for tool, found in parts.items()}, cut_off


def _tools_of_row(lines: Lines, row: int, cells: list[str]) -> list[tuple[str, list[str]]] | None:
    """Every tool of a row with its 13 cells; None where the last row of the file ends before its time."""
    width, at, found = len(_CAPI), 1, []
    while at < len(cells) and (at + width < len(cells) or len(found) < _count(cells[0])):
        block = cells[at : at + width + 1]
        if len(block) < width + 1:
            if row == len(lines) - 1:
                return None
            raise lines.error(f"the row ends within the columns of tool {len(found) + 1}", row, _CAPI[len(block) - 1])
        found.append((_tool_name(block), block[:width]))
        at += width + 1 + 4 * _count(block[width])
    if len(found) != _count(cells[0]):
        if row == len(lines) - 1:
            return None
        raise lines.error(f"the row holds {len(found)} tools, its first cell says '{cells[0].strip()}'", row, "Tools")
    return found


def _tool_name(block: list[str]) -> str:
    return " ".join(block[0].split()) or block[2].strip()


def _count(cell: str) -> int:
    return int(cell) if cell.strip().isdigit() else 0


def _capi_track(tool: str, parts: list[Cells]) -> Track:
    numbers = {name: np.concatenate([part.numbers[name] for part in parts]) for name in parts[0].numbers}
    found = Cells(numbers, {"state": np.concatenate([part.text["state"] for part in parts])}, 0)
    return _track(found, _Block(tool, ["Tx", "Ty", "Tz"], ["Q0", "Qx", "Qy", "Qz"], "state"))
