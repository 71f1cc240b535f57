"""Bases and mounts in closed form: X_p F_i Y_s = T_i for poses T_i and known kinematics F_i.

Rotations by the Kronecker product (Shah, J. Mechanisms Robotics 5, 2013): sum_i kron(R_i, F_i) has the leading
singular vectors vec(X) and vec(YT). Translations are linear then. Poses that disagree are left out by their median.
"""

from dataclasses import dataclass

import numpy as np

from solvers.estimate import Note
from solvers.se3 import Array, inverse, log_so3, project_so3, transform
from solvers.torus import near_median

ROUNDS = 8
LEAST_ROTATION = 1e-3
"""Least ratio of the second to the first singular value by which one axis is told from two."""


@dataclass(frozen=True, eq=False)
class RobotWorld:
    """P bases, S mounts."""

    T_world_base: Array
    """(P, 4, 4)."""
    T_last_sensor: Array
    """(S, 4, 4)."""
    agrees: np.ndarray
    """(N,) mask of the poses that were believed."""


def robot_world(
    T: Array, F: Array, placement: np.ndarray, sensor: np.ndarray, placements: int, sensors: int
) -> RobotWorld | Note:
    """From T_world_sensor (N, 4, 4) and T_base_last (N, 4, 4) of so many base placements and sensors; a refusal where
    they turn about one axis only, or a base or a mount is linked to no other."""
    found: RobotWorld | Note = RobotWorld(np.eye(4)[None], np.eye(4)[None], np.ones(len(T), dtype=bool))
    for _ in range(ROUNDS):
        believed = found.agrees
        found = _fitted(T, F, placement, sensor, (placements, sensors), believed)
        if isinstance(found, Note) or (found.agrees == believed).all():
            break
    return found


def _fitted(
    T: Array, F: Array, placement: np.ndarray, sensor: np.ndarray, counts: tuple[int, int], believed: np.ndarray
) -> RobotWorld | Note:
    """From the ``believed`` (N,) poses alone, and which of all agree with that."""
    rotations = _rotations(T[believed], F[believed], placement[believed], sensor[believed], *counts)
    if isinstance(rotations, Note):
        return rotations
    X, Y = _with_translations(*rotations, T[believed], F[believed], placement[believed], sensor[believed])
    off = inverse(X[placement] @ F @ Y[sensor]) @ T
    agrees = near_median(np.linalg.norm(off[:, :3, 3], axis=1))
    return RobotWorld(X, Y, agrees & near_median(np.linalg.norm(log_so3(off[:, :3, :3]), axis=1)))


def _rotations(
    T: Array, F: Array, placement: np.ndarray, sensor: np.ndarray, P: int, S: int
) -> tuple[Array, Array] | Note:
    """Of all bases (P, 3, 3) and mounts (S, 3, 3), spread from the pair that determines them best."""
    members = {(p, s): (placement == p) & (sensor == s) for p in range(P) for s in range(S)}
    members = {pair: here for pair, here in members.items() if here.any()}
    pairs = {pair: _pair(T[here, :3, :3], F[here, :3, :3]) for pair, here in members.items()}
    (p, s), best = max(pairs.items(), key=lambda item: item[1].gap)
    if best.gap < LEAST_ROTATION * members[p, s].sum():
        return Note("one_axis_only", "the sensor turns about one axis only: where base and sensor stand is unknown")
    X, Y = {p: best.X}, {s: best.Y}
    while len(X) < P or len(Y) < S:
        links = [pair for pair in members if (pair[0] in X) != (pair[1] in Y)]
        if not links:
            words = "nothing links all placements and sensors: some share no sensor and no placement with the others"
            return Note("unobservable", words)
        p, s = max(links, key=lambda pair: members[pair].sum())
        R, K = T[members[p, s], :3, :3], F[members[p, s], :3, :3]
        if p in X:
            Y[s] = project_so3((np.swapaxes(X[p] @ K, 1, 2) @ R).sum(axis=0))
        else:
            X[p] = project_so3((R @ np.swapaxes(K @ Y[s], 1, 2)).sum(axis=0))
    return np.array([X[p] for p in range(P)]), np.array([Y[s] for s in range(S)])


@dataclass(frozen=True, eq=False)
class _Pair:
    """One base and one mount."""

    X: Array
    Y: Array
    gap: float
    """By how much the best solution stands out, at most the number of poses."""


def _pair(R: Array, F: Array) -> _Pair:
    """X and Y (3, 3) with X F_i Y = R_i."""
    N = np.einsum("nab,ncd->acbd", R, F).reshape(9, 9)
    u, values, vt = np.linalg.svd(N)
    X, Yt = u[:, 0].reshape(3, 3), vt[0].reshape(3, 3)
    sign = np.sign(np.linalg.det(X))
    return _Pair(project_so3(sign * X), project_so3(sign * Yt).T, float(values[0] - values[1]))


def _with_translations(
    X: Array, Y: Array, T: Array, F: Array, placement: np.ndarray, sensor: np.ndarray
) -> tuple[Array, Array]:
    """Transforms (P, 4, 4) and (S, 4, 4): p_i = X_p (F_i y_s + f_i) + x_p by linear least squares."""
    P, S, n = len(X), len(Y), len(T)
    A = np.zeros((n, 3, 3 * (P + S)))
    base, mount = 3 * placement[:, None] + np.arange(3), 3 * (P + sensor[:, None]) + np.arange(3)
    A[np.arange(n)[:, None], np.arange(3), base] = 1
    np.put_along_axis(A, np.broadcast_to(mount[:, None], (n, 3, 3)), X[placement] @ F[:, :3, :3], axis=2)
    b = T[:, :3, 3] - np.einsum("nij,nj->ni", X[placement], F[:, :3, 3])
    x = np.linalg.lstsq(A.reshape(-1, A.shape[-1]), b.ravel(), rcond=1e-10)[0].reshape(-1, 3)
    return transform(X, x[:P]), transform(Y, x[P:])
