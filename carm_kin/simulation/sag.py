"""The C sags under the weight of detector and source: by how much, as a function of the angles and of the vertical.

The C is an arc (`carm_kin.simulation.beam`) about the pivot, through the sensor's foot in the plane across the orbital
axis. Its carrier grips it where the first axis meets the arc, on the side from which the sensor is farther. The weight
of the detector acts at the sensor's foot, the same weight of the source opposite. The arc bends between the carrier
and its end, a little beyond the detector, and the carrier turns in proportion to the moment of both weights.

At given angles all this is linear in the vertical as seen from the C. But the C slides in its carrier: its free part
grows and shrinks with beta. Where the range of beta leaves no arc for that (rings, robots), the carrier turns with it.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from carm_kin.errors import InputError
from carm_kin.machine.chain import Chain, NominalGeometry
from carm_kin.results.deformation import Deformation, DeformationNode
from carm_kin.simulation.beam import Arc
from carm_kin.simulation.protocols import joint_range
from solvers.se3 import Array, exp_so3, inverse, log_so3, rot_x, rot_y, rot_z

BEYOND_RAD = float(np.radians(15.0))
"""How far the C goes on beyond the sensor's foot."""
CARRIER = 0.3
"""Yield of the carrier to a unit moment, in that of an arc of one radius' length in its plane."""
LEAST_RADIUS_M = 0.05
"""A sensor nearer to the orbital axis rides on no arc."""
LEAST_SHARE = 1e-9
"""A smaller peak, in that of a horizontal C, is none."""
STEPS = 13
"""Of a grid over either angle's range."""


@dataclass(frozen=True, eq=False)
class Sag:
    """What the weight does to one C. m, rad."""

    T_sensor_carm: Array
    """(4, 4) that is true in the mean."""
    arc: Arc
    grip: float
    """Where the carrier is, as an angle of the arc at beta = 0."""
    end: float
    """Angle of the free end."""
    held_at: float | None
    """None where the C slides in its carrier; else the beta at which the grip is where it always is."""
    size: float = 1.0
    mean: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) of the twist, taken off."""

    @property
    def sensor(self) -> Array:
        """(3,) in the carm frame."""
        return inverse(self.T_sensor_carm)[:3, 3]

    def twist(self, vertical: Array, beta: Array) -> Array:
        """(N, 6): shift of the sensor and its turn, in the carm frame; ``vertical`` (N, 3) as seen there, upwards."""
        sensor, foot, force = self.sensor, self.sensor * (1.0, 0.0, 1.0), -vertical
        clamp = self.grip - (beta if self.held_at is None else np.full_like(beta, self.held_at))
        shift, turn = self.arc.deflection(clamp, np.full_like(beta, self.end), force, foot, sensor)
        carrier = self.arc.point(clamp)
        moment = np.cross(foot - carrier, force) + np.cross(-foot - carrier, force)
        tilt = CARRIER * self.arc.bending * self.arc.radius * moment
        return self.size * np.hstack([shift + np.cross(tilt, sensor - carrier), turn + tilt]) - self.mean

    def bent(self, T: Array, up: Array, beta: Array) -> Array:
        """The poses T (N, 4, 4) of the sensor after the sag; ``up`` (3,) is the vertical in their frame."""
        R_carm = T[:, :3, :3] @ self.T_sensor_carm[:3, :3]
        shift, turn = np.split(self.twist(up @ R_carm, beta), 2, axis=1)
        bent = T.copy()
        bent[:, :3, 3] += np.einsum("nij,nj->ni", R_carm, shift)
        bent[:, :3, :3] = exp_so3(np.einsum("nij,nj->ni", R_carm, turn)) @ T[:, :3, :3]
        return bent

    def deformation(self, geometry: NominalGeometry, angles: Array) -> Deformation:
        """How the pivot moves in the sensor's frame over the ranges of ``angles`` (N, 2), as a result has it."""
        at = grid(angles.min(axis=0), angles.max(axis=0))
        shift, turn = np.split(self.twist(verticals(geometry, at), at[:, 1]), 2, axis=1)
        R = self.T_sensor_carm[:3, :3]
        R_bent = R @ np.swapaxes(exp_so3(turn), 1, 2)
        moved = -np.einsum("nij,nj->ni", R_bent, self.sensor + shift) - self.T_sensor_carm[:3, 3]
        turned = log_so3(R_bent @ R.T)
        values = zip(at.tolist(), moved, turned, strict=True)
        nodes = tuple(DeformationNode(alpha, beta, v, w, np.zeros(3)) for (alpha, beta), v, w in values)
        low, high = at.min(axis=0).tolist(), at.max(axis=0).tolist()
        return Deformation((low[0], high[0]), (low[1], high[1]), nodes)


def sag_of(chain: Chain, geometries: list[NominalGeometry], mount: Array, angles: Array, peak_m: float) -> Sag:
    """The sag of a machine whose recording has the ``angles`` (N, 2) of its two axes, rad.

    Its size is such that over the joints' ranges and those of the recording the greatest shift between two poses, as
    seen from the C, is ``peak_m``. Its mean over the ranges of the recording is zero. ``mount`` is T_link_sensor
    (4, 4). Raises InputError where the sensor rides on no arc, or where gravity bends it the same at all angles.
    """
    joints = np.array([joint_range(chain, joint) for joint in (chain.angular, chain.orbital)]).T
    low, high = np.fmin(joints[0], angles.min(axis=0)), np.fmax(joints[1], angles.max(axis=0))
    unscaled = _shape(inverse(mount) @ geometries[0].T_sensor_carm, low[1], high[1])
    everywhere = grid(low, high)
    size = _diameter(unscaled.twist(verticals(geometries[0], everywhere), everywhere[:, 1])[:, :3])
    if size < LEAST_SHARE * unscaled.arc.radius**3:
        raise InputError("sag_m: gravity bends this machine the same at all angles; leave the sag out")
    scaled = replace(unscaled, size=peak_m / size)
    seen = grid(angles.min(axis=0), angles.max(axis=0))
    twists = [scaled.twist(verticals(geometry, seen), seen[:, 1]) for geometry in geometries]
    return replace(scaled, mean=np.concatenate(twists).mean(axis=0))


def verticals(geometry: NominalGeometry, angles: Array) -> Array:
    """(N, 3) the vertical, z of the base, as seen from the C at alpha and beta (N, 2)."""
    alpha, beta = angles.T
    R = geometry.T_base_torus[:3, :3] @ rot_x(alpha) @ rot_z(geometry.non_orthogonality) @ rot_y(beta)
    return R[:, 2]


def grid(low: Array, high: Array) -> Array:
    """(`STEPS` ** 2, 2) pairs of angles from ``low`` to ``high`` (2,), ends included, the second running faster."""
    return np.stack(np.meshgrid(*np.linspace(low, high, STEPS).T, indexing="ij"), axis=-1).reshape(-1, 2)


def _shape(T_sensor_carm: Array, lowest: float, highest: float) -> Sag:
    """The C of a sensor at (4, 4) that turns about its own axis from ``lowest`` to ``highest``, unscaled."""
    x, _, z = inverse(T_sensor_carm)[:3, 3]
    radius, foot, middle = float(np.hypot(x, z)), float(np.arctan2(x, z)), (lowest + highest) / 2
    if radius < LEAST_RADIUS_M:
        problem = f"sag_m: the sensor is {1e3 * radius:.0f} mm from the axis of the joint next to it"
        raise InputError(f"{problem}; a C that bends bears it at least {1e3 * LEAST_RADIUS_M:.0f} mm from there")
    grip = -np.pi / 2 if np.sin(foot + middle) >= 0 else np.pi / 2
    free = float(np.angle(np.exp(1j * (foot + middle - grip))))
    side = 1.0 if free >= 0 else -1.0
    reach, half = abs(free) + BEYOND_RAD, (highest - lowest) / 2
    slides = half < min(reach, 2 * np.pi - reach)
    end = foot + side * BEYOND_RAD
    grip = end - side * reach + middle
    return Sag(T_sensor_carm, Arc(radius), grip, end, None if slides else middle)


def _diameter(points: Array) -> float:
    """The greatest distance between two points (N, 3)."""
    return float(np.sqrt(((points[:, None] - points) ** 2).sum(axis=-1)).max())
