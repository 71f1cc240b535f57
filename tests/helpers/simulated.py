"""What the tests of the solvers share beyond `carm_kin.testing.truth`: protocols, and the bound of Cramér and Rao."""

import numpy as np
from scipy.spatial.transform import Rotation

from carm_kin.testing.truth import Machine, Motion, frame, machine, problem, rigid, shuffled, sweeps_deg
from solvers.torus import Torus

__all__ = [
    "NAMES",
    "Machine",
    "Motion",
    "crlb",
    "frame",
    "joined",
    "line_angle",
    "machine",
    "machine_of",
    "paper",
    "pose_jacobians",
    "problem",
    "rigid",
    "shuffled",
    "small",
    "sweeps_deg",
    "wandering",
]

NAMES = ("offset", "major_radius", "minor_radius", "non_orthogonality", "orbital_axis", "center", "angular_axis")


def machine_of(torus: Torus) -> Machine:
    """A solver's chain as a Machine, whose poses are written out independently."""
    return Machine(torus.T_world_torus, torus.major_radius, torus.non_orthogonality, torus.T_sensor_carm)


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
