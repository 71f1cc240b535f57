"""A C-arm moved by hand before a tracker, by NumPy alone: nothing here is shared with the estimators.

The pose of the sensor is ``T_tracker_torus Rx(alpha) Tz(R) Rz(epsilon) Ry(beta) exp(xi) T_carm_sensor``; ``xi`` is
what a machine that bends or has play adds. Five orbital sweeps of 115 deg and three angular ones, in alternate
directions, simulated at 60 frames a second.
"""

from dataclasses import dataclass

import numpy as np

from carm_kin.recording.recording import Recording

Array = np.ndarray
RATE_HZ = 60.0
SWEEP_S = 8.0
ORBITAL, ANGULAR = 5, 3
"""Sweeps of either joint."""
ARC = float(np.radians(115.0))
"""Of an orbital sweep."""


def rotation(vector: Array) -> Array:
    """(..., 3, 3) rotations of rotation vectors (..., 3), rad, by Rodrigues' formula."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(np.asarray(vector, dtype=float), -1, 0)
    zero = np.zeros_like(x)
    K = np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2)
    return np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (K @ K)


def turned(axis: int, angle: Array | float) -> Array:
    """(..., 3, 3) rotations about a coordinate axis."""
    return rotation(np.asarray(angle)[..., None] * np.eye(3)[axis])


def unit(rng: np.random.Generator) -> Array:
    """A random direction (3,)."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


@dataclass(frozen=True, eq=False)
class Machine:
    """The truth, m and rad."""

    R_tracker_torus: Array
    """(3, 3)."""
    center: Array
    """(3,) of the torus in the tracker's frame."""
    radius: float
    epsilon: float
    R_carm_sensor: Array
    """(3, 3)."""
    sensor: Array
    """(3,) the sensor from the pivot, in the carm frame."""

    @staticmethod
    def random(rng: np.random.Generator) -> "Machine":
        """R 30 to 180 mm, the sensor 0.6 to 0.8 m from the pivot, the tracker 1.5 to 2 m away, looking down."""
        down, heading = np.radians(rng.uniform(10, 30)), rng.uniform(0, 2 * np.pi)
        # the tracker looks along its z; the torus stands upright before it, turned by the heading
        upright = turned(0, np.pi / 2 + down) @ turned(2, heading)
        return Machine(
            upright,
            np.array([rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), rng.uniform(1.5, 2.0)]),
            rng.uniform(0.03, 0.18),
            np.radians(0.4) * rng.normal(),
            rotation(rng.uniform(0.3, 2.5) * unit(rng)),
            rng.uniform(0.6, 0.8) * unit(rng),
        )

    @property
    def offset(self) -> Array:
        """(3,) the pivot in the sensor's frame."""
        return -self.R_carm_sensor.T @ self.sensor

    def poses(self, angles: Array, xi: Array | None = None) -> tuple[Array, Array]:
        """p (N, 3) and R (N, 3, 3) at angles (N, 2), bent by xi (N, 6): shift and turn in the carm frame."""
        xi = np.zeros((len(angles), 6)) if xi is None else xi
        swivel = self.R_tracker_torus @ turned(0, angles[:, 0])
        C = swivel @ turned(2, np.array(self.epsilon)) @ turned(1, angles[:, 1])
        pivot = self.center + self.radius * swivel[:, :, 2]
        bend = rotation(xi[:, 3:])
        p = pivot + np.einsum("nij,nj->ni", C, xi[:, :3] + bend @ self.sensor)
        return p, C @ bend @ self.R_carm_sensor

    def gravity(self, angles: Array) -> tuple[Array, Array]:
        """The vertical (N, 3) as seen from the C and from the swivel, both in the carm frame's axes."""
        up = self.R_tracker_torus.T @ np.array([0.0, -1.0, 0.0])
        of_swivel = np.einsum("nji,j->ni", turned(0, angles[:, 0]), up)
        return np.einsum("nji,nj->ni", turned(1, angles[:, 1]), of_swivel), of_swivel


@dataclass(frozen=True, eq=False)
class Take:
    """What a tracker gave of N poses, and what was noted of the joints."""

    p: Array
    """(N, 3) m."""
    R: Array
    """(N, 3, 3)."""
    time_s: Array | None
    """(N,)."""
    sweep: Array
    """(N,) int."""
    moving: Array
    """(N,) 0 the angular joint, 1 the orbital one."""
    label: Array
    """(N, 2) rad, of the held joint; NaN where nothing was noted."""
    placement: Array
    """(N,) int."""

    def __len__(self) -> int:
        return len(self.p)

    def select(self, poses: Array | slice) -> "Take":
        """Some of the poses, by index or mask."""
        time_s = None if self.time_s is None else self.time_s[poses]
        own = (getattr(self, name)[poses] for name in ("sweep", "moving", "label", "placement"))
        return Take(self.p[poses], self.R[poses], time_s, *own)

    def recording(self) -> Recording:
        """As a reader would make it."""
        T = np.tile(np.eye(4), (len(self), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = self.R, self.p
        return Recording.from_poses(
            T,
            time_s=self.time_s,
            sweep=self.sweep.astype(str),
            moving=np.array(["angular", "orbital"])[self.moving],
            placement=self.placement.astype(str),
            joints={name: self.label[:, k] for k, name in enumerate(("angular", "orbital"))},
        )


@dataclass(frozen=True, eq=False)
class Motion:
    """True angles at `RATE_HZ`."""

    angles: Array
    """(N, 2)."""
    sweep: Array
    """(N,)."""
    moving: Array
    """(N,)."""

    @staticmethod
    def random(rng: np.random.Generator) -> "Motion":
        """The sweeps in order, each at an uneven speed, from rest to rest."""
        n = round(SWEEP_S * RATE_HZ)
        reach = np.radians(rng.uniform(45, 90))
        start = np.radians(rng.uniform(-70, -45))
        swivels = np.linspace(-reach, reach, ORBITAL) + np.radians(rng.uniform(-3, 3, ORBITAL))
        orbits = start + ARC * np.array([0.1, 0.5, 0.9]) + np.radians(rng.uniform(-3, 3, ANGULAR))
        parts = []
        for k, held in enumerate((*swivels, *orbits)):
            joint = 1 if k < ORBITAL else 0
            first, arc = (start, ARC) if joint else (-reach, 2 * reach)
            along = _uneven(n, rng)
            part = np.empty((n, 2))
            part[:, joint] = first + arc * (along if k % 2 == 0 else 1 - along)
            part[:, 1 - joint] = held
            parts.append(part)
        sweep = np.repeat(np.arange(ORBITAL + ANGULAR), n)
        return Motion(np.concatenate(parts), sweep, (sweep < ORBITAL).astype(int))

    @property
    def held(self) -> Array:
        """(N, 2) the angle of the joint that is held, NaN of the other."""
        known = np.full(self.angles.shape, np.nan)
        rows = np.arange(len(known))
        known[rows, 1 - self.moving] = self.angles[rows, 1 - self.moving]
        return known


def _uneven(n: int, rng: np.random.Generator) -> Array:
    """(n,) from 0 to 1."""
    t = np.linspace(0, 1, n)
    speed = np.minimum(1, np.minimum(t, 1 - t) / 0.1)
    for k in (1, 2, 3):
        speed = speed * (1 + 0.15 * np.sin(2 * np.pi * k * t + rng.uniform(0, 2 * np.pi)))
    way = np.cumsum(speed)
    return (way - way[0]) / (way[-1] - way[0])


def noisy(p: Array, R: Array, shift: Array, turn: Array) -> tuple[Array, Array]:
    """Positions and orientations with errors (N, 3): the shift in the tracker's frame, the turn in the sensor's."""
    return p + shift, R @ rotation(turn)
