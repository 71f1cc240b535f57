"""C-arms whose poses are known in closed form, written out independently of the estimators and of `solvers.torus`.

The poses are products of rotations about two lines in space (the angular axis, and the orbital axis as
it stands at alpha = 0) of the pose at alpha = beta = 0; every rotation comes from SciPy. Everything is
in metres and radians.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from solvers.problem import Problem
from solvers.torus import Torus


@dataclass(frozen=True, eq=False)
class Machine:
    """The truth: a C-arm with a sensor, at P base placements."""

    T_world_torus: np.ndarray
    """(P, 4, 4)."""
    R: float
    """Signed."""
    epsilon: float
    T_sensor_carm: np.ndarray
    """(4, 4)."""

    @property
    def center(self) -> np.ndarray:
        """(P, 3)."""
        return self.T_world_torus[:, :3, 3]

    @property
    def n(self) -> np.ndarray:
        """(P, 3)."""
        return self.T_world_torus[:, :3, 0]

    @property
    def offset(self) -> np.ndarray:
        """(3,)."""
        return self.T_sensor_carm[:3, 3]

    @property
    def a(self) -> np.ndarray:
        """(3,)."""
        return self.T_sensor_carm[:3, 1]

    @property
    def b(self) -> float:
        """The sensor's distance from the orbital axis."""
        return float(np.linalg.norm(self.offset - self.a * (self.a @ self.offset)))

    def poses(self, angles: np.ndarray, placement: np.ndarray | int = 0) -> tuple[np.ndarray, np.ndarray]:
        """p (N, 3) and R (N, 3, 3) of the sensor at ``angles`` (N, 2)."""
        placement = np.broadcast_to(placement, len(angles))
        x, y, z = (self.T_world_torus[placement, :3, k] for k in range(3))
        c = self.center[placement]
        pivot = c + self.R * z
        axis = np.cos(self.epsilon) * y - np.sin(self.epsilon) * x
        carm = np.stack([np.cross(axis, z), axis, z], axis=2)
        R0 = carm @ self.T_sensor_carm[:3, :3].T
        p0 = pivot - (R0 @ self.offset)
        orbital = Rotation.from_rotvec(angles[:, 1:] * axis).as_matrix()
        angular = Rotation.from_rotvec(angles[:, :1] * x).as_matrix()
        p1 = pivot + np.einsum("nij,nj->ni", orbital, p0 - pivot)
        return c + np.einsum("nij,nj->ni", angular, p1 - c), angular @ orbital @ R0

    def moved(self, step: np.ndarray) -> "Machine":
        """Right perturbations [v, w] of each torus, then of R, epsilon and [v, w] of the mount (6 P + 8,)."""
        P = len(self.T_world_torus)
        return Machine(
            np.stack([T @ rigid(step[6 * p : 6 * p + 6]) for p, T in enumerate(self.T_world_torus)]),
            self.R + step[6 * P],
            self.epsilon + step[6 * P + 1],
            self.T_sensor_carm @ rigid(step[6 * P + 2 :]),
        )

    def reported(self) -> np.ndarray:
        """t, R, b, epsilon, a, then c and n of every placement, in one vector."""
        own = np.concatenate([self.center, self.n], axis=1).ravel()
        return np.concatenate([self.offset, [self.R, self.b, self.epsilon], self.a, own])

    def torus(self) -> Torus:
        """The solvers' own type, every zero known."""
        P = len(self.T_world_torus)
        return Torus(self.T_world_torus, self.R, self.epsilon, self.T_sensor_carm, np.ones(P, dtype=bool), True)


def rigid(xi: np.ndarray) -> np.ndarray:
    """exp of the tangent [v, w] by the general matrix exponential."""
    hat = np.zeros((4, 4))
    hat[0, 1], hat[0, 2], hat[1, 2] = -xi[5], xi[4], -xi[3]
    hat -= hat.T
    hat[:3, 3] = xi[:3]
    return expm(hat)


def frame(rng: np.random.Generator, spread: float) -> np.ndarray:
    """A uniform rotation and a position in a cube of half-width ``spread``."""
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()  # pyright: ignore[reportCallIssue]
    T[:3, 3] = rng.uniform(-spread, spread, 3)
    return T


def machine(
    seed: int = 0,
    R: float = 0.1,
    epsilon: float = 0.0,
    placements: int = 1,
    sensor_in_carm: tuple[float, float, float] | None = None,
    world_m: float = 1.0,
) -> Machine:
    """A random C-arm: the sensor 0.6 to 0.8 m from the pivot unless given, as on the design's machines."""
    rng = np.random.default_rng([seed, 77])
    tori = np.stack([frame(rng, world_m) for _ in range(placements)])
    T_carm_sensor = frame(rng, 0.0)
    drawn = np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.6, 0.8)])
    T_carm_sensor[:3, 3] = drawn if sensor_in_carm is None else sensor_in_carm
    return Machine(tori, R, epsilon, np.linalg.inv(T_carm_sensor))


@dataclass(frozen=True, eq=False)
class Motion:
    """The true angles of N poses and what a recording tells of them."""

    angles: np.ndarray
    """(N, 2)."""
    held: np.ndarray
    """(N, 2) as in Problem."""
    label: np.ndarray
    """(N, 2) as in Problem."""
    placement: np.ndarray
    """(N,)."""

    def __len__(self) -> int:
        return len(self.angles)

    def without_labels(self) -> "Motion":
        """Sweeps are still known, their angles are not."""
        return replace(self, label=np.full(self.label.shape, np.nan))

    def free(self) -> "Motion":
        """Nothing is known."""
        return replace(self.without_labels(), held=np.full(self.held.shape, -1))


def sweeps_deg(alphas, betas_path, betas, alphas_path, placement: int = 0) -> Motion:
    """An orbital sweep at each alpha, then an angular sweep at each beta, with labels; all in degrees."""
    angles, held, label, number = [], [], [], 0
    for joint, values, path in ((0, alphas, betas_path), (1, betas, alphas_path)):
        for value in values:
            part = np.zeros((len(path), 2))
            part[:, joint], part[:, 1 - joint] = np.radians(value), np.radians(path)
            which = np.full((len(path), 2), -1)
            which[:, joint] = number
            known = np.full((len(path), 2), np.nan)
            known[:, joint] = np.radians(value)
            angles, held, label, number = [*angles, part], [*held, which], [*label, known], number + 1
    angles, held, label = (np.concatenate(x) for x in (angles, held, label))
    return Motion(angles, held, label, np.full(len(angles), placement))


def problem(truth: Machine, motion: Motion, sigma_t: float = 0.0, sigma_r: float = 0.0, seed: int = 0) -> Problem:
    """The recording of a motion, with noise of the position and of the orientation (in the sensor frame)."""
    p, R = truth.poses(motion.angles, motion.placement)
    rng = np.random.default_rng([seed, 3])
    p = p + sigma_t * rng.normal(size=p.shape)
    R = R @ Rotation.from_rotvec(sigma_r * rng.normal(size=p.shape)).as_matrix()
    return Problem(p, R, motion.placement, motion.held, motion.label)


def shuffled(given: Problem, seed: int = 0) -> Problem:
    """The same poses in random order."""
    return given.select(np.random.default_rng([seed, 9]).permutation(len(given)))


MOTION = sweeps_deg((-60, 0, 35, 80), range(0, 360, 24), (0, 40, 75), range(0, 360, 24))
"""What every solver is tried on, 105 labelled poses."""
TRUTH = machine(1, 0.25)
SIGMA_T, SIGMA_R = 1e-3, 1e-3
"""Noise of `DATA` an axis, m and rad."""
EXACT, DATA = problem(TRUTH, MOTION), problem(TRUTH, MOTION, SIGMA_T, SIGMA_R)


def assert_close(found: Any, expected: Any, atol: float, what: str) -> None:
    """Raise AssertionError where an entry is farther off than ``atol``."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol, err_msg=what)
