"""The two-axis chain of a C-arm and the generalised torus on which its sensor moves.

    T_world_sensor(alpha, beta) = T_world_torus Rx(alpha) Tz(R) Rz(epsilon) Ry(beta) inv(T_sensor_carm)

The frames are those of docs/conventions.md: `torus` at the centre c with x = the angular axis n;
`carm` at the pivot with y = the orbital axis. The pivot is the foot of the common perpendicular of
the two axes on the orbital axis.
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers.problem import Problem
from solvers.se3 import Array, inverse, orthonormal_complement, rot_x, rot_y, rot_z, transform

SENSE_RADIUS_M = 1e-3
"""Above this major radius R >= 0 tells the direction of one axis from that of the other."""

NEAR = 8.9
"""Median deviations within which a labelled angle agrees with the others."""


@dataclass(frozen=True, eq=False)
class Torus:
    """Parameters of the two-axis chain, m and rad. Nothing is ever modified."""

    T_world_torus: Array
    """(P, 4, 4), one for each base placement."""
    major_radius: float
    """R, signed as it stands in the chain."""
    non_orthogonality: float
    """epsilon: the angular axis and the orbital axis enclose 90 degrees + epsilon."""
    T_sensor_carm: Array
    """(4, 4); its translation is the offset and its y axis the orbital axis."""
    referenced: np.ndarray
    """(P,) whether labels give the zero and the sense of alpha (else they are a convention)."""
    orbital_referenced: bool
    """Whether labels give the zero and the sense of beta (else they are a convention)."""

    @property
    def offset(self) -> Array:
        """t (3,): the pivot in sensor coordinates, m."""
        return self.T_sensor_carm[:3, 3]

    @property
    def orbital_axis(self) -> Array:
        """a (3,): the orbital axis in sensor coordinates, unit."""
        return self.T_sensor_carm[:3, 1]

    @property
    def center(self) -> Array:
        """c (P, 3): the torus centre in the world, m."""
        return self.T_world_torus[:, :3, 3]

    @property
    def angular_axis(self) -> Array:
        """n (P, 3): the angular axis in the world, unit."""
        return self.T_world_torus[:, :3, 0]

    @property
    def minor_radius(self) -> float:
        """b: the radius of the sensor's orbit about the orbital axis, m."""
        return float(np.linalg.norm(np.cross(self.offset, self.orbital_axis)))

    def poses(self, angles: Array, placement: np.ndarray) -> Array:
        """``T_world_sensor`` (N, 4, 4) at ``angles`` = alpha, beta (N, 2), rad."""
        return self.T_world_torus[placement] @ self.T_torus_carm(angles) @ inverse(self.T_sensor_carm)

    def T_torus_carm(self, angles: Array) -> Array:
        """Rx(alpha) Tz(R) Rz(epsilon) Ry(beta), (N, 4, 4)."""
        swivel = rot_x(angles[:, 0])
        return transform(
            swivel @ rot_z(self.non_orthogonality) @ rot_y(angles[:, 1]), self.major_radius * swivel[:, :, 2]
        )

    def angles(self, problem: Problem) -> Array:
        """alpha, beta (N, 2), rad, of each pose from its orientation alone.

        The y and x columns of R_torus_carm = Rx(alpha) Rz(epsilon) Ry(beta) carry them separately; the four
        entries that matter are linear in those of R_world_sensor.
        """
        R_sc, R = self.T_sensor_carm[:3, :3], problem.rotations.reshape(-1, 9)
        entries = np.empty((4, len(R)))
        for p, R_wt in enumerate(self.T_world_torus[:, :3, :3]):
            picked = np.einsum("ik,jk->kij", R_wt[:, [2, 1, 0, 0]], R_sc[:, [1, 1, 2, 0]]).reshape(4, 9)
            here = slice(None) if len(self.T_world_torus) == 1 else problem.placement == p
            entries[:, here] = picked @ R[here].T
        return np.arctan2(entries[[0, 2]], entries[[1, 3]]).T


@dataclass(frozen=True, eq=False)
class Axes:
    """The same chain without a zero for its angles: what poses alone determine."""

    center: Array
    """c (P, 3), m."""
    angular_axis: Array
    """n (P, 3), unit."""
    major_radius: float
    """<pivot - c, n x a>, m, signed by the directions of n and a."""
    non_orthogonality: float
    """sin(epsilon) = -<n, a>, rad."""
    offset: Array
    """t (3,), m."""
    orbital_axis: Array
    """a (3,), unit, in the sensor frame."""

    def torus(self, problem: Problem) -> Torus:
        """The chain with its zeros set by the labels where there are any, else by convention.

        Convention without labels: alpha = 0 and beta = 0 at the first pose of the placement, R >= 0,
        and alpha positive where it first lies well off both zero and half a turn (placement of the first pose).
        """
        axes = self if self.major_radius >= 0 else self.turned(1, -1)
        raw = axes._with_arbitrary_zeros()
        angles = raw.angles(problem)
        senses = [_sense(angles[:, j], problem.label[:, j], problem.placement if j == 0 else None) for j in (0, 1)]
        flips = _flips(senses, angles[problem.placement == problem.placement[0], 0])
        if flips != (1, 1):
            raw = axes.turned(*flips)._with_arbitrary_zeros()
            angles = raw.angles(problem)
        clear = abs(self.major_radius) > SENSE_RADIUS_M
        told = [senses[j] != 0 or (senses[1 - j] != 0 and clear) for j in (0, 1)]
        alpha, beta = problem.zero_labelled
        return replace(
            _with_zeros(raw, angles, problem),
            referenced=alpha & told[0],
            orbital_referenced=beta and told[1],
        )

    def turned(self, angular: int, orbital: int) -> "Axes":
        """The same two lines with the direction of n and of a multiplied by the given signs."""
        sign = angular * orbital
        return replace(
            self,
            angular_axis=angular * self.angular_axis,
            orbital_axis=orbital * self.orbital_axis,
            major_radius=sign * self.major_radius,
            non_orthogonality=sign * self.non_orthogonality,
        )

    def _with_arbitrary_zeros(self) -> Torus:
        x = self.angular_axis
        z = orthonormal_complement(x)[..., 0]
        R_world_torus = np.stack([x, np.cross(z, x), z], axis=-1)
        a = self.orbital_axis
        e = orthonormal_complement(a)[:, 0]
        R_sensor_carm = np.stack([e, a, np.cross(e, a)], axis=-1)
        return Torus(
            transform(R_world_torus, self.center),
            self.major_radius,
            self.non_orthogonality,
            transform(R_sensor_carm, self.offset),
            referenced=np.zeros(len(x), dtype=bool),
            orbital_referenced=False,
        )


def _sense(angle: Array, label: Array, placement: np.ndarray | None) -> int:
    """+1 or -1: whether the labels turn with or against the angles; 0 where they do not tell."""
    known = np.isfinite(label)
    if not known.any():
        return 0
    groups = np.zeros(known.sum(), dtype=int) if placement is None else placement[known]
    u, v = np.exp(1j * label[known]), np.exp(1j * angle[known])
    agreement = [sum(abs((u * w)[groups == g].sum()) for g in np.unique(groups)) for w in (v.conj(), v)]
    tie = abs(agreement[0] - agreement[1]) <= 1e-3 * known.sum()
    return 0 if tie else int(np.sign(agreement[0] - agreement[1]))


def _flips(senses: list[int], swivel: Array) -> tuple[int, int]:
    """Signs for n and a. One labelled joint fixes its own axis, and R >= 0 then fixes the other."""
    angular, orbital = senses
    if angular == orbital == 0:
        sine = np.sin(swivel - swivel[0])
        angular = 1 if sine[np.argmax(np.abs(sine) > 0.55 * np.abs(sine).max())] >= 0 else -1
    return angular or orbital, orbital or angular


def _with_zeros(raw: Torus, angles: Array, problem: Problem) -> Torus:
    """The chain whose angles are the labels, or zero at the first pose."""
    T_world_torus = raw.T_world_torus.copy()
    for p in range(len(T_world_torus)):
        here = problem.placement == p
        zero = _zero(angles[here, 0], problem.label[here, 0])
        T_world_torus[p, :3, :3] = T_world_torus[p, :3, :3] @ rot_x(zero)
    T_sensor_carm = raw.T_sensor_carm.copy()
    T_sensor_carm[:3, :3] = T_sensor_carm[:3, :3] @ rot_y(-_zero(angles[:, 1], problem.label[:, 1]))
    return replace(raw, T_world_torus=T_world_torus, T_sensor_carm=T_sensor_carm)


def _zero(angle: Array, label: Array) -> float:
    """The angle at which the labelled joint stands at zero; without labels, that of the first pose."""
    known = np.isfinite(label)
    if not known.any():
        return float(angle[0]) if len(angle) else 0.0
    off = angle[known] - label[known]
    about = float(np.angle(np.exp(1j * off).sum()))
    off = np.angle(np.exp(1j * (off - about)))
    return about + float(off[near_median(off)].mean())


def near_median(values: Array) -> np.ndarray:
    """Mask of the ``values`` (N,) within `NEAR` median deviations of their median, 6 sigma for normal ones."""
    off = np.abs(values - np.median(values))
    return off <= NEAR * np.median(off) + np.finfo(float).eps


def surface_point(angles: Array, major_radius: float, minor_radius: float, gamma: float, t_y: float) -> Array:
    """The generalised torus g(alpha, beta) (N, 3) in the torus frame, for epsilon = 0 (Eq. 5 of the
    paper, in a form that stays smooth where b cos(beta + gamma) + R = 0).

    ``angles`` (N, 2) in rad, lengths in m; ``t_y`` is the sensor's coordinate along the orbital axis.
    """
    alpha, phi = angles[:, 0], angles[:, 1] + gamma
    u = minor_radius * np.cos(phi) + major_radius
    x = minor_radius * np.sin(phi)
    return np.stack([x, t_y * np.cos(alpha) - u * np.sin(alpha), t_y * np.sin(alpha) + u * np.cos(alpha)], axis=1)
