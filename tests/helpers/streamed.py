"""Streams of a C-arm that is moved by hand, with noise that lasts: five orbital and three angular sweeps, in alternate
directions, followed at 60 Hz and kept at 30 Hz. The poses are those of `carm_kin.testing.truth.Machine`."""

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from carm_kin.testing.truth import Machine, machine
from solvers.problem import Problem

RATE_HZ = 60
KEPT = 2
"""Of so many frames one is kept."""
SIGMA_T, SIGMA_R = 0.2e-3, float(np.radians(0.08))
PLAY = np.radians(0.5)
"""Width of the play of a joint."""


def truth_of(seed: int) -> Machine:
    """A C-arm with a lever of 0.6 to 0.8 m, 1.5 m from the tracker."""
    rng = np.random.default_rng([seed, 41])
    return machine(seed, R=rng.uniform(0.03, 0.18), epsilon=np.radians(0.4) * rng.normal(), world_m=1.5)


def stream(
    seed: int,
    ar: float = 0.0,
    bump_mm: float = 0.0,
    backlash_mm: float = 0.0,
    sag_mm: float = 0.0,
    seconds: float = 8.0,
    ar_rotation: float | None = None,
    slip_deg: float = 0.0,
) -> Problem:
    """The stream of `truth_of` (seed): noise AR(1) with the coefficient ``ar`` a frame, the base bumped once in
    mid-recording by ``bump_mm``, both joints with play that shifts the sensor by ``backlash_mm`` between its ends and
    turns it by 0.1 deg a mm, the C sagging by ``sag_mm``, the held joint of every sweep turning by ``slip_deg``."""
    rng = np.random.default_rng([seed, 42])
    angles, held, time_s = _motion(rng, seconds)
    within = np.arange(len(angles)) % int(seconds * RATE_HZ) / (seconds * RATE_HZ)
    angles[held >= 0] += np.radians(slip_deg) * within**2
    p, R = truth_of(seed).poses(angles)
    shift, turn = (f(rng, angles) for f in (_play(backlash_mm), _sag(sag_mm)))
    p = p + np.einsum("nij,nj->ni", R, shift[:, :3] + turn[:, :3])
    R = R @ Rotation.from_rotvec(shift[:, 3:] + turn[:, 3:]).as_matrix()
    direction = rng.normal(size=3)
    at = int(rng.uniform(0.25, 0.75) * len(p))
    p[at:] += bump_mm * 1e-3 * direction / np.linalg.norm(direction)
    p = p + SIGMA_T * _lasting(rng, len(p), ar)
    R = (
        R
        @ Rotation.from_rotvec(SIGMA_R * _lasting(rng, len(p), ar if ar_rotation is None else ar_rotation)).as_matrix()
    )
    nothing = np.full((len(p), 2), np.nan)
    every = Problem(p, R, np.zeros(len(p), dtype=int), held, nothing, time_s=time_s)
    return every.select(slice(None, None, KEPT))


def _motion(rng: np.random.Generator, seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles (N, 2), held sweeps (N, 2) and times (N,): two seconds lie between sweeps."""
    n = int(seconds * RATE_HZ)
    s = np.linspace(0, 1, n)
    s = s + 0.1 * np.sin(2 * np.pi * s) / np.pi
    angles, held, time_s, count = [], [], [], 0
    for joint, values in ((0, (-60, -30, 0, 30, 60)), (1, (-40, 5, 50))):
        for value in values:
            low, high = (-55, 60) if joint == 0 else (-rng.uniform(45, 90), rng.uniform(45, 90))
            path = np.radians(low + (high - low) * (s if count % 2 else 1 - s))
            part = np.empty((n, 2))
            part[:, joint], part[:, 1 - joint] = np.radians(value + rng.uniform(-3, 3)), path
            which = np.full((n, 2), -1)
            which[:, joint] = count
            angles, held = [*angles, part], [*held, which]
            time_s.append((seconds + 2) * count + np.arange(n) / RATE_HZ)
            count += 1
    return np.concatenate(angles), np.concatenate(held), np.concatenate(time_s)


def _lasting(rng: np.random.Generator, n: int, ar: float) -> np.ndarray:
    """(n, 3) of unit variance, stationary from the first frame."""
    first = rng.normal(size=(1, 3))
    steps = np.sqrt(1 - ar**2) * rng.normal(size=(n - 1, 3))
    return np.asarray(lfilter([1.0], [1.0, -ar], np.concatenate([first, steps]), axis=0))


Effect = Callable[[np.random.Generator, np.ndarray], np.ndarray]


def _play(mm: float) -> Effect:
    def displacement(rng: np.random.Generator, angles: np.ndarray) -> np.ndarray:
        found = np.zeros((len(angles), 6))
        for joint in (0, 1):
            v, w = (x / np.linalg.norm(x) for x in rng.normal(size=(2, 3)))
            state, place = angles[0, joint], np.empty(len(angles))
            for i, angle in enumerate(angles[:, joint]):
                state = min(max(state, angle - PLAY / 2), angle + PLAY / 2)
                place[i] = (state - angle) / PLAY
            found += mm * place[:, None] * np.concatenate([1e-3 * v, np.radians(0.1) * w])
        return found

    return displacement


def _sag(mm: float) -> Effect:
    def displacement(rng: np.random.Generator, angles: np.ndarray) -> np.ndarray:
        v = rng.normal(size=(4, 3))
        waves = np.stack([np.cos(angles[:, 0]), np.sin(angles[:, 0]), np.cos(angles[:, 1]), np.sin(angles[:, 1])])
        found = 0.5e-3 * mm * (waves.T @ (v / np.linalg.norm(v, axis=1, keepdims=True)))
        return np.concatenate([found, np.zeros_like(found)], axis=1)

    return displacement
