"""Every machine in urdf/ and each of its sensors, found by name, and its chain evaluated without the package."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from helpers.places import URDF

FILES = {path.stem: path for path in sorted(URDF.glob("*.urdf"))}


def sensors(path: Path) -> list[str]:
    """The links named after a sensor."""
    names = [link.get("name", "") for link in ElementTree.parse(path).getroot().findall("link")]
    return [name for name in names if name == "sensor" or name.startswith("sensor_")]


BRANCHES = [(name, link) for name, path in FILES.items() for link in sensors(path)]
IDS = [name if link == "sensor" else f"{name}-{link}" for name, link in BRANCHES]


def link_pose(path: Path, link: str, q: Mapping[str, float]) -> np.ndarray:
    """T_base_link (4, 4) at joint values by name, others at zero; a planar joint has NAME_x, NAME_y, NAME_yaw."""
    root = ElementTree.parse(path).getroot()
    into = {joint.find("child").get("link"): joint for joint in root.findall("joint")}
    T = np.eye(4)
    while link in into:
        joint = into[link]
        T = _origin(joint) @ _motion(joint, q) @ T
        link = joint.find("parent").get("link")
    return T


def _origin(joint: ElementTree.Element) -> np.ndarray:
    origin = joint.find("origin")
    attributes = {} if origin is None else origin.attrib
    xyz, rpy = (np.array(attributes.get(key, "0 0 0").split(), float) for key in ("xyz", "rpy"))
    return rigid(Rotation.from_euler("xyz", rpy), xyz)


def _motion(joint: ElementTree.Element, q: Mapping[str, float]) -> np.ndarray:
    name, kind = joint.get("name", ""), joint.get("type")
    if kind == "fixed":
        return np.eye(4)
    axis = np.array(joint.find("axis").get("xyz").split(), float)
    if kind == "planar":
        assert axis.tolist() == [0, 0, 1]
        x, y, yaw = (q.get(f"{name}_{part}", 0.0) for part in ("x", "y", "yaw"))
        return rigid(Rotation.from_rotvec([0, 0, yaw]), [x, y, 0])
    value = q.get(name, 0.0)
    return (
        rigid(Rotation.identity(), axis * value) if kind == "prismatic" else rigid(Rotation.from_rotvec(axis * value))
    )


def rigid(R: Rotation, p: object = (0, 0, 0)) -> np.ndarray:
    """The transform of a rotation and a position."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R.as_matrix(), p
    return T
