"""The serial chain of a URDF as arrays, and the nominal two-axis geometry of the C-arm in it."""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from carm_kin.errors import InputError
from carm_kin.machine.urdf import Joint, UrdfFile, listing
from solvers.se3 import Array, exp_so3, inverse, rot_z, transform

MAX_JOINTS = 100
"""Moving joints of one chain; the memory of the kinematics library grows with their cube."""
ISOCENTRIC_M = 0.5e-3
"""A machine with a smaller major radius counts as isocentric."""

_ROTARY = ("revolute", "continuous")


@dataclass(frozen=True, eq=False)
class Chain:
    """Moving joints from the base to the sensor, fixed joints folded in. J joints, m and rad.

    A configuration q (..., J) holds one number a joint in this order, continuous joints an angle. A planar
    joint stands as three: ``NAME_x``, ``NAME_y``, ``NAME_yaw``.
    """

    base_link: str
    sensor_link: str
    names: tuple[str, ...]
    types: tuple[str, ...]
    """``revolute``, ``continuous`` or ``prismatic``."""
    placements: Array
    """(J, 4, 4): each joint at zero, in the frame of the joint before it (the first in the base)."""
    axes: Array
    """(J, 3), unit, in the joint's own frame."""
    lower: Array
    """(J,), rad or m; -inf where there is no limit."""
    upper: Array
    """(J,), rad or m; inf where there is no limit."""
    T_last_sensor: Array
    """(4, 4): the sensor link in the frame of the last joint."""
    angular: int
    """Index of the joint of alpha: of the two axes the one nearer the base, whatever it is called."""
    orbital: int
    """Index of the joint of beta, the other one."""
    origins_before: Array
    """(J + 1, 4, 4): the part of each placement, and of T_last_sensor, that stands before the one
    ``<origin>`` named in ``origin_joints``."""
    origin_joints: tuple[str | None, ...]
    """(J + 1): the URDF joint whose ``<origin>`` carries each placement and T_last_sensor, if there is one."""
    notes: tuple[str, ...] = ()
    """What was chosen with a remark: the orbital joint as the first axis."""

    def index(self, name: str) -> int:
        """The index of a joint. Raises `InputError` with the valid names."""
        if name not in self.names:
            raise InputError(f"no joint of the chain is named {name!r}; valid: {listing(self.names)}")
        return self.names.index(name)

    def configurations(self, q: ArrayLike) -> Array:
        """q (..., J) as an array. Raises `InputError` for a wrong number of joint values."""
        try:
            q = np.array(q, dtype=float, ndmin=1)
        except (TypeError, ValueError) as error:
            raise InputError(f"the joint values are no array of numbers: {error}") from None
        if q.shape[-1] != len(self.names):
            problem = f"{q.shape[-1]} joint values for {len(self.names)} joints"
            raise InputError(f"{problem}; the order is {listing(self.names, MAX_JOINTS)}")
        return q

    def forward_kinematics(self, q: ArrayLike) -> Array:
        """T_base_sensor (..., 4, 4) at q (..., J). Raises `InputError` for a wrong number of joints."""
        R, p = deque(self._joint_motions(q), maxlen=1)[0]
        return transform(R, p) @ self.T_last_sensor

    def joint_frames(self, q: ArrayLike) -> Array:
        """T_base_joint (..., J, 4, 4) of every joint, after its own motion, at q (..., J)."""
        frames = [transform(R, p) for R, p in self._joint_motions(q)]
        return np.stack(np.broadcast_arrays(*frames), axis=-3)

    def origins(self, placements: Array, T_last_sensor: Array) -> dict[str, Array]:
        """The URDF origins, joint name -> T_parent_joint (4, 4), that give the chain these placements.

        ``placements`` is (J, 4, 4) and ``T_last_sensor`` (4, 4), as in this class; the result fits
        `carm_kin.machine.urdf.patch_origins`. Raises `InputError` for a change that no ``<origin>`` can carry.
        """
        before = np.concatenate([self.placements, self.T_last_sensor[None]])
        after = np.concatenate([placements, T_last_sensor[None]])
        changed = {}
        for name, joint, T_before, T_after, T_folded in zip(
            (*self.names, self.sensor_link), self.origin_joints, before, after, self.origins_before, strict=True
        ):
            if np.array_equal(T_before, T_after):
                continue
            if joint is None:
                raise InputError(f"no <origin> carries the placement of {name!r}; attach it by a fixed joint")
            changed[joint] = inverse(T_folded) @ T_after
        return changed

    def _joint_motions(self, q: ArrayLike) -> Iterator[tuple[Array, Array]]:
        """Rotation and position of each joint in the base, after its own motion."""
        q = self.configurations(q)
        R, p = np.eye(3), np.zeros(3)
        for j, placement in enumerate(self.placements):
            p = p + R @ placement[:3, 3]
            R = R @ placement[:3, :3]
            if self.types[j] == "prismatic":
                p = p + (R @ self.axes[j]) * q[..., j, None]
            else:
                R = R @ exp_so3(self.axes[j] * q[..., j, None])
            yield R, p


@dataclass(frozen=True, eq=False)
class NominalGeometry:
    """The two axes of a chain as the machine's drawing has them, m and rad.

    T_base_sensor = T_base_torus Rx(alpha) Tz(R) Rz(epsilon) Ry(beta) inv(T_sensor_carm), where alpha is the
    value of the joint nearer the base and beta of the other, and all other joints stand still.
    """

    axes: tuple[str, str]
    """The joint of alpha and the joint of beta."""
    T_base_torus: Array
    """(4, 4): origin the torus centre, x the first axis, z towards the pivot at alpha = 0 where R > 0."""
    major_radius: float
    """R, signed as it stands in the chain."""
    non_orthogonality: float
    """epsilon: the axes enclose 90 degrees + epsilon."""
    T_sensor_carm: Array
    """(4, 4): origin the pivot, y the second axis, in sensor coordinates."""

    @property
    def offset(self) -> Array:
        """t (3,): the pivot in sensor coordinates."""
        return self.T_sensor_carm[:3, 3]

    @property
    def minor_radius(self) -> float:
        """b: the radius of the sensor's orbit about the second axis."""
        return float(np.linalg.norm(np.cross(self.offset, self.T_sensor_carm[:3, 1])))

    @property
    def isocentric(self) -> bool:
        """Whether the two axes meet, to `ISOCENTRIC_M`."""
        return abs(self.major_radius) < ISOCENTRIC_M


def nominal_geometry(chain: Chain, q: ArrayLike | None = None) -> NominalGeometry:
    """The two-axis geometry with the other joints at zero, or at ``q`` (J,) whose alpha and beta are ignored.

    Raises `InputError` for parallel axes and for a ``q`` of the wrong length.
    """
    first, second = chain.angular, chain.orbital
    q = chain.configurations(np.zeros(len(chain.names)) if q is None else q)
    q[[first, second]] = 0
    frames = chain.joint_frames(q)
    n, a = (frames[j, :3, :3] @ chain.axes[j] for j in (first, second))
    on_n, on_a = frames[first, :3, 3], frames[second, :3, 3]
    across = np.cross(n, a)
    sine = float(np.linalg.norm(across))
    names = chain.names[first], chain.names[second]
    if sine < 1e-6:
        raise InputError(
            f"the axes of the joints {names[0]!r} and {names[1]!r} are parallel; name two others (angular, orbital)"
        )
    z = across / sine
    center = on_n + n * (np.cross(on_a - on_n, a) @ z) / sine
    T_base_torus = transform(np.stack([n, np.cross(z, n), z], axis=1), center)
    major_radius = float((on_a - on_n) @ z)
    epsilon = float(np.arctan2(-(n @ a), sine)) + 0.0
    T_torus_carm = transform(rot_z(epsilon), np.array([0, 0, major_radius]))
    T_sensor_carm = inverse(chain.forward_kinematics(q)) @ T_base_torus @ T_torus_carm
    return NominalGeometry(names, T_base_torus, major_radius, epsilon, T_sensor_carm)


def chain_of(
    urdf: UrdfFile, sensor_link: str | None = None, angular: str | None = None, orbital: str | None = None
) -> Chain:
    """The chain from the base to the sensor link.

    ``sensor_link`` defaults to the link named ``sensor``, else to the only one in `UrdfFile.sensors`. The two
    axes default to the joints named ``angular`` and ``orbital``, else to the last rotary joints before the
    sensor. The one nearer the base is the first axis (alpha), with a note where that is the orbital one. Raises
    `InputError` where a name is wrong or there is no single choice, with the valid names.
    """
    sensor_link = sensor_link or _default_sensor_link(urdf)
    joints = urdf.joints_to(sensor_link)
    moving = [joint for joint in joints if joint.type != "fixed"]
    if len(moving) > MAX_JOINTS:
        problem = f"{len(moving)} moving joints lie between base and {sensor_link!r}; at most {MAX_JOINTS} are accepted"
        raise InputError(problem, file=urdf.path)
    chosen = _axis_indices(urdf, moving, sensor_link, angular, orbital)
    first, second = sorted(chosen)
    before, at, carriers = _folded(joints, _origin_carriers(urdf))
    return Chain(
        urdf.base,
        sensor_link,
        tuple(joint.name for joint in moving),
        tuple(joint.type for joint in moving),
        placements=(before @ at)[:-1],
        axes=np.array([joint.axis for joint in moving]),
        lower=np.array([joint.lower for joint in moving]),
        upper=np.array([joint.upper for joint in moving]),
        T_last_sensor=(before @ at)[-1],
        angular=first,
        orbital=second,
        origins_before=before,
        origin_joints=carriers,
        notes=() if chosen == (first, second) else (_exchanged(moving[first].name, moving[second].name),),
    )


def _exchanged(first: str, second: str) -> str:
    return (
        f"the orbital joint {first!r} stands nearer the base than the angular one {second!r}: it is the first axis "
        f"(alpha), which a calibration calls angular; calibrate with --angular {first} --orbital {second}"
    )


def _default_sensor_link(urdf: UrdfFile) -> str:
    if "sensor" in urdf.links:
        return "sensor"
    if len(urdf.sensors) == 1:
        return urdf.sensors[0]
    problem = f"which link carries the sensor? Name it (sensor_link): {listing(urdf.sensors)}"
    raise InputError(problem, file=urdf.path)


def _axis_indices(
    urdf: UrdfFile, moving: list[Joint], sensor_link: str, angular: str | None, orbital: str | None
) -> tuple[int, int]:
    """Indices of the angular and the orbital joint: as asked, by their usual names, else the last that are left."""
    rotary = {joint.name: j for j, joint in enumerate(moving) if joint.type in _ROTARY}
    between = f"between base and {sensor_link!r}"
    if len(rotary) < 2:
        problem = f"a C-arm needs two revolute joints {between}; there are: {listing(rotary)}"
        raise InputError(problem, file=urdf.path)
    for role, name in (("angular", angular), ("orbital", orbital)):
        if name is not None and name not in rotary:
            problem = f"the {role} joint {name!r} is no revolute joint {between}; valid: {listing(rotary)}"
            raise InputError(problem, file=urdf.path)
    if angular is not None and angular == orbital:
        raise InputError(f"the angular and the orbital joint are both {angular!r}; they must differ", file=urdf.path)
    orbital = orbital or _first_free(["orbital", *reversed(rotary)], rotary, {angular or "angular"})
    angular = angular or _first_free(["angular", *reversed(rotary)], rotary, {orbital})
    return rotary[angular], rotary[orbital]


def _first_free(candidates: list[str], rotary: dict[str, int], taken: set[str | None]) -> str:
    return next(name for name in candidates if name in rotary and name not in taken)


def _origin_carriers(urdf: UrdfFile) -> dict[str, str]:
    """Joint -> joint of the file whose ``<origin>`` is its own; the inner parts of a planar joint have none."""
    return {joint.elementary()[0].name: joint.name for joint in urdf.joints}


def _folded(joints: tuple[Joint, ...], carrier: Mapping[str, str]) -> tuple[Array, Array, tuple[str | None, ...]]:
    """For each moving joint and for the sensor: fixed joints before (J + 1, 4, 4), origin (J + 1, 4, 4), its joint."""
    before, origins, carriers = [], [], []
    T = np.eye(4)
    for joint in joints:
        if joint.type == "fixed" and joint is not joints[-1]:
            T = T @ joint.origin
            continue
        before.append(T)
        origins.append(joint.origin)
        carriers.append(carrier.get(joint.name))
        T = np.eye(4)
    if joints[-1].type != "fixed":
        before.append(T)
        origins.append(T)
        carriers.append(None)
    return np.array(before), np.array(origins), tuple(carriers)
