"""What becomes of users' recordings, as small functions from one take to another.

Each takes the `Scene` and a generator, and gives the changed take and the offsets that count as right.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.hand_moved import Machine, Take, rotation, unit
from benchmarks.realism import smoothed

Array = np.ndarray
MM, DEG = 1e-3, float(np.radians(1.0))
SCALE = 1.002


@dataclass(frozen=True, eq=False)
class Scene:
    """A recording and its truth."""

    machine: Machine
    take: Take
    rate_hz: float


Change = Callable[[Scene, np.random.Generator], Take | tuple[Take, Array]]
"""The changed take; with it the right offsets (K, 3) where they are not the machine's."""


@dataclass(frozen=True)
class Mutation:
    """One way in which recordings are changed."""

    name: str
    change: Change
    hidden: str = ""
    """Why nothing in the poses can show it; "" where something can."""


def _positions(take: Take, p: Array) -> Take:
    return replace(take, p=p)


def unchanged(scene: Scene, rng: np.random.Generator) -> Take:
    return scene.take


def axes_exchanged(scene: Scene, rng: np.random.Generator) -> Take:
    return _positions(scene.take, scene.take.p[:, [1, 0, 2]])


def axis_negated(scene: Scene, rng: np.random.Generator) -> Take:
    return _positions(scene.take, scene.take.p * np.where(np.arange(3) == rng.integers(3), -1.0, 1.0))


def transposed(scene: Scene, rng: np.random.Generator) -> Take:
    return replace(scene.take, R=np.swapaxes(scene.take.R, 1, 2))


def unit_changed_half_way(scene: Scene, rng: np.random.Generator) -> Take:
    half = np.arange(len(scene.take)) >= len(scene.take) // 2
    return _positions(scene.take, np.where(half[:, None], 1e-3, 1.0) * scene.take.p)


def time_reversed(scene: Scene, rng: np.random.Generator) -> Take:
    return scene.take.select(slice(None, None, -1))


def in_order_of_x(scene: Scene, rng: np.random.Generator) -> Take:
    """As a spreadsheet sorts it, the times lost."""
    return replace(scene.take.select(np.argsort(scene.take.p[:, 0])), time_s=None)


def block_doubled(scene: Scene, rng: np.random.Generator) -> Take:
    n = len(scene.take)
    first = int(rng.integers(0, n - n // 3))
    again = np.arange(first, first + n // 3)
    return replace(scene.take.select(np.concatenate([np.arange(n), again])), time_s=None)


def ten_times_over(scene: Scene, rng: np.random.Generator) -> Take:
    return replace(scene.take.select(np.tile(np.arange(len(scene.take)), 10)), time_s=None)


def ten_times_over_shuffled(scene: Scene, rng: np.random.Generator) -> Take:
    return replace(scene.take.select(rng.permutation(np.tile(np.arange(len(scene.take)), 10))), time_s=None)


def _remounted(
    take: Take, poses: Array, shift_m: float, turn_rad: float, rng: np.random.Generator
) -> tuple[Take, Array]:
    """The ``poses`` by a sensor elsewhere, and the new sensor in the old one (3, 4)."""
    turn, shift = rotation(turn_rad * unit(rng)), shift_m * unit(rng)
    p, R = take.p.copy(), take.R.copy()
    p[poses] += R[poses] @ shift
    R[poses] = R[poses] @ turn
    return replace(take, p=p, R=R), np.append(turn, shift[:, None], axis=1)


def _either(machine: Machine, change: Array) -> Array:
    """(2, 3) the offsets of the sensor before and after."""
    return np.stack([machine.offset, change[:, :3].T @ (machine.offset - change[:, 3])])


def sensor_reseated(shift_m: float, turn_rad: float) -> Change:
    """In mid-recording, once."""

    def change(scene: Scene, rng: np.random.Generator) -> tuple[Take, Array]:
        n = len(scene.take)
        after = np.arange(n) >= rng.integers(n // 4, 3 * n // 4)
        take, change = _remounted(scene.take, after, shift_m, turn_rad, rng)
        return take, _either(scene.machine, change)

    return change


def sensor_reseated_between_placements(scene: Scene, rng: np.random.Generator) -> tuple[Take, Array]:
    """By 0.5 mm; every second sweep stands at another place of the base."""
    take = two_placements(scene, rng)
    take, change = _remounted(take, take.placement == 1, 0.5 * MM, 0.05 * DEG, rng)
    return take, _either(scene.machine, change)


def two_placements(scene: Scene, rng: np.random.Generator) -> Take:
    """Every second sweep at another place of the base, which is noted."""
    second = scene.take.sweep % 2 == 1
    take = _moved(scene.take, second, 0.3, 0.4, rng)
    order = np.argsort(second, kind="stable")
    return replace(take, placement=second.astype(int), time_s=None).select(order)


def _moved(take: Take, poses: Array, shift_m: float, turn_rad: float, rng: np.random.Generator) -> Take:
    """The ``poses`` at a base moved about the middle of the recording."""
    turn, shift, middle = rotation(turn_rad * unit(rng)), shift_m * unit(rng), take.p.mean(axis=0)
    p, R = take.p.copy(), take.R.copy()
    p[poses] = (p[poses] - middle) @ turn.T + middle + shift
    R[poses] = turn @ R[poses]
    return replace(take, p=p, R=R)


def base_moved(times: int, shift_m: float) -> Change:
    """In mid-recording, unnoticed, each time for good."""

    def change(scene: Scene, rng: np.random.Generator) -> Take:
        take, n = scene.take, len(scene.take)
        for k in range(times):
            at = n * (k + 1) // (times + 1) + int(rng.integers(-n // 30, n // 30))
            take = _moved(take, np.arange(n) >= at, shift_m, 0.1 * DEG * shift_m / MM, rng)
        return take

    return change


def wrong_joint(scene: Scene, rng: np.random.Generator) -> Take:
    """A sweep of which the other joint is said to move; its label is that of the joint that moved, half-way."""
    take, which = scene.take, int(rng.integers(scene.take.sweep.max() + 1))
    here = take.sweep == which
    moving, label = take.moving.copy(), take.label.copy()
    moving[here], label[here] = 1 - moving[here], label[here][:, ::-1]
    return replace(take, moving=moving, label=label)


def label_off(scene: Scene, rng: np.random.Generator) -> Take:
    here = scene.take.sweep == int(rng.integers(scene.take.sweep.max() + 1))
    return replace(scene.take, label=scene.take.label + 5 * DEG * here[:, None])


def labels_off(size_deg: float) -> Change:
    """Every sweep's by its own amount up to the size."""

    def change(scene: Scene, rng: np.random.Generator) -> Take:
        by = rng.uniform(-size_deg, size_deg, scene.take.sweep.max() + 1) * DEG
        return replace(scene.take, label=scene.take.label + by[scene.take.sweep, None])

    return change


def _scattered(n: int, share: float, rng: np.random.Generator) -> Array:
    mask = np.zeros(n, dtype=bool)
    mask[rng.permutation(n)[: round(share * n)]] = True
    return mask


def _in_a_row(n: int, share: float, rng: np.random.Generator) -> Array:
    mask, size = np.zeros(n, dtype=bool), round(share * n)
    first = int(rng.integers(1, n - size))
    mask[first : first + size] = True
    return mask


def another_tool(scene: Scene, rng: np.random.Generator) -> Take:
    """A third of the poses, in a row, from a tool that lies 0.3 m beside and is turned by a radian."""
    return _remounted(scene.take, _in_a_row(len(scene.take), 1 / 3, rng), 0.3, 1.0, rng)[0]


def second_marker(scattered: bool) -> Change:
    """30% of the poses from a marker 3 mm and 0.2 deg beside."""

    def change(scene: Scene, rng: np.random.Generator) -> tuple[Take, Array]:
        n = len(scene.take)
        poses = (_scattered if scattered else _in_a_row)(n, 0.3, rng)
        take, change = _remounted(scene.take, poses, 3 * MM, 0.2 * DEG, rng)
        return take, _either(scene.machine, change)

    return change


def minority(what: str, scattered: bool) -> Change:
    """45% of the poses that fit exactly: at rest, at zero, or in another unit."""

    def change(scene: Scene, rng: np.random.Generator) -> Take:
        take, n = scene.take, len(scene.take)
        poses = (_scattered if scattered else _in_a_row)(n, 0.45, rng)
        p, R = take.p.copy(), take.R.copy()
        if what == "at rest":
            p[poses], R[poses] = p[0], R[0]
        elif what == "position at rest":
            p[poses] = p[0]
        elif what == "at zero":
            p[poses] = 0.0
        else:
            p[poses] *= 1e-3
        return replace(take, p=p, R=R)

    return change


def smoothing(time_s: float) -> Change:
    def change(scene: Scene, rng: np.random.Generator) -> Take:
        take = scene.take
        p, R = smoothed(take.p, take.R, take.sweep, time_s, scene.rate_hz)
        return replace(take, p=p, R=R)

    return change


def lag(scene: Scene, rng: np.random.Generator) -> Take:
    """The positions one frame after the orientations."""
    take = scene.take
    late = np.flatnonzero(np.diff(take.sweep) == 0) + 1
    return replace(take.select(late), R=take.R[late - 1])


def gaps(scene: Scene, rng: np.random.Generator) -> Take:
    """Ten bursts of loss, a third of the frames."""
    n = len(scene.take)
    kept = np.ones(n, dtype=bool)
    for first in rng.integers(0, n - n // 25, 10):
        kept[first : first + n // 25] = False
    return scene.take.select(kept)


def drift(scene: Scene, rng: np.random.Generator) -> Take:
    """The tracker by half a millimetre over the recording."""
    return _positions(scene.take, scene.take.p + 0.5 * MM * np.linspace(0, 1, len(scene.take))[:, None] * unit(rng))


def rounding(step_m: float, step: float) -> Change:
    """Positions to a step, entries of the rotation by a turn of random size within another, as a coarse file has it."""

    def change(scene: Scene, rng: np.random.Generator) -> Take:
        turn = step * rng.uniform(-1, 1, scene.take.p.shape)
        return replace(scene.take, p=np.round(scene.take.p / step_m) * step_m, R=scene.take.R @ rotation(turn))

    return change


def resampled(scene: Scene, rng: np.random.Generator) -> Take:
    """Three times as many frames, interpolated."""
    take, rows = scene.take, np.arange(0, len(scene.take) - 1, 1 / 3)
    low = rows.astype(int)
    part, same = rows - low, take.sweep[low] == take.sweep[low + 1]
    low, part = low[same], part[same]
    D = np.swapaxes(take.R[low], 1, 2) @ take.R[low + 1]
    turn = 0.5 * np.stack([D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], axis=1)
    p = take.p[low] + part[:, None] * (take.p[low + 1] - take.p[low])
    return replace(take.select(low), p=p, R=take.R[low] @ rotation(part[:, None] * turn), time_s=None)


def scaled(scene: Scene, rng: np.random.Generator) -> Take:
    return _positions(scene.take, SCALE * scene.take.p)


def mirrored(scene: Scene, rng: np.random.Generator) -> Take:
    """Positions and orientations in a left-handed frame throughout, labels left out."""
    S = np.diag([1.0, 1.0, -1.0])
    nothing = np.full(scene.take.label.shape, np.nan)
    return replace(scene.take, p=scene.take.p @ S, R=S @ scene.take.R @ S, label=nothing)


MUTATIONS = (
    Mutation("unchanged", unchanged),
    Mutation("x and y exchanged", axes_exchanged),
    Mutation("one axis negated", axis_negated),
    Mutation("rotations transposed", transposed),
    Mutation("unit changed half-way", unit_changed_half_way),
    Mutation("time reversed", time_reversed),
    Mutation("sorted by x", in_order_of_x),
    Mutation("a third doubled", block_doubled),
    Mutation("ten times over", ten_times_over),
    Mutation("ten times over, shuffled", ten_times_over_shuffled),
    Mutation("sensor re-seated 0.5 mm", sensor_reseated(0.5 * MM, 0.05 * DEG)),
    Mutation("sensor re-seated 2 mm", sensor_reseated(2 * MM, 0.2 * DEG)),
    Mutation("two placements", two_placements),
    Mutation("re-seated 0.5 mm between placements", sensor_reseated_between_placements),
    Mutation("base moved once, 0.5 mm", base_moved(1, 0.5 * MM)),
    Mutation("base moved twice, 0.5 mm", base_moved(2, 0.5 * MM)),
    Mutation("base moved 3 times, 0.5 mm", base_moved(3, 0.5 * MM)),
    Mutation("base moved 4 times, 0.5 mm", base_moved(4, 0.5 * MM)),
    Mutation("base moved 3 times, 20 mm", base_moved(3, 20 * MM)),
    Mutation("a sweep with the wrong joint", wrong_joint),
    Mutation("a label 5 deg off", label_off),
    Mutation("all labels off by up to 0.1 deg", labels_off(0.1)),
    Mutation("all labels off by up to 0.5 deg", labels_off(0.5)),
    Mutation("a third from another tool", another_tool),
    Mutation("second marker 3 mm, scattered", second_marker(True)),
    Mutation("second marker 3 mm, in a row", second_marker(False)),
    *(
        Mutation(f"45% {what}, {how}", minority(what, how == "scattered"))
        for what in ("at rest", "position at rest", "at zero", "in another unit")
        for how in ("scattered", "in a row")
    ),
    Mutation("smoothing 0.15 s", smoothing(0.15)),
    Mutation("positions a frame late", lag),
    Mutation("gaps", gaps),
    Mutation("drift 0.5 mm", drift),
    Mutation("rounded to 0.1 mm, 0.01 deg", rounding(0.1 * MM, 0.01 * DEG)),
    Mutation("rounded to 1 mm, 0.1 deg", rounding(1 * MM, 0.1 * DEG)),
    Mutation("resampled to three times the rate", resampled),
    Mutation(
        f"tracker's scale of {SCALE}", scaled, "a machine that much larger fits equally well; only a known length tells"
    ),
    Mutation(
        "left-handed throughout, no labels", mirrored, "the mirror image of a C-arm is one; only a label's sense tells"
    ),
)
