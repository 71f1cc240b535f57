"""The kinematics of any machine: joints in a tree, one path from the base to each sensor, everything an unknown.

    T_world_sensor = T_world_base A_1 M_1(q_1) ... A_k M_k(q_k) T_last_sensor

over the joints of the sensor's path, with placements A_j and motions M_j about or along the joints' axes,
q_j = (1 + gain_j) v_j + offset_j of the joint's value v_j. All transforms are perturbed on the right,
[v, w]. Metres and radians.
"""

from dataclasses import dataclass

import numpy as np

from solvers.se3 import Array, adjoint, exp_so3, inverse, log_so3, transform


@dataclass(frozen=True, eq=False)
class Machine:
    """J joints, P base placements, S sensors. Nothing is ever modified."""

    T_world_base: Array
    """(P, 4, 4)."""
    placements: Array
    """(J, 4, 4) each joint at zero in the frame of the joint before it on its path."""
    axes: Array
    """(J, 3) unit, in the joint's own frame."""
    prismatic: np.ndarray
    """(J,) whether the joint slides; else it turns."""
    paths: tuple[np.ndarray, ...]
    """S arrays of joint numbers, from the base to the sensor."""
    T_last_sensor: Array
    """(S, 4, 4) each sensor in the frame of the last joint of its path."""
    offsets: Array
    """(J,) rad or m."""
    gains: Array
    """(J,) relative."""

    def configurations(self, values: Array) -> Array:
        """q (N, J) of the joints' values (N, J)."""
        return self.offsets + (1 + self.gains) * values

    def poses(self, values: Array, placement: int, sensor: int) -> Array:
        """T_world_sensor (N, 4, 4) at the joints' values (N, J)."""
        T = self.T_world_base[placement]
        for j, M in zip(self.paths[sensor], self._motions(values, sensor), strict=True):
            T = T @ self.placements[j] @ M
        return T @ self.T_last_sensor[sensor]

    def _motions(self, values: Array, sensor: int) -> list[Array]:
        """M_j (N, 4, 4) of every joint of the path."""
        q, found = self.configurations(values), []
        for j in self.paths[sensor]:
            along = self.axes[j] * q[:, j, None]
            slides = self.prismatic[j]
            found.append(transform(np.eye(3), along) if slides else transform(exp_so3(along), np.zeros(3)))
        return found


@dataclass(frozen=True, eq=False)
class Linearised:
    """N poses of one sensor in one base placement: residuals, and the twists of the sensor in its own frame by the
    unknowns. A path of k joints."""

    residual: Array
    """(N, 6) observed less predicted: position in the predicted sensor frame, m, and rotation vector, rad."""
    by_base: Array
    """(N, 6, 6)."""
    by_placement: Array
    """(N, 6, k, 6) by the perturbation of each joint's placement."""
    by_motion: Array
    """(N, 6, k) by q."""


def linearise(machine: Machine, values: Array, observed: Array, placement: int, sensor: int) -> Linearised:
    """At the joints' values (N, J), for the ``observed`` T_world_sensor (N, 4, 4).

    Both noises are isotropic, so a change of the prediction by the twist x changes the residual by -x as far as
    the gradient and the Gauss-Newton matrix go.
    """
    path, n = machine.paths[sensor], len(observed)
    rest = np.broadcast_to(machine.T_last_sensor[sensor], (n, 4, 4))
    by_placement, by_motion = np.empty((n, 6, len(path), 6)), np.empty((n, 6, len(path)))
    motions = machine._motions(values, sensor)
    for k in range(len(path) - 1, -1, -1):
        j = path[k]
        rest = motions[k] @ rest
        to_sensor = adjoint(inverse(rest))
        by_placement[:, :, k] = to_sensor
        block = slice(0, 3) if machine.prismatic[j] else slice(3, 6)
        by_motion[:, :, k] = to_sensor[:, :, block] @ machine.axes[j]
        rest = machine.placements[j] @ rest
    predicted = machine.T_world_base[placement] @ rest
    R = predicted[:, :3, :3]
    off = np.einsum("nji,nj->ni", R, observed[:, :3, 3] - predicted[:, :3, 3])
    turned = log_so3(np.swapaxes(R, 1, 2) @ observed[:, :3, :3])
    return Linearised(np.concatenate([off, turned], axis=1), adjoint(inverse(rest)), by_placement, by_motion)
