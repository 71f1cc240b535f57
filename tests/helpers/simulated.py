"""C-arms for the tests of the solvers, written out independently of `solvers.torus`.

The poses are products of rotations about two lines in space (the angular axis, and the orbital axis as
it stands at alpha = 0) of the pose at alpha = beta = 0; every rotation comes from SciPy. Everything is
in metres and radians.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from solvers.problem import Problem
from solvers.torus import Torus

NAMES = ("offset", "major_radius", "minor_radius", "non_orthogonality", "orbital_axis", "center", "angular_axis")


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


def machine_of(torus: Torus) -> Machine:
    """A solver's chain as a Machine, whose poses are written out independently."""
    return Machine(torus.T_world_torus, torus.major_radius, torus.non_orthogonality, torus.T_sensor_carm)


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
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
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


def joined(*motions: Motion) -> Motion:
    """Motions one after the other, their sweeps numbered on."""
    held, highest = [], 0
    for motion in motions:
        held.append(np.where(motion.held >= 0, motion.held + highest, -1))
        highest = max(highest, int(held[-1].max()) + 1)
    parts = (np.concatenate([getattr(m, name) for m in motions]) for name in ("angles", "label", "placement"))
    angles, label, placement = parts
    return Motion(angles, np.concatenate(held), label, placement)


def paper() -> Motion:
    """The protocol of Lee et al. 2020: 19 orbital and 9 angular full circles, 10,080 poses."""
    return sweeps_deg(range(-90, 91, 10), np.arange(360), range(0, 161, 20), np.arange(360))


def small(placement: int = 0) -> Motion:
    """Three orbital and two angular full circles of a dozen poses, 60 poses."""
    turn = np.arange(0, 360, 30)
    return sweeps_deg((-90, 0, 90), turn, (0, 70), turn, placement)


def wandering(n: int, seed: int = 0, arc_deg: float = 360.0, placement: int = 0) -> Motion:
    """Both joints on random angles within an arc; nothing is known."""
    angles = np.radians(arc_deg) * (np.random.default_rng([seed, 5]).random((n, 2)) - 0.5)
    return Motion(angles, np.full((n, 2), -1), np.full((n, 2), np.nan), np.full(n, placement))


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


def line_angle(u: np.ndarray, v: np.ndarray) -> float:
    """Angle between two lines, rad, exact for small ones."""
    return float(np.arctan2(np.linalg.norm(np.cross(u, v)), abs(u @ v)))


def crlb(truth: Machine, motion: Motion, sigma_t: float, sigma_r: float, epsilon_known: bool = False) -> np.ndarray:
    """Covariance (K, K) of `Machine.reported` by the Cramér-Rao bound, brute force.

    Central differences of the poses by every unknown, all angles that the recording does not give standing
    among the unknowns: one a sweep where a joint is held, one a pose where it moves. The pseudo-inverse
    passes over the zero of an angle that nothing gives, on which no reported quantity depends.
    """
    J_machine, J_angle = pose_jacobians(truth, motion)
    weight = np.repeat([1 / sigma_t, 1 / sigma_r], 3)[:, None]
    columns = [(J_machine * weight).reshape(6 * len(motion), -1)]
    if epsilon_known:
        columns[0] = np.delete(columns[0], 6 * len(truth.T_world_torus) + 1, axis=1)
    for joint in (0, 1):
        unknown = (motion.held[:, joint] < 0) | np.isnan(motion.label[:, joint])
        key = np.where(motion.held[:, joint] < 0, -1 - np.arange(len(motion)), motion.held[:, joint])
        for group in np.unique(key[unknown]):
            here = (key == group) & unknown
            columns.append((J_angle[:, :, [joint]] * weight * here[:, None, None]).reshape(-1, 1))
    J = np.concatenate(columns, axis=1)
    scale = np.linalg.norm(J, axis=0)
    C = np.linalg.pinv((J / scale).T @ (J / scale), rcond=1e-9, hermitian=True) / np.outer(scale, scale)
    K = _reported_jacobian(truth)
    if epsilon_known:
        K = np.delete(K, 6 * len(truth.T_world_torus) + 1, axis=1)
    machine_part = C[: K.shape[1], : K.shape[1]]
    return K @ machine_part @ K.T


def pose_jacobians(truth: Machine, motion: Motion, h: float = 1e-6) -> tuple[np.ndarray, np.ndarray]:
    """Change of the sensor's [position in the world, rotation vector in the sensor frame] by the unknowns
    (N, 6, 6 P + 8) and by the two angles (N, 6, 2), by central differences."""
    R0 = truth.poses(motion.angles, motion.placement)[1]

    def difference(plus, minus) -> np.ndarray:
        turn = [Rotation.from_matrix(np.swapaxes(R0, 1, 2) @ R).as_rotvec() for _, R in (plus, minus)]
        return np.concatenate([plus[0] - minus[0], turn[0] - turn[1]], axis=1) / (2 * h)

    size = 6 * len(truth.T_world_torus) + 8
    machine_part = [
        difference(*(truth.moved(s * h * e).poses(motion.angles, motion.placement) for s in (1, -1)))
        for e in np.eye(size)
    ]
    angle_part = [
        difference(*(truth.poses(motion.angles + s * h * e, motion.placement) for s in (1, -1))) for e in np.eye(2)
    ]
    return np.stack(machine_part, axis=2), np.stack(angle_part, axis=2)


def _reported_jacobian(truth: Machine, h: float = 1e-6) -> np.ndarray:
    size = 6 * len(truth.T_world_torus) + 8
    return np.stack(
        [(truth.moved(h * e).reported() - truth.moved(-h * e).reported()) / (2 * h) for e in np.eye(size)], axis=1
    )
