"""The recording of a session: its sweeps one after the other, labelled."""

import difflib
import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.intake import Dropped, summed
from carm_kin.recording.recording import Recording, Source
from carm_kin.recording.session import Session, files, poses_of, read_session
from carm_kin.recording.stations import at_stations
from solvers.estimate import Note
from solvers.se3 import Array

OUTSIDE = "outside of the session's sweeps"
"""Why poses of a file are left out that belong to no time range."""


@dataclass(frozen=True, eq=False)
class _Part:
    """The poses of one sweep."""

    sweep: int
    file: str
    recording: Recording


def read(path: Path) -> Recording:
    """The recording of the session in a file. Raises InputError that names the sweep and the line."""
    session = read_session(path)
    parts: dict[int, _Part] = {}
    intakes, notes, digest = [], [], hashlib.sha256(session.sha256.encode())
    for file, sweeps in files(session):
        whole = _file(session, file, sweeps[0])
        taken = np.zeros(len(whole), dtype=int)
        for k in sweeps:
            chosen = poses_of(session, k, whole.time_s, len(whole))
            if (taken[chosen] > 0).any():
                raise session.error(f"takes poses of '{session.sweeps[k].file}' that another sweep takes too", k)
            taken += chosen
            parts[k] = _Part(k, session.sweeps[k].file, whole.select(chosen))
        digest.update(whole.source.sha256.encode() if whole.source else b"")
        intakes += _counted(whole, int((taken == 0).sum()))
        notes += [Note(note.code, f"{session.sweeps[sweeps[0]].file}: {note.message}") for note in whole.notes]
    notes += _misspelt(session)
    recording = _joined(session, [parts[k] for k in range(len(session.sweeps))])
    missing = sum(drop.count for one in intakes for drop in one.dropped)
    source = Source(str(path), digest.hexdigest())
    whole = replace(recording, missing=missing, intakes=summed(intakes), notes=tuple(notes), source=source)
    return at_stations(whole) if session.tracker.stations else whole


def _misspelt(session: Session) -> Iterator[Note]:
    """A note for each held joint whose name is almost that of another joint."""
    held = {joint for sweep in session.sweeps for joint in (*sweep.held_deg, *sweep.held_mm)}
    others = {"angular", "orbital"}.union(sweep.moving for sweep in session.sweeps if sweep.moving)
    for joint in sorted(held - others):
        if close := difflib.get_close_matches(joint, others, 1, 0.8):
            yield Note("misspelt_joint", f"joint '{joint}' is held in a sweep; did you mean '{close[0]}'?")


def _file(session: Session, file: Path, sweep: int) -> Recording:
    from carm_kin.recording.formats import format_of, read_recording

    try:
        format = session.tracker.tracker or getattr(format_of(file), "name", "")
        if format == "session":
            raise InputError(f"'{session.sweeps[sweep].file}' is a session, which cannot stand in another")
        whole = read_recording(file, session.tracker.tracker, session.tracker.declared)
    except InputError as error:
        raise session.error(str(error), sweep) from None
    own = [name for name in ("sweep", "moving", "placement") if getattr(whole, name) is not None]
    if own:
        raise session.error(f"file '{session.sweeps[sweep].file}' has a column {own[0]}; label it in one place", sweep)
    return whole


def _counted(whole: Recording, outside: int) -> list:
    """The counts of a file, those of its last intake with the poses that no sweep takes."""
    *before, last = whole.intakes
    dropped = (*last.dropped, Dropped(OUTSIDE, outside))
    return [*before, replace(last, kept=last.kept - outside, dropped=dropped)]


def _joined(session: Session, parts: list[_Part]) -> Recording:
    sweeps = [session.sweeps[part.sweep] for part in parts]
    counts = [len(part.recording) for part in parts]

    def label(values: Iterable[str]) -> np.ndarray:
        return np.repeat(np.array(list(values), dtype=object), counts)

    held = [{**{j: np.radians(a) for j, a in s.held_deg.items()}, **{j: x / 1e3 for j, x in s.held_mm.items()}}
            for s in sweeps]  # fmt: skip
    joints = dict.fromkeys(j for part, one in zip(parts, held, strict=True) for j in (*part.recording.joints, *one))
    rotations = [part.recording.R_world_sensor for part in parts]
    if (lacks := [k for k, R in enumerate(rotations) if R is None]) and len(lacks) < len(parts):
        raise session.error(f"file '{parts[lacks[0]].file}' has no orientations, others have", lacks[0])
    prismatic = {j for s in sweeps for j in s.held_mm}.union(*(part.recording.prismatic for part in parts))
    return Recording(
        np.concatenate([part.recording.p_world_sensor for part in parts]),
        None if lacks else np.concatenate([R for R in rotations if R is not None]),
        time_s=_times(parts),
        sweep=label(s.label for s in sweeps),
        moving=label(s.moving for s in sweeps),
        placement=label(s.placement for s in sweeps),
        joints={j: _values(j, parts, held) for j in joints},
        prismatic=frozenset(prismatic),
        metadata={"file": label(part.file for part in parts)},
    )


def _values(joint: str, parts: list[_Part], held: list[dict[str, float]]) -> Array:
    """(N,) the joint's values: what the session says, else what the file says, else NaN."""
    values = []
    for part, one in zip(parts, held, strict=True):
        own = part.recording.joints.get(joint, np.full(len(part.recording), np.nan))
        values.append(np.full(len(part.recording), one[joint]) if joint in one else own)
    return np.concatenate(values)


def _times(parts: list[_Part]) -> Array | None:
    """(N,) s, where all files have times and these go on from sweep to sweep."""
    times = [part.recording.time_s for part in parts if part.recording.time_s is not None]
    if len(times) < len(parts):
        return None
    time_s = np.concatenate(times)
    return time_s if (np.diff(time_s) > 0).all() else None
