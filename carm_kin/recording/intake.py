"""How a file was read: what was kept, what was dropped, and why."""

from collections.abc import Iterable
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Dropped:
    """Frames that were left out for one and the same reason."""

    reason: str
    """In words, such as ``INVALID`` or ``identical to the frame before``."""
    count: int


@dataclass(frozen=True)
class Intake:
    """What became of the frames of a file, or of several files that were read alike."""

    format: str
    tool: str
    """"" where the file names none."""
    reference: str
    """The frame of the poses; "" is the tracker's own."""
    stated: tuple[str, ...]
    """The declarations, as they would be typed."""
    frames: int
    kept: int
    dropped: tuple[Dropped, ...] = ()
    projected: int = 0
    """Kept frames whose rotation was rounded so coarsely that the nearest rotation was taken."""
    stations: int = 0
    """Stops of the C into which the kept frames were averaged; 0: they were not."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "dropped", tuple(d for d in self.dropped if d.count))

    def in_words(self) -> str:
        """``3 INVALID, 2 all zero``."""
        return ", ".join(f"{one.count} {one.reason}" for one in self.dropped)


def summed(intakes: Iterable[Intake]) -> tuple[Intake, ...]:
    """One entry for all that were read alike, their counts added up, in order of first appearance."""
    total: dict[tuple, Intake] = {}
    for one in intakes:
        key = one.format, one.tool, one.reference, one.stated
        if key not in total:
            total[key] = one
            continue
        before = total[key]
        counts = {d.reason: 0 for d in (*before.dropped, *one.dropped)}
        for d in (*before.dropped, *one.dropped):
            counts[d.reason] += d.count
        total[key] = replace(
            before,
            frames=before.frames + one.frames,
            kept=before.kept + one.kept,
            dropped=tuple(Dropped(reason, count) for reason, count in counts.items()),
            projected=before.projected + one.projected,
            stations=before.stations + one.stations,
        )
    return tuple(total.values())
