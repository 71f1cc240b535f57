"""The rotation centre as a function of the joints' angles, where the C bends: at nodes, and between them."""

from dataclasses import dataclass

import numpy as np

from solvers.se3 import Array, exp_so3

EDGE_RAD = float(np.radians(1.0))
"""Beyond a calibrated range, up to which an angle still counts as within."""


@dataclass(frozen=True, eq=False)
class DeformationNode:
    """At one pair of angles."""

    alpha_rad: float
    beta_rad: float
    shift_sensor_pivot_m: Array
    """(3,) of the rotation centre in the sensor's frame, from `CalibrationResult.offset_sensor_pivot_m`."""
    turn_sensor_carm_rad: Array
    """(3,) rotation vector of the C-arm frame in the sensor's frame, from that of `T_sensor_carm`."""
    sigma_offset_sensor_pivot_m: Array
    """(3,) one standard deviation of the offset at these angles."""


@dataclass(frozen=True, eq=False)
class Deformation:
    """How the C bends over both angles, as the calibration found it. Beyond its ranges the ± grows."""

    alpha_range_rad: tuple[float, ...]
    """Least and greatest calibrated angle."""
    beta_range_rad: tuple[float, ...]
    nodes: tuple[DeformationNode, ...]
    """On a grid of both angles, beta running faster."""

    @property
    def alpha_rad(self) -> Array:
        """(A,) angles of the grid, rising."""
        return np.unique([node.alpha_rad for node in self.nodes])

    @property
    def beta_rad(self) -> Array:
        """(B,)."""
        return np.unique([node.beta_rad for node in self.nodes])

    def shift_m(self, alpha_rad: Array, beta_rad: Array) -> Array:
        """(N, 3) of the rotation centre in the sensor's frame at angles (N,)."""
        return self._between("shift_sensor_pivot_m", alpha_rad, beta_rad)

    def sigma_m(self, alpha_rad: Array, beta_rad: Array) -> Array:
        """(N, 3) one standard deviation of the offset at angles (N,)."""
        return self._between("sigma_offset_sensor_pivot_m", alpha_rad, beta_rad)

    def T_sensor_carm(self, T_sensor_carm: Array, alpha_rad: Array, beta_rad: Array) -> Array:
        """(N, 4, 4), m, at angles (N,), from the mean one (4, 4)."""
        T = np.tile(T_sensor_carm, (len(alpha_rad), 1, 1))
        T[:, :3, :3] = exp_so3(self._between("turn_sensor_carm_rad", alpha_rad, beta_rad)) @ T[:, :3, :3]
        T[:, :3, 3] += self.shift_m(alpha_rad, beta_rad)
        return T

    def extrapolated(self, alpha_rad: Array, beta_rad: Array) -> np.ndarray:
        """(N,) mask of the angles outside the calibrated ranges."""
        ranges = (alpha_rad, np.array(self.alpha_range_rad)), (beta_rad, np.array(self.beta_range_rad))
        outside = [np.abs(_about(angle, x) - x.mean()) > np.ptp(x) / 2 + EDGE_RAD for angle, x in ranges]
        return outside[0] | outside[1]

    def _between(self, name: str, alpha_rad: Array, beta_rad: Array) -> Array:
        """Bilinear; beyond the nodes the value of the last one."""
        grids, index, share = (self.alpha_rad, self.beta_rad), [], []
        for angle, nodes in zip((alpha_rad, beta_rad), grids, strict=True):
            x = np.clip(_about(angle, nodes[[0, -1]]), nodes[0], nodes[-1])
            k = np.clip(np.searchsorted(nodes, x) - 1, 0, len(nodes) - 2)
            index.append(k)
            share.append(((x - nodes[k]) / (nodes[k + 1] - nodes[k]))[:, None])
        values = np.array([getattr(node, name) for node in self.nodes]).reshape(len(grids[0]), len(grids[1]), 3)
        (i, j), (s, t) = index, share
        near = (1 - t) * values[i, j] + t * values[i, j + 1]
        far = (1 - t) * values[i + 1, j] + t * values[i + 1, j + 1]
        return (1 - s) * near + s * far


def _about(angle: Array, low_high: Array) -> Array:
    """Angles within half a turn of the middle of a range."""
    middle = low_high.mean()
    return middle + np.angle(np.exp(1j * (angle - middle)))
