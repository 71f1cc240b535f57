"""Machines of any chain for the tests, written out independently of `carm_kin` and `solvers`.

The kinematics is read from the URDF's text by ElementTree; every rotation comes from SciPy. Metres and radians.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from carm_kin.machine.urdf import UrdfFile, parse_urdf
from carm_kin.recording.recording import Recording
from helpers.simulated import frame, rigid

SHIFT, TURN = 3e-3, np.radians(0.5)
SIGMA_T, SIGMA_R = 0.25e-3, np.radians(0.1)
ARM_JOINTS = [f"j{k}" for k in range(1, 7)]
ARM_AXES = {"sensor_link": "tool", "angular": "j1", "orbital": "j2"}
LIFTS = (0.0, 0.15, 0.3)
C_JOINTS = ("angular", "orbital", "lift")
C_ARM = """<?xml version="1.0"?>
<!-- a lift, a C-arm of two skew axes, a sensor -->
<robot name="small">
  <link name="base"/>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="column"/>
    <origin xyz="0.1 0 0.7" rpy="0 0.05 0"/><axis xyz="0 0 1"/><limit lower="0" upper="0.4" effort="1" velocity="1"/>
  </joint>
  <link name="column"/>
  <joint name="angular" type="revolute"><parent link="column"/><child link="swivel"/>
    <origin xyz="0.4 0 0.1"/><axis xyz="1 0 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <link name="swivel"/>
  <joint name="orbital" type="revolute"><parent link="swivel"/><child link="c"/>
    <origin xyz="0.8 0.02 0.1" rpy="0.01 0 0.005"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <link name="c"/>
  <joint name="sensor_mount" type="fixed"><parent link="c"/><child link="sensor"/>
    <origin xyz="0.1 -0.15 0.6" rpy="0.1 0.2 1.5"/>
  </joint>
  <link name="sensor"/>
</robot>
"""

ARM_ORIGINS = (
    ("0 0 0.3", "0 0 0", "0 0 1"),
    ("0.1 0.05 0.2", "0 0.2 0", "0 1 0"),
    ("0.02 0 0.45", "0.1 0 0", "0 0.8 0.6"),
    ("0.35 0.03 0", "0 0.1 0.2", "1 0 0"),
    ("0.12 0 0.05", "0 0 0.1", "0 1 0"),
    ("0.1 0.02 0", "0.2 0 0", "1 0 0"),
)


def arm(joints: int = 6) -> str:
    """A serial arm of revolute joints ``j1`` ..., its tool on the link ``tool``."""
    parts = ['<link name="l0"/>']
    for k, (xyz, rpy, axis) in enumerate(ARM_ORIGINS[:joints], 1):
        parts.append(
            f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            f'<limit lower="-3" upper="3" effort="1" velocity="1"/></joint><link name="l{k}"/>'
        )
    parts.append(
        f'<joint name="tool_mount" type="fixed"><parent link="l{joints}"/><child link="tool"/>'
        '<origin xyz="0 0.05 0.1" rpy="0.3 0 0"/></joint><link name="tool"/>'
    )
    return f'<robot name="arm">{"".join(parts)}</robot>'


BIPLANE = """<robot name="biplane">
  <link name="room"/>
  <joint name="rail" type="prismatic"><parent link="room"/><child link="table"/>
    <origin xyz="0 0 1"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <link name="table"/>
  <joint name="f_angular" type="revolute"><parent link="table"/><child link="f1"/>
    <origin xyz="0 0.1 0" rpy="0 0.1 0"/><axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="f1"/>
  <joint name="f_orbital" type="revolute"><parent link="f1"/><child link="f2"/>
    <origin xyz="0.5 0 0.1"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="f2"/>
  <joint name="f_mount" type="fixed"><parent link="f2"/><child link="frontal"/><origin xyz="0 0 0.6"/></joint>
  <link name="frontal"/>
  <joint name="l_angular" type="revolute"><parent link="table"/><child link="l1"/>
    <origin xyz="-0.6 0 0.3" rpy="0 0 0.2"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="l1"/>
  <joint name="l_orbital" type="revolute"><parent link="l1"/><child link="l2"/>
    <origin xyz="0.1 0.2 0"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="l2"/>
  <joint name="l_mount" type="fixed"><parent link="l2"/><child link="lateral"/>
    <origin xyz="0.5 0 0" rpy="1 0 0"/></joint>
  <link name="lateral"/>
</robot>
"""
PLANAR = """<robot name="planar">
  <link name="floor"/>
  <joint name="cart" type="planar"><parent link="floor"/><child link="cart"/><origin xyz="0 0 0.1" rpy="0 0 0.2"/>
    <axis xyz="0 0 1"/></joint>
  <link name="cart"/>
  <joint name="angular" type="continuous"><parent link="cart"/><child link="swivel"/><origin xyz="0.3 0 1"/>
    <axis xyz="1 0 0"/></joint>
  <link name="swivel"/>
  <joint name="orbital" type="continuous"><parent link="swivel"/><child link="c"/><origin xyz="0.6 0 0.1"/>
    <axis xyz="0 1 0"/></joint>
  <link name="c"/>
</robot>
"""


def parsed(text: str, name: str = "machine.urdf") -> UrdfFile:
    """The URDF of a text."""
    return parse_urdf(text.encode(), Path(name))


def numbers(text: str | None, default: str) -> np.ndarray:
    return np.array([float(x) for x in (text or default).split()])


def origin(joint: ElementTree.Element) -> np.ndarray:
    """T_parent_joint (4, 4): rpy are turns about the fixed axes x, y and z, one after the other."""
    found, T = joint.find("origin"), np.eye(4)
    if found is not None:
        T[:3, :3] = Rotation.from_euler("xyz", numbers(found.get("rpy"), "0 0 0")).as_matrix()
        T[:3, 3] = numbers(found.get("xyz"), "0 0 0")
    return T


def path_to(text: str, link: str) -> list[ElementTree.Element]:
    """The joints from the root to a link."""
    by_child = {joint.find("child").get("link"): joint for joint in ElementTree.fromstring(text).findall("joint")}
    found = []
    while link in by_child:
        found.insert(0, by_child[link])
        link = found[0].find("parent").get("link")
    return found


def kinematics(text: str, link: str, q: Mapping[str, np.ndarray]) -> np.ndarray:
    """T_base_link (N, 4, 4) of a URDF's text at the joint values q (N,); joints that are not in q stand at zero."""
    n = max((len(values) for values in q.values()), default=1)
    T = np.broadcast_to(np.eye(4), (n, 4, 4))
    for joint in path_to(text, link):
        T = T @ origin(joint)
        if joint.get("type") == "fixed":
            continue
        if joint.get("type") == "planar":
            T = T @ _planar(joint.get("name"), q, n)
            continue
        found = joint.find("axis")
        axis = numbers(None if found is None else found.get("xyz"), "1 0 0")
        along = axis / np.linalg.norm(axis) * np.broadcast_to(q.get(joint.get("name"), 0.0), n)[:, None]
        motion = np.tile(np.eye(4), (n, 1, 1))
        if joint.get("type") == "prismatic":
            motion[:, :3, 3] = along
        else:
            motion[:, :3, :3] = Rotation.from_rotvec(along).as_matrix()
        T = T @ motion
    return T


def _planar(name: str, q: Mapping[str, np.ndarray], n: int) -> np.ndarray:
    """(N, 4, 4) of a planar joint whose axis is z."""
    x, y, yaw = (np.broadcast_to(q.get(f"{name}_{part}", 0.0), n) for part in ("x", "y", "yaw"))
    motion = np.tile(np.eye(4), (n, 1, 1))
    motion[:, :3, :3] = Rotation.from_rotvec(np.multiply.outer(yaw, [0, 0, 1])).as_matrix()
    motion[:, 0, 3], motion[:, 1, 3] = x, y
    return motion


def perturbed(text: str, shift_m: float, turn_rad: float, seed: int = 0, joints: Sequence[str] | None = None) -> str:
    """The URDF with the origins of the ``joints`` (default: all) moved and turned by so much in random directions."""
    rng, root = np.random.default_rng([seed, 21]), ElementTree.fromstring(text)
    for joint in root.findall("joint"):
        v, w = rng.normal(size=(2, 3))
        if joints is not None and joint.get("name") not in joints:
            continue
        T = origin(joint) @ rigid(np.concatenate([v / np.linalg.norm(v) * shift_m, w / np.linalg.norm(w) * turn_rad]))
        found = joint.find("origin")
        found = ElementTree.SubElement(joint, "origin") if found is None else found
        found.set("xyz", " ".join(map(repr, T[:3, 3].tolist())))
        found.set("rpy", " ".join(map(repr, Rotation.from_matrix(T[:3, :3]).as_euler("xyz").tolist())))
    return ElementTree.tostring(root, encoding="unicode")


def noisy(T: np.ndarray, sigma_t: float, sigma_r: float, seed: int) -> np.ndarray:
    """Poses (N, 4, 4) with noise of the position, and of the orientation in the sensor frame."""
    rng, T = np.random.default_rng([seed, 22]), np.array(T)
    T[:, :3, 3] += sigma_t * rng.normal(size=(len(T), 3))
    T[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(sigma_r * rng.normal(size=(len(T), 3))).as_matrix()
    return T


def grossly(T: np.ndarray, share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The poses with a share of them replaced by others 50 to 500 mm off and turned at random, and which (N,)."""
    rng, T = np.random.default_rng([seed, 23]), np.array(T)
    gross = np.zeros(len(T), dtype=bool)
    gross[rng.permutation(len(T))[: round(share * len(T))]] = True
    v = rng.normal(size=(gross.sum(), 3))
    T[gross, :3, 3] += v / np.linalg.norm(v, axis=1, keepdims=True) * rng.uniform(0.05, 0.5, (gross.sum(), 1))
    T[gross, :3, :3] = Rotation.random(gross.sum(), random_state=seed).as_matrix()
    return T, gross


def random_values(names: Sequence[str], n: int, seed: int, half_range: float = 1.2) -> dict[str, np.ndarray]:
    """Joint name -> (N,) values."""
    drawn = np.random.default_rng([seed, 24]).uniform(-half_range, half_range, (n, len(names)))
    return dict(zip(names, drawn.T, strict=True))


@dataclass(frozen=True, eq=False)
class Swept:
    """Joint values of sweeps."""

    q: dict[str, np.ndarray]
    """Joint name -> (N,)."""
    sweep: np.ndarray
    """(N,) str."""
    moving: np.ndarray
    """(N,) str."""

    def told(self, held: Sequence[str] = (), moving: Sequence[str] = ()) -> dict[str, np.ndarray]:
        """What a recording says: the values of the joints ``held`` where they are, of ``moving`` where they move."""
        known = {}
        for name, values in self.q.items():
            moves = self.moving == name
            seen = (moves & (name in moving)) | (~moves & (name in held))
            if name in held or name in moving:
                known[name] = np.where(seen, values, np.nan)
        return known


def swept(*sweeps: tuple[str, np.ndarray, Mapping[str, float]]) -> Swept:
    """From sweeps (moving joint, its path (M,), the values of the others, else 0)."""
    names = list(dict.fromkeys(name for moving, _, held in sweeps for name in (moving, *held)))
    parts: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for moving, path, held in sweeps:
        for name in names:
            parts[name].append(path if name == moving else np.full(len(path), held.get(name, 0.0)))
    sizes = [len(path) for _, path, _ in sweeps]
    labels = np.repeat([f"s{k}" for k in range(len(sweeps))], sizes)
    return Swept(
        {name: np.concatenate(values) for name, values in parts.items()},
        labels,
        np.repeat([moving for moving, _, _ in sweeps], sizes),
    )


def c_arm_sweeps(step_deg: float = 5.0, lifts: Sequence[float] = (0.0,)) -> Swept:
    """Three orbital and two angular sweeps at each lift; where there are several lifts, two sweeps of the lift too."""
    path = np.radians(np.arange(-60, 60 + step_deg, step_deg))
    sweeps = [
        (moving, path, {other: np.radians(value), "lift": lift})
        for lift in lifts
        for moving, other, values in (("orbital", "angular", (-60, 0, 50)), ("angular", "orbital", (-20, 40)))
        for value in values
    ]
    if len(lifts) > 1:
        sweeps += [
            ("lift", np.linspace(0, 0.3, 13), {"angular": a, "orbital": b}) for a, b in ((0.3, 0.2), (-0.5, -0.4))
        ]
    return swept(*sweeps)


def recorded(T: np.ndarray, **more) -> Recording:
    """The recording of poses (N, 4, 4)."""
    return Recording(T[:, :3, 3], T[:, :3, :3], **more)


def stand(seed: int = 0, spread: float = 1.0) -> np.ndarray:
    """A random T_world_base or mount (4, 4)."""
    return frame(np.random.default_rng([seed, 25]), spread)


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def arm_recording(seed: int, n: int = 100, outliers: float = 0.0, sigma_q: float = 0.0, noise: bool = True):
    """The true arm, its base, the recording with all joints read, and which poses are wrong."""
    text, base, q = perturbed(arm(), SHIFT, TURN, seed), stand(seed), random_values(ARM_JOINTS, n, seed)
    T = noisy(base @ kinematics(text, "tool", q), SIGMA_T * noise, SIGMA_R * noise, seed)
    T, gross = grossly(T, outliers, seed)
    rng = np.random.default_rng([seed, 51])
    read = {name: values + sigma_q * rng.normal(size=n) for name, values in q.items()}
    return text, base, recorded(T, joints=read), gross


def c_arm_recording(seed: int, held=(), moving=(), lifts=(0.0,), *, outliers=0.0, sigma_q=0.0, labels=True, noise=1.0):
    """The true C-arm, its base, the recording of sweeps, and which poses are wrong."""
    truth, swept, base = perturbed(C_ARM, SHIFT, TURN, seed), c_arm_sweeps(lifts=lifts), stand(seed)
    T = noisy(base @ kinematics(truth, "sensor", swept.q), noise * SIGMA_T, noise * SIGMA_R, seed)
    T, gross = grossly(T, outliers, seed)
    told = disturbed_readings(swept, swept.told(held, moving), sigma_q, seed)
    sweeps = {"sweep": swept.sweep, "moving": swept.moving} if labels else {}
    return truth, base, recorded(T, joints=told, prismatic=frozenset({"lift"} & told.keys()), **sweeps), gross


def disturbed_readings(swept: Swept, told: dict[str, np.ndarray], sigma: float, seed: int) -> dict[str, np.ndarray]:
    """The readings of moving joints with noise."""
    rng = np.random.default_rng([seed, 52])
    return {name: v + (swept.moving == name) * sigma * rng.normal(size=len(v)) for name, v in told.items()}


def poses_of(recording) -> np.ndarray:
    T = np.tile(np.eye(4), (len(recording), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = recording.R_world_sensor, recording.p_world_sensor
    return T


def codes(result) -> set[str]:
    """Of the warnings of a result."""
    return {warning.code for warning in result.warnings}
