"""What real machines and trackers do besides noise: sag, play, creep, distortion, smoothing.

In the order in which they are applied: the C lags what drives it (play) and bends (`carm_kin.simulation.sag`), its base
creeps, the tracker distorts (`carm_kin.simulation.field`) and smooths. Noise comes last (`carm_kin.simulation.noise`):
its sigmas are those of the poses that are recorded. What is random draws from a stream of its own, so that no effect
changes another one or the noise.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carm_kin.errors import InputError
from carm_kin.simulation.field import distorted
from carm_kin.simulation.noise import faded
from carm_kin.simulation.plan import Plan
from carm_kin.simulation.protocols import VIRTUAL
from solvers.se3 import Array, log_so3, project_so3

LARGEST = {"sag_m": 0.1, "field_m": 0.1, "creep_m": 0.1, "backlash_rad": float(np.radians(20)), "smoothing_s": 10.0}
"""Larger effects are taken for a wrong unit."""
OF_JOINTS = ("sag_m", "backlash_rad")
RATES_HZ = (0.1, 10_000.0)
RATE_HZ = 10.0
"""Frames a second where the poses' times are needed and not given."""
PAUSE_S = 3.0
"""Between the last frame of a motion and the first of the next."""
SETTLING = 3.0
"""Time constants of the creep that a base goes through while it stands."""
FASTEST_DEG_S = 120.0
"""Poses that turn faster are stops, not frames of a continuous motion."""


@dataclass(frozen=True)
class Effects:
    """Sizes; zero is none."""

    sag_m: float = 0.0
    """Greatest shift of the sensor, as seen from the C, between two poses of the machine, by the weight on it."""
    field_m: float = 0.0
    """Distortion of the tracker over the recording, root mean square."""
    creep_m: float = 0.0
    """How far the base of each placement moves from its first to its last frame."""
    backlash_rad: float = 0.0
    """How far either joint's drive turns at a reversal before the C follows."""
    smoothing_s: float = 0.0
    """Time constant of the tracker's low pass."""
    rate_hz: float | None = None
    """Frames a second; None: the recording has no times, or those of `RATE_HZ` where it is smoothed."""

    def checked(self, protocol: str | Path) -> "Effects":
        """The same. Raises InputError that names the number which cannot be, or cannot be in this ``protocol``."""
        for name, most in LARGEST.items():
            if not 0 <= (size := getattr(self, name)) <= most:
                raise InputError(f"{name} must be from 0 to {most:.3g}, not {size}")
        low, high = RATES_HZ
        if self.rate_hz is not None and not low <= self.rate_hz <= high:
            raise InputError(f"rate_hz must be from {low:g} to {high:g} frames a second, not {self.rate_hz}")
        if str(protocol) == VIRTUAL and (own := [name for name in OF_JOINTS if getattr(self, name)]):
            problem = f"{' and '.join(own)} cannot be simulated with protocol '{VIRTUAL}'"
            raise InputError(f"{problem}: a C-arm's own two joints sag and have play, and its axes are no joints")
        return self

    def times(self, plan: Plan) -> Array | None:
        """(N,) s, of every pose, or None where the recording has none."""
        if self.rate_hz is None and not self.smoothing_s:
            return None
        return np.arange(len(plan.part)) / (self.rate_hz or RATE_HZ) + PAUSE_S * plan.part


def lagging(driven: Array, backlash_rad: float) -> Array:
    """(N, J) angles of joints that follow ``driven`` (N, J), in the order of time, with play: the play operator.

    They start in the middle of their play, stand while the drive is within half of it, and are dragged from there on.
    """
    half, found = backlash_rad / 2, driven.copy()
    for k in range(1, len(found)):
        found[k] = np.clip(found[k - 1], driven[k] - half, driven[k] + half)
    return found


def crept(T: Array, placement: np.ndarray, creep_m: float, rng: np.random.Generator) -> Array:
    """Poses T (N, 4, 4), m, whose bases creep, each in a direction of its own, ever more slowly.

    From the first to the last frame of a placement it moves by ``creep_m``. The base's pose is that of the mean.
    """
    moved = T.copy()
    for number in range(placement.max() + 1):
        here, direction = np.flatnonzero(placement == number), rng.normal(size=3)
        way = np.expm1(-SETTLING * np.linspace(0, 1, len(here))) / np.expm1(-SETTLING)
        moved[here, :3, 3] += creep_m * np.outer(way - way.mean(), direction / np.linalg.norm(direction))
    return moved


def smoothed(T: Array, part: np.ndarray, time_s: Array, tau_s: float) -> Array:
    """Poses T (N, 4, 4) after a low pass of the first order, tau dy/dt = x - y, at rest when each part begins.

    The twelve numbers of a pose go through it, linear between frames, and the rotation nearest to their matrix is
    taken: positions lag a steady motion by tau, rotations a turn at the rate w by atan(w tau). Raises InputError where
    the poses are no frames of a continuous motion.
    """
    step = np.where(np.diff(part, prepend=-1) == 0, np.diff(time_s, prepend=0.0), np.inf)
    _check_continuous(T, step)
    change = np.diff(T, axis=0, prepend=T[:1]) / step[:, None, None]
    keep = np.exp(-step / tau_s)
    behind = faded(tau_s * (1 - keep)[:, None, None] * change, keep)
    smooth = T - behind
    smooth[:, :3, :3] = project_so3(smooth[:, :3, :3])
    return smooth


def _check_continuous(T: Array, step: Array) -> None:
    """Raise InputError where the sensor turns faster from a pose to the next than it could be led."""
    between = np.flatnonzero(np.isfinite(step))
    turn = np.linalg.norm(log_so3(np.swapaxes(T[between - 1, :3, :3], 1, 2) @ T[between, :3, :3]), axis=1)
    speed = np.degrees(turn / step[between])
    if speed.size and speed.max() > FASTEST_DEG_S:
        raise InputError(
            f"smoothing_s is of continuous sweeps; here the sensor turns by {speed.max():.0f} deg/s from a pose to the "
            f"next, more than {FASTEST_DEG_S:.0f}: take a protocol of smaller steps, or a lower rate_hz"
        )


def tracked(T: Array, plan: Plan, effects: Effects, seed: int) -> Array:
    """Poses T (N, 4, 4) of a machine as a tracker gives them, but for noise: creep, distortion and smoothing.

    Raises InputError as `distorted` and `smoothed` do.
    """
    for_creep, for_field = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    if effects.creep_m:
        T = crept(T, plan.placement, effects.creep_m, for_creep)
    if effects.field_m:
        T = distorted(T, effects.field_m, for_field)
    if effects.smoothing_s and (time_s := effects.times(plan)) is not None:
        T = smoothed(T, plan.part, time_s, effects.smoothing_s)
    return T
