"""The likelihood of the two-axis chain, linearised, with every joint angle eliminated.

Each pose gives six residuals, written in the carm frame of the prediction: position (m), then
rotation vector (rad). Both noises are isotropic, so the frame does not matter, and this one makes
most columns of the Jacobian constant or a row of one rotation. The unknowns are

    [torus v, torus w] for each placement, R, epsilon, [sensor mount v, sensor mount w]

with right perturbations of ``T_world_torus`` and ``T_sensor_carm``. The angles are nuisance: those
of single poses are eliminated pose by pose, those of held sweeps sweep by sweep (Schur complements
of 1x1 and 2x2 blocks), so that a step costs O(N). Arrays run over poses in their last axis.
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers.problem import NoiseShape, Problem
from solvers.se3 import Array, exp_se3, inverse, log_so3_small
from solvers.torus import Torus

LOCAL = 14
"""Unknowns that one pose sees: torus (6), R, epsilon, mount (6)."""
TORUS_ROLL, MOUNT_ROLL = 3, 4
"""Where the zero of alpha stands within a torus, and the zero of beta within the mount."""


@dataclass(frozen=True, eq=False)
class AngleModel:
    """Which angles are unknown: by pose, by sweep, or not at all."""

    free: np.ndarray
    """(2, N) the joint's angle is an unknown of this pose alone."""
    sweep: np.ndarray
    """(N,) number of the sweep whose held angle is unknown, -1 where there is none."""
    sweep_joint: np.ndarray
    """(N,) which joint that sweep holds."""
    sweep_placement: np.ndarray
    """(S,) the base placement of each such sweep."""
    sweep_first: np.ndarray
    """(S,) its first pose in the whole problem."""
    sweep_label: Array
    """(S,) the label of its held angle, rad; 0 where there is none."""
    sweep_precision: Array
    """(S,) 1 / variance of that label; 0 where there is none."""
    reading: Array
    """(2, N) reading of a moving joint, rad; 0 where there is none."""
    precision: Array
    """(2, N) 1 / variance of the reading; 0 where there is none."""
    scale: Array | None
    """(2, N) `Problem.scale`."""
    shape: NoiseShape | None
    """`Problem.shape`."""

    @staticmethod
    def of(problem: Problem) -> "AngleModel":
        """A joint held without an exact label is unknown once a sweep; one that moves or slips, at every pose."""
        known = np.isfinite(problem.label) & ~problem.label_read
        held = problem.still.copy()
        held[:, 1] &= ~held[:, 0]
        unknown = held & ~known
        joint = np.where(unknown[:, 1], 1, 0)
        member = unknown.any(axis=1)
        key = problem.held[np.arange(len(problem)), joint] * 2 + joint
        sweep = np.full(len(problem), -1)
        first, sweep[member] = np.unique(key[member], return_index=True, return_inverse=True)[1:]
        moving = ~problem.still
        moving[:, 1] |= problem.still.all(axis=1) & ~known[:, 1]
        reading = known & moving
        label, precision = _sweep_labels(problem, sweep, joint, len(first))
        return AngleModel(
            free=moving.T,
            sweep=sweep,
            sweep_joint=joint,
            sweep_placement=problem.placement[member][first],
            sweep_first=np.flatnonzero(member)[first],
            sweep_label=label,
            sweep_precision=precision,
            reading=np.where(reading, problem.label, 0.0).T,
            precision=reading.T / problem.sigma_reading**2,
            scale=problem.scale,
            shape=problem.shape,
        )

    def select(self, poses: slice) -> "AngleModel":
        """The model of a block of poses; the sweeps keep their numbers."""
        return replace(
            self,
            free=self.free[:, poses],
            sweep=self.sweep[poses],
            sweep_joint=self.sweep_joint[poses],
            reading=self.reading[:, poses],
            precision=self.precision[:, poses],
            scale=None if self.scale is None else self.scale[:, poses],
        )

    def start(self, torus: Torus, problem: Problem, trusted: np.ndarray | None = None) -> Array:
        """alpha, beta (2, N): from the orientations, constant in a held sweep (the mean over its ``trusted``
        poses (N,)), the label where it is exact; of a labelled sweep within half a turn of the label."""
        angles = torus.angles(problem).T
        poses = np.flatnonzero(self.sweep >= 0)
        joint, sweep = self.sweep_joint[poses], self.sweep[poses]
        weight = 1.0 if trusted is None else np.where(trusted[poses], 1.0, 1e-9)
        total = np.zeros(len(self.sweep_placement), dtype=complex)
        np.add.at(total, sweep, weight * np.exp(1j * angles[joint, poses]))
        held = np.angle(total)
        held = np.where(self.sweep_precision > 0, self.sweep_label + _wrapped(held - self.sweep_label), held)
        angles[joint, poses] = held[sweep]
        exact = np.isfinite(problem.label.T) & ~self.free & ~problem.label_read.T
        return np.where(exact, problem.label.T, angles)

    def reading_error(self, angles: Array) -> Array:
        """(2, N) angle less reading, wrapped to a half turn; 0 where there is no reading."""
        if not self.precision.any():
            return np.zeros_like(angles)
        return np.where(self.precision > 0, _wrapped(angles - self.reading), 0.0)

    def label_error(self, angles: Array) -> Array:
        """(S,) held angle less label, wrapped to a half turn, of ``angles`` (2, N) of the whole problem; 0 where there
        is no label."""
        held = angles[self.sweep_joint[self.sweep_first], self.sweep_first]
        return np.where(self.sweep_precision > 0, _wrapped(held - self.sweep_label), 0.0)


def _sweep_labels(problem: Problem, sweep: np.ndarray, joint: np.ndarray, sweeps: int) -> tuple[Array, Array]:
    """(S,) mean label of each sweep and 1 / its variance, 0 where it has none."""
    if problem.sigma_label is None:
        return np.zeros(sweeps), np.zeros(sweeps)
    n = np.arange(len(sweep))
    poses = np.flatnonzero((sweep >= 0) & problem.label_read[n, joint])
    members, here = sweep[poses], (poses, joint[poses])
    count = np.maximum(np.bincount(members, minlength=sweeps), 1)
    label = np.bincount(members, problem.label[here], sweeps) / count
    return label, np.bincount(members, problem.sigma_label[here] ** -2.0, sweeps) / count


def _wrapped(angle: Array) -> Array:
    return np.angle(np.exp(1j * angle))


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Residuals and their derivatives at one set of parameters, in m and rad, not yet weighted.

    Six rows: position, then rotation vector; three where only positions were recorded.
    """

    residual: Array
    """(6, N) observed less predicted, in the carm frame."""
    by_angle: Array
    """(6, 2, N) derivative by alpha and beta."""
    by_local: Array
    """(6, 14, N) derivative by the unknowns that the pose sees."""
    R_world_carm: Array | None = None
    """(3, 3, N) where the problem has a `NoiseShape`."""


def _rotation(epsilon: float, sine: Array, cosine: Array) -> Array:
    """Q = Rx(alpha) Rz(epsilon) Ry(beta) as (3, 3, N), from the sines and cosines (2, N) of both angles."""
    (sa, sb), (ca, cb) = sine, cosine
    ce, se = np.cos(epsilon), np.sin(epsilon)
    Q = np.empty((3, 3, len(sa)))
    Q[0] = ce * cb, np.full_like(ca, -se), ce * sb
    Q[1] = ca * se * cb + sa * sb, ca * ce, ca * se * sb - sa * cb
    Q[2] = sa * se * cb - ca * sb, sa * ce, sa * se * sb + ca * cb
    return Q


def _position_residual(torus: Torus, m: tuple[Array, Array], problem: Problem, Q: Array) -> Array:
    """(3, N) observed less predicted position in the carm frame, m; ``m`` is the pivot's y and z in the torus frame."""
    p = problem.p_world_sensor - torus.center[problem.placement]
    R_world_torus = torus.T_world_torus[:, :3, :3]
    if len(R_world_torus) == 1:
        p_torus = (p @ R_world_torus[0]).T
    else:
        p_torus = np.einsum("nji,nj->in", R_world_torus[problem.placement], p)
    p_torus[1:] -= m
    return np.einsum("jin,jn->in", Q, p_torus) - inverse(torus.T_sensor_carm)[:3, 3, None]


def _rotation_residual(torus: Torus, problem: Problem, Q: Array) -> Array:
    """(3, N) rotation vector from the predicted to the observed orientation in the carm frame, rad."""
    R_world_torus, R_sensor_carm = torus.T_world_torus[:, :3, :3], torus.T_sensor_carm[:3, :3]
    flat = problem.rotations.reshape(-1, 9)
    if len(R_world_torus) == 1:
        observed = np.einsum("ji,lk->ikjl", R_world_torus[0], R_sensor_carm).reshape(9, 9) @ flat.T
    else:
        turned = np.einsum("nji,njk->nik", R_world_torus[problem.placement], problem.rotations)
        observed = np.kron(np.eye(3), R_sensor_carm.T) @ turned.reshape(-1, 9).T
    W = observed.reshape(3, 3, -1)
    E = (Q[:, :, None] * W[:, None]).sum(axis=0)
    return log_so3_small(np.moveaxis(E, -1, 0)).T


def linearise(torus: Torus, angles: Array, problem: Problem) -> Linearisation:
    """Residuals and Jacobian at ``angles`` (2, N).

    Each unknown moves the sensor by a twist (v, w) of the carm, which changes the prediction by
    v + w x q and w, with q the sensor in the carm frame.
    """
    sine, cosine = np.sin(angles), np.cos(angles)
    Q = _rotation(torus.non_orthogonality, sine, cosine)
    q = inverse(torus.T_sensor_carm)[:3, 3]
    n = len(problem)
    m_y, m_z = -torus.major_radius * sine[0], torus.major_radius * cosine[0]
    J = np.empty((6, LOCAL, n))
    turned = J[3:, 3:6]
    np.negative(Q.swapaxes(0, 1), out=turned)
    J[:3, 0:3] = turned
    J[3:, 0:3] = J[3:, 6] = J[3:, 8:11] = 0
    J[:3, 3:6] = _cross(turned, q)
    J[:3, 3] += m_z * Q[1] - m_y * Q[2]
    J[:3, 4] -= m_z * Q[0]
    J[:3, 5] += m_y * Q[0]
    J[:3, 6] = J[3:, 7] = sine[1], np.zeros(n), -cosine[1]
    J[:3, 7] = _cross(J[3:, 7], q)
    J[:3, 8:11] = J[3:, 11:14] = np.eye(3)[:, :, None]
    J[:3, 11:14] = np.cross(np.eye(3), q).T[:, :, None]
    A = np.empty((6, 2, n))
    A[:, 0] = J[:, 3]
    A[:, 1] = np.array([-q[2], 0, q[0], 0, -1, 0])[:, None]
    position = _position_residual(torus, (m_y, m_z), problem, Q)
    if problem.R_world_sensor is None:
        return Linearisation(position, A[:3], J[:3])
    R_world_carm = None
    if problem.shape is not None:
        R_world_carm = np.einsum("nij,jkn->ikn", torus.T_world_torus[problem.placement, :3, :3], Q)
    return Linearisation(np.concatenate([position, _rotation_residual(torus, problem, Q)]), A, J, R_world_carm)


def _cross(w: Array, q: Array) -> Array:
    """w x q for w (3, ...) and one q (3,)."""
    return np.stack([w[1] * q[2] - w[2] * q[1], w[2] * q[0] - w[0] * q[2], w[0] * q[1] - w[1] * q[0]])


def retract(torus: Torus, step: Array) -> Torus:
    """The chain moved by ``step`` (6 P + 8,), m and rad."""
    split = 6 * len(torus.T_world_torus)
    return replace(
        torus,
        T_world_torus=torus.T_world_torus @ exp_se3(step[:split].reshape(-1, 6)),
        major_radius=torus.major_radius + float(step[split]),
        non_orthogonality=torus.non_orthogonality + float(step[split + 1]),
        T_sensor_carm=torus.T_sensor_carm @ exp_se3(step[split + 2 :]),
    )
