"""The rotation centre as a function of the joints' angles, where the C bends: at nodes, and between them."""

from dataclasses import dataclass

import numpy as np

from solvers.se3 import Array, exp_so3, inverse

EDGE_RAD = float(np.radians(1.0))
"""Beyond a calibrated range, up to which an angle still counts as within."""
LENGTH_RAD = 1.5
"""Over which a deformation changes (docs/estimation.md, systematic effects)."""


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
        """(N, 3) one standard deviation of the offset at angles (N,).

        At a distance d beyond the last node it grows by what a process of the size s of the shifts, rms, and of
        `LENGTH_RAD` l makes of the way there: 2 s² (1 - exp(-d² / 2 l²)).
        """
        last = self._between("sigma_offset_sensor_pivot_m", alpha_rad, beta_rad)
        d = [x - np.clip(x, nodes[0], nodes[-1]) for x, nodes in self._on_grid(alpha_rad, beta_rad)]
        square = np.mean([node.shift_sensor_pivot_m**2 for node in self.nodes], axis=0)
        return np.sqrt(last**2 - 2 * square * np.expm1(-(d[0] ** 2 + d[1] ** 2) / (2 * LENGTH_RAD**2))[:, None])

    def T_sensor_carm(self, T_sensor_carm: Array, alpha_rad: Array, beta_rad: Array) -> Array:
        """(N, 4, 4), m, at angles (N,), from the mean one (4, 4)."""
        T = np.tile(T_sensor_carm, (len(alpha_rad), 1, 1))
        T[:, :3, :3] = exp_so3(self._between("turn_sensor_carm_rad", alpha_rad, beta_rad)) @ T[:, :3, :3]
        T[:, :3, 3] += self.shift_m(alpha_rad, beta_rad)
        return T

    def unbent(self, T_world_sensor: Array, T_sensor_carm: Array, alpha_rad: Array, beta_rad: Array) -> Array:
        """(N, 4, 4), m, where the sensor would be at poses (N, 4, 4) and angles (N,), did the C not bend; the mean
        ``T_sensor_carm`` (4, 4) is its mount then."""
        return T_world_sensor @ self.T_sensor_carm(T_sensor_carm, alpha_rad, beta_rad) @ inverse(T_sensor_carm)

    @property
    def variance_within(self) -> Array:
        """(3,) m², mean variance of the offset over the nodes in the calibrated ranges."""
        inside = ~self.extrapolated(*np.array([[node.alpha_rad, node.beta_rad] for node in self.nodes]).T)
        sigma = np.array([node.sigma_offset_sensor_pivot_m for node in self.nodes])
        return (sigma[inside] ** 2).mean(axis=0)

    @property
    def walk_m(self) -> float:
        """Greatest distance between two places of the rotation centre in the sensor's frame, over the grid."""
        shift = np.array([node.shift_sensor_pivot_m for node in self.nodes])
        return float(np.linalg.norm(shift[:, None] - shift, axis=2).max())

    @property
    def ranges(self) -> str:
        """The calibrated angles in words."""
        pairs = (("alpha", self.alpha_range_rad), ("beta", self.beta_range_rad))
        return ", ".join(f"{name} {np.degrees(x[0]):.0f} to {np.degrees(x[1]):.0f} deg" for name, x in pairs)

    def extrapolated(self, alpha_rad: Array, beta_rad: Array) -> np.ndarray:
        """(N,) mask of the angles outside the calibrated ranges."""
        ranges = (alpha_rad, np.array(self.alpha_range_rad)), (beta_rad, np.array(self.beta_range_rad))
        outside = [np.abs(_about(angle, x) - x.mean()) > np.ptp(x) / 2 + EDGE_RAD for angle, x in ranges]
        return outside[0] | outside[1]

    def _between(self, name: str, alpha_rad: Array, beta_rad: Array) -> Array:
        """Bilinear; beyond the nodes the value of the last one."""
        index, share = [], []
        for angle, nodes in self._on_grid(alpha_rad, beta_rad):
            x = np.clip(angle, nodes[0], nodes[-1])
            k = np.clip(np.searchsorted(nodes, x) - 1, 0, len(nodes) - 2)
            index.append(k)
            share.append(((x - nodes[k]) / (nodes[k + 1] - nodes[k]))[:, None])
        values = np.array([getattr(node, name) for node in self.nodes]).reshape(len(self.alpha_rad), -1, 3)
        (i, j), (s, t) = index, share
        near = (1 - t) * values[i, j] + t * values[i, j + 1]
        far = (1 - t) * values[i + 1, j] + t * values[i + 1, j + 1]
        return (1 - s) * near + s * far

    def _on_grid(self, alpha_rad: Array, beta_rad: Array) -> tuple[tuple[Array, Array], ...]:
        """Both angles (N,) within half a turn of the middle of their nodes, and these."""
        pairs = ((alpha_rad, self.alpha_rad), (beta_rad, self.beta_rad))
        return tuple((_about(angle, nodes[[0, -1]]), nodes) for angle, nodes in pairs)


def _about(angle: Array, low_high: Array) -> Array:
    """Angles within half a turn of the middle of a range."""
    middle = low_high.mean()
    return middle + np.angle(np.exp(1j * (angle - middle)))
