"""What a reader finds in a tracker's file: the frames of every tool as they stand there, nothing dropped yet."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.recording import Source
from solvers.estimate import Note
from solvers.se3 import Array


@dataclass(frozen=True, eq=False)
class Track:
    """One tool in N frames, in the unit and the conventions of the file."""

    position: Array
    """(N, 3), NaN where the file has none."""
    rotation: Array
    """(N, 4) quaternions, (N, 3) Euler angles about x, y and z in degrees, or (N, 3, 3) matrices, perhaps rounded."""
    status: np.ndarray | None = None
    """(N,) str, what the file says of the frame; "" and "OK" are good."""
    parent: str = ""
    """The frame of the poses, where the file names it."""

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True, eq=False)
class Raw:
    """A file's tools by name, and what the file says of its own conventions; None where it is silent."""

    tracks: Mapping[str, Track]
    """All of the same number of frames."""
    source: Source
    unit: str | None = None
    quaternion: str | None = None
    euler: str | None = None
    left_handed: bool | None = False
    time_s: Array | None = None
    """(N,), s."""
    cut_off: int = 0
    """Frames that the file announces or begins and does not hold."""
    notes: tuple[Note, ...] = ()
    metadata: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Name -> (N,) str."""

    def __len__(self) -> int:
        return len(next(iter(self.tracks.values()))) if self.tracks else 0


def joined(raws: Sequence[Raw], source: Source) -> Raw:
    """The frames of files of one format, one file after the other.

    A tool that a file lacks has the status ``not in the file`` there. Raises InputError where files differ in their
    conventions.
    """
    first = raws[0]
    for raw in raws[1:]:
        for name in ("unit", "quaternion", "euler", "left_handed"):
            if getattr(raw, name) != getattr(first, name):
                values = f"{getattr(first, name) or 'none'} and {getattr(raw, name) or 'none'}"
                raise InputError(f"differs from {first.source.path} in its {name}: {values}", file=raw.source.path)
    names = dict.fromkeys(name for raw in raws for name in raw.tracks)
    times = [raw.time_s for raw in raws if raw.time_s is not None]
    return replace(
        first,
        tracks={name: _joined_track(name, raws) for name in names},
        source=source,
        time_s=np.concatenate(times) if len(times) == len(raws) else None,
        cut_off=sum(raw.cut_off for raw in raws),
        notes=tuple(dict.fromkeys(note for raw in raws for note in raw.notes)),
        metadata={k: np.concatenate([raw.metadata[k] for raw in raws]) for k in first.metadata},
    )


def _joined_track(name: str, raws: Sequence[Raw]) -> Track:
    example = next(raw.tracks[name] for raw in raws if name in raw.tracks)
    parts = [raw.tracks.get(name) or _absent(example, len(raw)) for raw in raws]
    for raw, part in zip(raws, parts, strict=True):
        if part.parent != example.parent or part.rotation.shape[1:] != example.rotation.shape[1:]:
            raise InputError(f"gives tool '{name}' in another way than the files before", file=raw.source.path)
    return replace(
        example,
        position=np.concatenate([part.position for part in parts]),
        rotation=np.concatenate([part.rotation for part in parts]),
        status=np.concatenate([np.full(len(p), "", object) if p.status is None else p.status for p in parts]),
    )


def _absent(example: Track, n: int) -> Track:
    shape = (n, *example.rotation.shape[1:])
    status = np.full(n, "not in the file", object)
    return replace(example, position=np.full((n, 3), np.nan), rotation=np.full(shape, np.nan), status=status)
