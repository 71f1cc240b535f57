"""Pointers about a fixed point, simulated: true poses first, then noise of both kinds on each."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from carm_kin.recording.recording import Recording

KINDS = ("cone", "spun", "plane", "still")


@dataclass(frozen=True)
class Pointer:
    """A tip in the sensor's frame and the point in the world where it stands, m, and a direction that is untold."""

    recording: Recording
    tip: np.ndarray
    point: np.ndarray
    untold: np.ndarray | None
    """(3,) of a pointer that is turned about one axis."""


def pointer(kind: str, seed: int, arc_deg: float | None = None, n: int = 300, sigma=(None, None)) -> Pointer:
    """One of `KINDS` with a tip, shaft, arcs and noise of its own; ``sigma`` (m, rad) where it matters."""
    rng = np.random.default_rng([seed, KINDS.index(kind), 31])
    shaft = Rotation.random(random_state=rng.integers(1 << 30))
    tip = shaft.apply([*(0.01 * rng.normal(size=2)), rng.uniform(0.08, 0.25)])
    sigma_t = rng.uniform(5e-5, 5e-4) if sigma[0] is None else sigma[0]
    sigma_r = np.radians(rng.uniform(0.02, 0.3)) if sigma[1] is None else sigma[1]
    s, phase = np.linspace(0, 2 * np.pi, n), rng.uniform(0, 2 * np.pi, 3)
    arc = np.radians(rng.uniform(6, 40) if arc_deg is None else arc_deg)
    angles = arc * np.sin(s[:, None] * np.array([3.0, 4.0, 2.0]) + phase)
    if kind == "spun":
        angles = np.column_stack([*np.radians(0.1) * rng.normal(size=(2, n)), np.linspace(0, 6, n)])
    elif kind == "plane":
        angles[:, 1:] = 0.0
    elif kind == "still":
        angles[:] = 0.0
    turn = Rotation.from_euler("XYZ", angles) if kind != "plane" else Rotation.from_rotvec(angles)
    Q = (Rotation.random(random_state=rng.integers(1 << 30)) * shaft * turn * shaft.inv()).as_matrix()
    point = rng.uniform(-1, 1, 3)
    p = point - Q @ tip + sigma_t * rng.normal(size=(n, 3))
    R = Q @ Rotation.from_rotvec(sigma_r * rng.normal(size=(n, 3))).as_matrix()
    axis = {"spun": shaft.apply([0, 0, 1.0]), "plane": shaft.apply([1.0, 0, 0])}.get(kind)
    return Pointer(Recording(p, R), tip, point, axis)


def with_outliers(one: Pointer, share: float, seed: int) -> tuple[Recording, np.ndarray]:
    """The recording with that share of its poses off by some 30 mm, and which they are."""
    rng = np.random.default_rng([seed, 32])
    n = len(one.recording)
    bad = np.sort(rng.permutation(n)[: round(share * n)])
    p = one.recording.p_world_sensor.copy()
    step = rng.normal(size=(len(bad), 3))
    p[bad] += (0.02 + 0.02 * rng.random((len(bad), 1))) * step / np.linalg.norm(step, axis=1, keepdims=True)
    return Recording(p, one.recording.R_world_sensor), bad
