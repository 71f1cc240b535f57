"""Which recordings a batch has, under which labels and with which settings: paths, patterns, folders, TOML lists."""

import glob
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path, PurePath
from typing import Any

from carm_kin.calibration.settings import Settings
from carm_kin.errors import InputError, on_one_line
from carm_kin.files import read_toml
from carm_kin.recording.formats import formats
from carm_kin.typed import check_names, record, typed

MAX_ENTRIES = 100_000
"""More recordings than this are taken for a mistake."""
MAX_LABEL_BYTES = 200
LIST = ".toml"
WHAT = "list of recordings"
SETTINGS = [field.name for field in fields(Settings)]
FORBIDDEN = '/\\:*?"<>|'
"""What a label, the name of a result's file, cannot have on every system."""


@dataclass(frozen=True)
class Entry:
    """One recording of a batch."""

    label: str
    """Names its result; unique, whatever the case of its letters. "" as long as nothing has been chosen."""
    path: Path
    """Absolute, so that a worker on another machine with the same shared folder finds it."""
    shown: str
    """The path as it was given, in printable characters."""
    settings: Settings


def entries(paths: Sequence[str | Path], given: Mapping[str, Any], skipped: Path) -> list[Entry]:
    """The recordings in ``paths``, sorted by label.

    A path is a file, a folder (all recordings in it and below), a pattern such as ``*/rec.csv``, or a TOML list.
    ``given`` are settings by name; they go before the defaults of a list, the settings of a recording in a list go
    before them. Nothing in the folder ``skipped``, where results go, is taken for a recording.
    Raises InputError for paths without a recording, wrong settings, and labels that are not unique.
    """
    found: list[Entry] = []
    for path in map(Path, paths):
        if _is_list(path):
            found += _of_list(path, given, skipped)
        else:
            found += _of_path(str(path), Path(), _settings(given, "the settings"), "", skipped)
        if len(found) > MAX_ENTRIES:
            raise InputError(f"more than {MAX_ENTRIES:,} recordings; give narrower paths", file=path)
    if not found:
        raise InputError("no recordings are given")
    return sorted(_labelled(_once(found)), key=lambda entry: entry.label)


def _is_list(path: Path) -> bool:
    """A TOML file, but where it is itself a recording: a session, which has sweeps."""
    if path.suffix.lower() != LIST or path.is_dir():
        return False
    try:
        return "sweep" not in read_toml(path, WHAT)
    except InputError:
        return True


def _settings(values: Mapping[str, Any], place: str) -> Settings:
    """Checked settings; a URDF that is a file by its absolute path."""
    settings = record(Settings, values, place)
    settings.check()
    if settings.urdf is None or not Path(settings.urdf).is_file():
        return settings
    return replace(settings, urdf=str(Path(settings.urdf).resolve()))


def _of_path(text: str, base: Path, settings: Settings, label: str, skipped: Path) -> list[Entry]:
    """The recordings of a file, a folder or a pattern, which is relative to ``base``."""
    files = _files(text, base, skipped.resolve())
    if label and len(files) > 1:
        raise InputError(f"label '{label}' is given to {len(files)} recordings; leave it out, or list them one by one")
    return [Entry(label, file.resolve(), on_one_line(str(file)), settings) for file in files]


def _files(text: str, base: Path, skipped: Path) -> list[Path]:
    path = base / text
    if path.is_dir():
        found = _recordings_below(path, skipped)
    elif path.exists():
        found = [path]
    elif set("*?[") & set(text):
        found = [path for path in map(Path, sorted(glob.glob(str(path), recursive=True))) if path.is_file()]
    else:
        raise InputError("no such file or folder", file=path)
    if not found:
        raise InputError("holds no recording" if path.is_dir() else "matches no file", file=path)
    return found


def _recordings_below(folder: Path, skipped: Path) -> list[Path]:
    """Files with the extension of a format; hidden ones and TOML files, which name others, are left out."""
    extensions = {end for found in formats().values() for end in found.extensions} - {LIST}
    below = (path for path in sorted(folder.rglob("*")) if path.name.lower().endswith(tuple(extensions)))
    visible = (path for path in below if not any(part.startswith(".") for part in path.relative_to(folder).parts))
    return [path for path in visible if path.is_file() and skipped not in path.resolve().parents]


def _of_list(path: Path, given: Mapping[str, Any], skipped: Path) -> list[Entry]:
    """The recordings in a TOML list: ``[defaults]`` with settings, ``[[recording]]`` with path, label and settings."""
    found: list[Entry] = []
    try:
        data = read_toml(path, WHAT)
        check_names(["defaults", "recording"], ["recording"], data, "the list")
        if not isinstance(data["recording"], list):
            raise InputError("'recording' must be tables: [[recording]]")
        defaults = _table(data.get("defaults", {}), SETTINGS, [], path.parent, "[defaults]")
        for number, values in enumerate(data["recording"], 1):
            place = f"[[recording]] number {number}"
            own = _table(values, ["path", "label", *SETTINGS], ["path"], path.parent, place)
            text, label = own.pop("path"), typed(str, own.pop("label", ""), f"{place}: label")
            settings = _settings({**defaults, **given, **own}, place)
            if label:
                _check_label(label, f" in {place}")
            try:
                found += _of_path(text, path.parent, settings, label, skipped)
            except InputError as error:
                raise InputError(f"{place}: {error}") from None
    except InputError as error:
        raise InputError(str(error), file=path) from None
    return found


def _table(values: Any, known: list[str], required: list[str], base: Path, place: str) -> dict[str, Any]:
    """A table of the list, its paths checked not to lead out of the list's folder ``base``."""
    if not isinstance(values, dict):
        raise InputError(f"{place} must be a table")
    check_names(known, required, values, place)
    for name in {"path", "urdf"} & values.keys():
        path = PurePath(typed(str, values[name], f"{place}: {name}"))
        if path.is_absolute() or path.drive or ".." in path.parts:
            reason = "leads out of the folder of the list; paths in it are relative and stay below"
            raise InputError(f"{place}: {name} '{path}' {reason}")
    urdf = values.get("urdf")
    return {**values, "urdf": str(base / urdf)} if urdf and (base / urdf).is_file() else dict(values)


def _once(found: list[Entry]) -> list[Entry]:
    """Without the recordings that paths without labels name again with the same settings."""
    kept = {(e.label, e.path, json.dumps(asdict(e.settings), sort_keys=True)): e for e in reversed(found)}
    return list(kept.values())[::-1]


def _labelled(found: list[Entry]) -> list[Entry]:
    """With labels: the one given, else the file's name, behind as many of its folders as tell it from others."""
    labels = [entry.label or _label(entry.path, 0) for entry in found]
    for depth in range(1, max(len(entry.path.parts) for entry in found)):
        count = Counter(label.casefold() for label in labels)
        for k, entry in enumerate(found):
            if not entry.label and count[labels[k].casefold()] > 1:
                labels[k] = _label(entry.path, depth)
    seen: dict[str, Entry] = {}
    for label, entry in zip(labels, found, strict=True):
        _check_label(label, f" of {entry.shown}")
        other = seen.setdefault(label.casefold(), entry)
        if other is not entry:
            raise InputError(f"{other.shown} and {entry.shown} would have the same label; give them labels in a list")
    return [replace(entry, label=label) for label, entry in zip(labels, found, strict=True)]


def _label(path: Path, depth: int) -> str:
    """The file's name without its extension, behind the names of so many of its folders."""
    folders = path.parts[1:-1]
    text = "-".join((*folders[max(len(folders) - depth, 0) :], path.stem))
    return "".join(c if c.isprintable() and c not in FORBIDDEN else "_" for c in text).lstrip(".") or "_"


def _check_label(label: str, whose: str) -> None:
    good = label.isprintable() and not set(FORBIDDEN) & set(label) and not label.startswith(".")
    if not good or len(label.encode()) > MAX_LABEL_BYTES:
        rule = f"no {' '.join(FORBIDDEN)}, no dot in front, at most {MAX_LABEL_BYTES} bytes"
        raise InputError(f"label '{label}'{whose} cannot name a file: {rule}; give another in a list")
