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
        T = self.T_world_base[placement] @ self.frames(values, sensor)[1]
        return np.broadcast_to(T, (len(values), 4, 4))

    def frames(self, values: Array, sensor: int) -> tuple[list[Array], Array]:
        """T_base_joint of every joint of the path before its own motion, and T_base_sensor, at the values (N, J).

        Each is (N, 4, 4), or (1, 4, 4) where the joints before it stand at one and the same value.
        """
        q, T, found = self.configurations(values), np.eye(4)[None], []
        for j in self.paths[sensor]:
            T = T @ self.placements[j]
            found.append(T)
            still = len(q) and (q[:, j] == q[0, j]).all()
            T = T @ self._motion(j, q[: 1 if still else len(q), j])
        return found, T @ self.T_last_sensor[sensor]

    def _motion(self, joint: int, q: Array) -> Array:
        """M_j (N, 4, 4) at q (N,)."""
        along = self.axes[joint] * q[:, None]
        return transform(np.eye(3), along) if self.prismatic[joint] else transform(exp_so3(along), np.zeros(3))


@dataclass(frozen=True, eq=False)
class Linearised:
    """N poses of one sensor in one base placement: residuals, and the twists of the sensor in its own frame by the
    unknowns, each (N, 6, columns).

    Both noises are isotropic, so a change of the prediction by the twist x changes the residual by -x as far as
    the gradient and the Gauss-Newton matrix go.
    """

    machine: Machine
    path: np.ndarray
    """(k,) joints from the base to the sensor."""
    residual: Array
    """(N, 6) observed less predicted: position in the predicted sensor frame, m, and rotation vector, rad."""
    T_sensor_base: Array
    """(N, 4, 4)."""
    T_base_joint: tuple[Array, ...]
    """k of (N, 4, 4) or (1, 4, 4): the joints of the path before their own motions."""

    def by_base(self) -> Array:
        """(N, 6, 6) by the perturbation of the base in the world."""
        return adjoint(self.T_sensor_base)

    def by_placement(self, k: int) -> Array:
        """(N, 6, 6) by the perturbation of the placement of the path's k-th joint."""
        return adjoint(self.T_sensor_base @ self.T_base_joint[k])

    def by_motion(self, k: int) -> Array:
        """(N, 6) by q of the path's k-th joint."""
        axis = self.machine.axes[self.path[k]]
        T = self.T_sensor_base @ self.T_base_joint[k]
        along = T[:, :3, :3] @ axis
        if self.machine.prismatic[self.path[k]]:
            return np.concatenate([along, np.zeros_like(along)], axis=1)
        return np.concatenate([np.cross(T[:, :3, 3], along), along], axis=1)


def linearise(machine: Machine, values: Array, observed: Array, placement: int, sensor: int) -> Linearised:
    """At the joints' values (N, J), for the ``observed`` T_world_sensor (N, 4, 4)."""
    frames, T_base_sensor = machine.frames(values, sensor)
    T_base_sensor = np.broadcast_to(T_base_sensor, (len(values), 4, 4))
    residual = pose_residual(machine.T_world_base[placement] @ T_base_sensor, observed)
    return Linearised(machine, machine.paths[sensor], residual, inverse(T_base_sensor), tuple(frames))


def pose_residual(predicted: Array, observed: Array) -> Array:
    """(N, 6) of T_world_sensor (N, 4, 4): position in the predicted sensor frame, m, and rotation vector, rad."""
    R = predicted[:, :3, :3]
    off = np.einsum("nji,nj->ni", R, observed[:, :3, 3] - predicted[:, :3, 3])
    return np.concatenate([off, log_so3(np.swapaxes(R, 1, 2) @ observed[:, :3, :3])], axis=1)
