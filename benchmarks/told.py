"""Recordings that tell a part, or nothing: ``python -m benchmarks.told --seeds 100``.

Pointers and single joints. The simulation shares nothing with the estimators.
"""

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import carm_kin
from benchmarks import scenes
from benchmarks.hand_moved import Machine, rotation, unit
from benchmarks.realism import DEG, MM, SIGMA_R, SIGMA_T, WRONG, noisy
from carm_kin.recording.recording import Recording

Array = np.ndarray
STREAM = 0x701D
FRAMES = 600
POINT, CIRCLE = "point", "circle"


@dataclass(frozen=True, eq=False)
class Made:
    """Poses without noise, and the pivot in the sensor's frame."""

    p: Array
    """(N, 3) m."""
    R: Array
    """(N, 3, 3)."""
    offset: Array
    """(3,) m."""


@dataclass(frozen=True)
class Kind:
    """One way of moving."""

    name: str
    locus: str
    made: Callable[[np.random.Generator], Made]
    sigma_r: float = SIGMA_R
    """Orientation noise, rad."""
    outliers: float = 0.0
    """Share of poses that are off by 3 to 100 mm."""


def pointer(turns: Callable[[Array, Array, np.random.Generator], Array]) -> Callable[[np.random.Generator], Made]:
    """A tool of random tip on a fixed point; ``turns`` gives rotation vectors (N, 3) in the sensor's frame from the
    phases (N,) and the shaft's direction (3,)."""

    def made(rng: np.random.Generator) -> Made:
        shaft = unit(rng)
        tip = rng.uniform(0.08, 0.35) * shaft + 0.02 * rng.normal(size=3)
        R = rotation(rng.uniform(0, 3) * unit(rng)) @ rotation(turns(np.linspace(0, 1, FRAMES), tip, rng))
        return Made(rng.normal(size=3) - R @ tip, R, tip)

    return made


def still(phase: Array, tip: Array, rng: np.random.Generator) -> Array:
    return np.zeros((len(phase), 3))


def spun(phase: Array, tip: Array, rng: np.random.Generator) -> Array:
    """About a shaft through the tip that passes the sensor by a fifth of its length."""
    shaft = tip / np.linalg.norm(tip) + 0.2 * unit(rng)
    return rng.uniform(2, 6) * phase[:, None] * shaft / np.linalg.norm(shaft)


def rocked(size_deg: float) -> Callable[[Array, Array, np.random.Generator], Array]:
    """To and fro about all directions."""

    def turns(phase: Array, tip: Array, rng: np.random.Generator) -> Array:
        return size_deg * DEG * np.sin(2 * np.pi * (phase[:, None] * (5, 3, 2) + rng.uniform(0, 1, 3)))

    return turns


def one_joint(joint: int) -> Callable[[np.random.Generator], Made]:
    """The other joint wobbles by 0.1 deg."""

    def made(rng: np.random.Generator) -> Made:
        machine = Machine.random(rng)
        angles = rng.uniform(-0.5, 0.5, 2) + 0.1 * DEG * rng.normal(size=(FRAMES, 2))
        angles[:, joint] += np.radians(rng.uniform(60, 160)) * np.linspace(-0.5, 0.5, FRAMES)
        return Made(*machine.poses(angles), machine.offset)

    return made


KINDS = (
    Kind("pointer, still", POINT, pointer(still)),
    Kind("pointer, spun about its shaft", POINT, pointer(spun)),
    Kind("pointer, rocked by 1 deg, 0.3 deg of noise", POINT, pointer(rocked(1.0)), 0.3 * DEG),
    Kind("pointer, rocked by 3 deg, 0.3 deg of noise", POINT, pointer(rocked(3.0)), 0.3 * DEG),
    Kind("pointer, rocked by 5 deg", POINT, pointer(rocked(5.0))),
    Kind("pointer, rocked by 30 deg", POINT, pointer(rocked(30.0))),
    Kind("pointer, 3% outliers", POINT, pointer(rocked(30.0)), outliers=0.03),
    Kind("pointer, 30% outliers", POINT, pointer(rocked(30.0)), outliers=0.3),
    Kind("pointer, as a C-arm", CIRCLE, pointer(rocked(30.0))),
    Kind("orbital joint alone", CIRCLE, one_joint(1)),
    Kind("angular joint alone", CIRCLE, one_joint(0)),
    Kind("orbital joint alone, as a pointer", POINT, one_joint(1)),
    Kind("nothing moves, as a C-arm", CIRCLE, pointer(still)),
)


@dataclass(frozen=True)
class Outcome:
    """One calibration against its truth."""

    status: str
    code: str
    worst: float
    """Greatest error of what is told, in standard deviations; NaN where nothing is."""

    @property
    def wrong(self) -> bool:
        """Whether a number that is told is off by more than `WRONG` standard deviations."""
        return self.worst > WRONG


def recorded(kind: Kind, rng: np.random.Generator) -> tuple[Recording, Array]:
    """What a tracker gives of it, and the true offset (3,)."""
    made = kind.made(rng)
    n = len(made.p)
    shift = SIGMA_T * rng.normal(size=(n, 3))
    off = rng.permutation(n)[: round(kind.outliers * n)]
    shift[off] += rng.uniform(3, 100, (len(off), 1)) * MM * np.array([unit(rng) for _ in off]).reshape(-1, 3)
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, 3], T[:, :3, :3] = noisy(made.p, made.R, shift, kind.sigma_r * rng.normal(size=(n, 3)))
    return Recording.from_poses(T), made.offset


def run(job: tuple[str, int]) -> Outcome:
    """One kind, one seed."""
    name, seed = job
    number = next(k for k, kind in enumerate(KINDS) if kind.name == name)
    recording, offset = recorded(KINDS[number], np.random.default_rng([seed, STREAM, number]))
    result = carm_kin.calibrate(recording, locus=KINDS[number].locus)
    if result.told is not None:
        worst = max(abs(d.offset_m - d.direction_sensor @ offset) / d.sigma_m for d in result.told.told)
        return Outcome(result.status, "", float(worst))
    if result.offset_sensor_pivot_m is None or result.sigma.offset_sensor_pivot_m is None:
        return Outcome(result.status, result.refusal.code if result.refusal else "", np.nan)
    error = (result.offset_sensor_pivot_m - offset) / result.sigma.offset_sensor_pivot_m
    return Outcome(result.status, "", float(np.abs(error).max()))


HEADER = ("recording", "ok", "doubtful", "partial", "refused", "error / sigma", "worst", "wrong", "refusals")


def row_of(name: str, found: list[Outcome]) -> list[str]:
    """A row of the table."""
    statuses = Counter(o.status for o in found)
    told = [o.worst for o in found if np.isfinite(o.worst)]
    codes = Counter(o.code for o in found if o.code)
    return [
        name,
        *(f"{statuses[status]}" for status in ("ok", "doubtful", "partial", "refused")),
        f"{np.median(told):.1f}" if told else "-",
        f"{max(told):.1f}" if told else "-",
        f"{sum(o.wrong for o in found)}",
        ", ".join(f"{code} {count}" for code, count in codes.most_common(2)),
    ]


NOTES = f"""{FRAMES} frames of tools with random shafts and tips 80 to 350 mm from the sensor, and of C-arms of
which one joint turns; {SIGMA_T / MM:.1f} mm and {SIGMA_R / DEG:.2f} deg of white noise but where said, outliers of 3 to
100 mm. Numbers of runs by status. Error / sigma: the worst component of the offset, or of what is told of it, median
and greatest over the runs that tell something. Wrong: off by more than {WRONG:.0f} standard deviations."""


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    begin = time.perf_counter()
    jobs = [(kind.name, seed) for kind in KINDS for seed in range(given.seeds)]
    results = iter(scenes.run_all(run, jobs, given.jobs))
    rows = [row_of(kind.name, [next(results) for _ in range(given.seeds)]) for kind in KINDS]
    table = scenes.show("Told and untold", HEADER, rows)
    head = scenes.provenance(f"python -m benchmarks.told --seeds {given.seeds}", time.perf_counter() - begin)
    scenes.write_section("told", "\n\n".join(["## Told and untold", head, NOTES, table]))


if __name__ == "__main__":
    main()
