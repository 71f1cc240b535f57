"""What real machines and trackers do, against the stated uncertainty: ``python -m benchmarks.realism --seeds 60``.

Sweeps moved by hand from `benchmarks.hand_moved`, every second frame fitted, default options.
"""

import argparse
import time
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

import carm_kin
from benchmarks import scenes
from benchmarks.hand_moved import RATE_HZ, Machine, Motion, Take, noisy, rotation, unit

Array = np.ndarray
STREAM = 0x4EA1
SIGMA_T, SIGMA_R = 0.2e-3, float(np.radians(0.08))
EVERY = 2
"""Frames simulated for one that is fitted."""
MM, DEG = 1e-3, float(np.radians(1.0))
WRONG = 4.0
"""Stated standard deviations beyond which an accepted component is wrong."""
PLAY = float(np.radians(0.5))
"""Angle within which a reversal takes up the play."""
CONVENTIONS = ("angular_zero_convention", "orbital_zero_convention")


@dataclass(frozen=True)
class Effect:
    """What is added to white noise; lengths in mm, angles in deg, as a row names them."""

    name: str
    ar1: float = 0.0
    """Correlation of the noise from frame to frame at `RATE_HZ`."""
    smoothing_s: float = 0.0
    """Time constant of the tracker's low pass."""
    ratio: float = 1.0
    """Noise along the tracker's line of sight over that across it."""
    field: tuple[float, float] = (0.0, 0.0)
    """Distortion of the tracker, rms: mm and deg."""
    field_m: float = 0.5
    """Its length in space."""
    flex: tuple[float, float] = (0.0, 0.0)
    """Greatest sag, mm and deg."""
    backlash: tuple[float, float] = (0.0, 0.0)
    creep_mm: float = 0.0
    """How far the base creeps."""
    slip_deg: float = 0.0
    """How far the joint that is held turns in the course of a sweep, either way."""
    label_deg: float | None = None
    """Step of the labels of held joints; None: no labels, 0: exact."""


EFFECTS = (
    Effect("white"),
    Effect("AR(1) 0.7", ar1=0.7),
    Effect("AR(1) 0.9", ar1=0.9),
    Effect("AR(1) 0.97", ar1=0.97),
    Effect("smoothing 0.05 s", ar1=0.9, smoothing_s=0.05),
    Effect("smoothing 0.15 s", ar1=0.9, smoothing_s=0.15),
    Effect("anisotropic x3", ratio=3.0),
    Effect("anisotropic x5", ratio=5.0),
    Effect("labels exact", label_deg=0.0),
    Effect("labels to 0.1 deg", label_deg=0.1),
    Effect("labels to 1 deg", label_deg=1.0),
    Effect("optical field 0.2 mm", field=(0.2, 0.02)),
    Effect("optical field 0.5 mm", field=(0.5, 0.05)),
    Effect("EM field 1 mm", field=(1.0, 0.2), field_m=0.3),
    Effect("flex 0.3 mm", flex=(0.3, 0.03)),
    Effect("flex 1 mm", flex=(1.0, 0.05)),
    Effect("flex 2 mm", flex=(2.0, 0.1)),
    Effect("flex 4 mm", flex=(4.0, 0.2)),
    Effect("backlash 0.5 mm", backlash=(0.5, 0.05)),
    Effect("creep 0.5 mm", creep_mm=0.5),
    Effect("held joint slips 0.3 deg", slip_deg=0.3),
    Effect("held joint slips 1 deg", slip_deg=1.0),
    Effect("mild", ar1=0.7, field=(0.1, 0.01), flex=(0.3, 0.03), backlash=(0.1, 0.01), creep_mm=0.1),
    Effect("typical", 0.9, 0.05, 2.0, (0.2, 0.02), 0.5, (1.0, 0.05), (0.25, 0.025), 0.2),
    Effect("hard", 0.97, 0.15, 3.0, (0.5, 0.05), 0.5, (2.0, 0.1), (0.5, 0.05), 0.5),
)


@dataclass(frozen=True, eq=False)
class Outcome:
    """One calibration against its truth."""

    status: str
    codes: tuple[str, ...]
    error_m: float = np.nan
    ratio: Array = field(default_factory=lambda: np.zeros(0))
    """(3,) errors of the offset over their standard deviations."""
    radius_ratio: float = np.nan
    """The same of R."""

    @property
    def accepted(self) -> bool:
        """Whether numbers were given."""
        return bool(self.ratio.size)

    @property
    def wrong(self) -> bool:
        """Whether an accepted component is off by more than `WRONG` standard deviations."""
        return self.accepted and float(np.abs(self.ratio).max()) > WRONG


def simulated(effect: Effect, rng: np.random.Generator) -> tuple[Machine, Take]:
    """A machine, and what the tracker and the operator recorded of it."""
    machine, motion = Machine.random(rng), Motion.random(rng)
    if effect.slip_deg:
        motion = _slipping(motion, effect.slip_deg * DEG, rng)
    bent = _sag(machine, motion.angles, effect, rng) + _play(motion, effect, rng)
    p, R = machine.poses(motion.angles, bent)
    drift = np.linspace(0, 1, len(p))[:, None] ** 0.7
    p = p + effect.creep_mm * MM * drift * unit(rng)
    p, R = _distorted(p, R, effect, rng)
    if effect.smoothing_s:
        p, R = smoothed(p, R, motion.sweep, effect.smoothing_s)
    depth = np.array([1.0, 1.0, effect.ratio])
    shift, turn = (s * _noise(len(p), effect.ar1, rng) for s in (SIGMA_T, SIGMA_R))
    if effect.ratio > 1:
        # the weak directions of an orientation are the turns about the axes across the line of sight
        shift, turn = 0.5 * shift * depth, 0.6 * turn * (effect.ratio, effect.ratio, 1.0)
        turn = np.einsum("nji,nj->ni", R, turn)
    p, R = noisy(p, R, shift, turn)
    label = np.full(motion.angles.shape, np.nan) if effect.label_deg is None else motion.held
    if effect.label_deg:
        label = np.round(label / (effect.label_deg * DEG)) * effect.label_deg * DEG
    time_s = np.arange(len(p)) / RATE_HZ + 3.0 * motion.sweep
    take = Take(p, R, time_s, motion.sweep, motion.moving, label, np.zeros(len(p), dtype=int))
    return machine, take.select(slice(None, None, EVERY))


def _slipping(motion: Motion, size: float, rng: np.random.Generator) -> Motion:
    """The held joint turns by the size in every sweep, at once or little by little."""
    angles = motion.angles.copy()
    for sweep in range(motion.sweep.max() + 1):
        here = np.flatnonzero(motion.sweep == sweep)
        course = np.linspace(0, 1, len(here)) ** rng.uniform(0.3, 3.0)
        angles[here, 1 - motion.moving[here[0]]] += size * rng.choice([-1.0, 1.0]) * course
    return replace(motion, angles=angles)


def _noise(n: int, ar1: float, rng: np.random.Generator) -> Array:
    """(n, 3) of unit variance."""
    white = rng.normal(size=(n, 3))
    for k in range(1, n):
        white[k] = ar1 * white[k - 1] + np.sqrt(1 - ar1**2) * white[k]
    return white


def smoothed(p: Array, R: Array, sweep: Array, time_s: float, rate_hz: float = RATE_HZ) -> tuple[Array, Array]:
    """The poses after a low pass of the first order, which starts anew with every sweep."""
    gain = 1 - np.exp(-1 / (rate_hz * time_s))
    p, R = p.copy(), R.copy()
    for k in range(1, len(p)):
        if sweep[k] == sweep[k - 1]:
            p[k] = p[k - 1] + gain * (p[k] - p[k - 1])
            D = R[k - 1].T @ R[k]
            turn = 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
            R[k] = R[k - 1] @ rotation(gain * turn)
    return p, R


def _distorted(p: Array, R: Array, effect: Effect, rng: np.random.Generator) -> tuple[Array, Array]:
    """A smooth random field over the position, in the tracker's frame: a sum of waves."""
    if not any(effect.field):
        return p, R
    waves = rng.normal(size=(3, 60)) / effect.field_m
    values = np.cos(p @ waves + rng.uniform(0, 2 * np.pi, 60)) @ rng.normal(size=(60, 6)) / np.sqrt(30)
    turn = rotation(effect.field[1] * DEG * values[:, 3:])
    return p + effect.field[0] * MM * values[:, :3], turn @ R


def _sag(machine: Machine, angles: Array, effect: Effect, rng: np.random.Generator) -> Array:
    """(N, 6): linear in the vertical as the C and the swivel see it, of mean zero over the joints' whole ranges."""
    from_c, from_swivel = rng.normal(size=(3, 6)), rng.normal(size=(3, 6))

    def bent(at: Array) -> Array:
        of_c, of_swivel = machine.gravity(at)
        return of_c @ from_c + of_swivel @ from_swivel

    low, high = angles.min(axis=0), angles.max(axis=0)
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 25).T), axis=-1).reshape(-1, 2)
    over_all = bent(grid)
    middle = over_all.mean(axis=0)
    size = [np.linalg.norm((over_all - middle)[:, part], axis=1).max() for part in (slice(0, 3), slice(3, 6))]
    scale = np.repeat([effect.flex[0] * MM / size[0], effect.flex[1] * DEG / size[1]], 3)
    return (bent(angles) - middle) * scale


def _play(motion: Motion, effect: Effect, rng: np.random.Generator) -> Array:
    """(N, 6): either joint's play, which a reversal takes up within `PLAY`."""
    size = np.repeat([0.5 * effect.backlash[0] * MM, 0.5 * effect.backlash[1] * DEG], 3)
    total = np.zeros((len(motion.angles), 6))
    for joint in (0, 1):
        state = np.zeros(len(total))
        steps = np.diff(motion.angles[:, joint]) / PLAY
        for k, by in enumerate(steps):
            state[k + 1] = np.clip(state[k] + by, -1, 1)
        total += state[:, None] * size * np.concatenate([unit(rng), unit(rng)])
    return total


def judged(take: Take, offsets: Array, radius: float | None = None) -> Outcome:
    """Calibrate, and compare with the nearest of the true ``offsets`` (K, 3)."""
    result = carm_kin.calibrate(take.recording())
    codes = tuple(note.code for note in result.warnings if note.code not in CONVENTIONS)
    if result.offset_sensor_pivot_m is None or result.sigma.offset_sensor_pivot_m is None:
        return Outcome(result.status, (result.refusal.code, *codes) if result.refusal else codes)
    errors = result.offset_sensor_pivot_m - offsets
    error = errors[np.argmin(np.linalg.norm(errors, axis=1))]
    off = np.nan
    if radius is not None and result.major_radius_m is not None and result.sigma.major_radius_m:
        off = (result.major_radius_m - radius) / result.sigma.major_radius_m
    ratio = error / np.maximum(result.sigma.offset_sensor_pivot_m, 1e-12)
    return Outcome(result.status, codes, float(np.linalg.norm(error)), ratio, off)


def run(job: tuple[str, int]) -> Outcome:
    """One effect, one seed."""
    name, seed = job
    effect = next(e for e in EFFECTS if e.name == name)
    machine, take = simulated(effect, np.random.default_rng([seed, STREAM]))
    return judged(take, machine.offset[None], machine.radius)


HEADER = ("effect", "accepted", "rms error mm", "error / sigma", "cover offset", "cover R", "wrong ok", "said (runs)")


def row_of(name: str, found: list[Outcome]) -> list[str]:
    """A row of the table."""
    good = [o for o in found if o.accepted]
    counts = Counter(code for o in found for code in set(o.codes))
    said = ", ".join(f"{code} {count}" for code, count in counts.most_common(4))
    if not good:
        return [name, f"0 of {len(found)}", "-", "-", "-", "-", "0", said]
    ratios = np.array([o.ratio for o in good])
    return [
        name,
        f"{len(good)} of {len(found)}",
        f"{1e3 * np.sqrt(np.mean([o.error_m**2 for o in good])):.3f}",
        f"{np.sqrt((ratios**2).mean()):.2f}",
        f"{np.mean(np.abs(ratios) < 1.96):.0%}",
        f"{np.mean([abs(o.radius_ratio) < 1.96 for o in good]):.0%}",
        f"{sum(o.wrong for o in good)}",
        said,
    ]


NOTES = f"""Simulated by `benchmarks/hand_moved.py`, which shares nothing with the estimators: five orbital sweeps of
115 deg and three angular ones moved by hand, {RATE_HZ:.0f} frames a second of which every second is fitted, sweeps
declared, no labels but where said; {SIGMA_T * 1e3:.1f} mm and {np.degrees(SIGMA_R):.2f} deg of noise. Sag and play
are of the machine, the truth is that of a sag of mean zero over the joints' ranges. Error / sigma: root mean square
over the components of the offset. Coverage: share of components (of R) within 1.96 stated standard deviations; three
components of a run are not independent, so that its own standard error is about 3 points with 60 seeds. Wrong ok:
accepted runs with a component off by more than {WRONG:.0f} standard deviations. All but "said" over the accepted
runs."""


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    begin = time.perf_counter()
    jobs = [(effect.name, seed) for effect in EFFECTS for seed in range(given.seeds)]
    results = iter(scenes.run_all(run, jobs, given.jobs))
    rows = [row_of(effect.name, [next(results) for _ in range(given.seeds)]) for effect in EFFECTS]
    table = scenes.show("Effects of real machines and trackers", HEADER, rows)
    head = scenes.provenance(f"python -m benchmarks.realism --seeds {given.seeds}", time.perf_counter() - begin)
    scenes.write_section("realism", "\n\n".join(["## Realism", head, NOTES, table]))


if __name__ == "__main__":
    main()
