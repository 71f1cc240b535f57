"""The strict pass over a URDF: XML in, a checked tree of joints out, or one line that says what is wrong.

The libraries that load URDF accept loops, NaN and duplicate names, or stop without a reason. Only links and
joints are read; shapes, masses and mesh paths are never looked at.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import lxml.etree as etree
import numpy as np

from carm_kin.errors import InputError
from solvers.se3 import Array, exp_so3, rot_x, rot_y, rot_z, transform

MAX_LINKS = 500
MAX_NAME = 200
"""Characters of the name of a link or joint."""
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "planar", "floating")

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_XACRO = "is a xacro file; expand it first: xacro FILE > OUT.urdf"
_HUGE = 1e9
"""No coordinate of a machine is larger (m, rad); larger ones would overflow further on."""
_UNIT = 1e-3
"""An axis whose length differs from 1 by less is normalised, by more refused."""


@dataclass(frozen=True, eq=False)
class Joint:
    """One checked ``<joint>``."""

    name: str
    type: str
    """One of `JOINT_TYPES`."""
    parent: str
    child: str
    xyz: Array
    """(3,), m: the joint's origin in the parent link."""
    rpy: Array
    """(3,), rad: roll, pitch, yaw about the parent's fixed axes."""
    axis: Array
    """(3,), unit, in the joint's own frame."""
    lower: float
    """rad or m; -inf where the joint has no limit."""
    upper: float
    """rad or m; inf where the joint has no limit."""
    line: int

    @property
    def origin(self) -> Array:
        """T_parent_joint (4, 4) at joint value zero."""
        roll, pitch, yaw = self.rpy
        return transform(rot_z(yaw) @ rot_y(pitch) @ rot_x(roll), self.xyz)

    def elementary(self) -> tuple["Joint", ...]:
        """The joint itself; for a planar one ``NAME_x``, ``NAME_y`` (prismatic) and ``NAME_yaw`` (continuous)."""
        if self.type != "planar":
            return (self,)
        turn = exp_so3(_rotation_vector_from_z(self.axis))
        names = [f"{self.name}_{part}" for part in ("x", "y", "yaw")]
        still = replace(self, xyz=np.zeros(3), rpy=np.zeros(3))
        return (
            replace(self, name=names[0], type="prismatic", axis=turn[:, 0], child=names[0]),
            replace(still, name=names[1], type="prismatic", axis=turn[:, 1], parent=names[0], child=names[1]),
            replace(still, name=names[2], type="continuous", parent=names[1]),
        )


@dataclass(frozen=True, eq=False)
class UrdfFile:
    """A URDF that passed every check. Nothing is ever modified."""

    path: Path
    data: bytes
    """The file as it was read."""
    name: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    base: str
    """The one link without a parent."""
    notes: tuple[str, ...]
    """What was accepted with a remark: axes that were normalised, mimics that are not applied."""

    @cached_property
    def leaves(self) -> tuple[str, ...]:
        """The links that carry no joint."""
        parents = {joint.parent for joint in self.joints}
        return tuple(link for link in self.links if link not in parents)

    @cached_property
    def sensors(self) -> tuple[str, ...]:
        """The links that may carry a sensor: those named ``sensor`` or ``sensor_...``, else the leaves."""
        return tuple(link for link in self.links if link == "sensor" or link.startswith("sensor_")) or self.leaves

    def joints_to(self, link: str) -> tuple[Joint, ...]:
        """The joints from the base to ``link``, of one number each or fixed (`Joint.elementary`).

        Raises `InputError` for an unknown link and for a floating joint on the way.
        """
        if link not in self.links:
            raise InputError(f"no link is named {link!r}; valid: {listing(self.links)}", file=self.path)
        into = {joint.child: joint for joint in self.joints}
        joints: list[Joint] = []
        while link in into:
            joints[:0] = into[link].elementary()
            link = into[link].parent
        for joint in joints:
            if joint.type == "floating":
                problem = f"joint {joint.name!r} on the way to the sensor is floating; make it fixed or planar"
                raise InputError(problem, file=self.path, line=joint.line)
        if twice := _repeated([joint.name for joint in joints]) or _repeated([joint.child for joint in joints]):
            raise InputError(f"{twice!r} is also the name of a part of a planar joint; rename it", file=self.path)
        return tuple(joints)


def check_urdf(root: Any, data: bytes, path: Path) -> UrdfFile:
    """Check the root element of a URDF; ``data`` are its bytes. Raises `InputError` with the line."""
    reader = _Reader(path)
    for element in root.iter(etree.Element):
        if "xacro" in (etree.QName(element).namespace or ""):
            raise reader.fail(element, _XACRO)
    if _tag(root) != "robot":
        raise reader.fail(root, f"the root element is <{_tag(root)}>, not <robot>")
    links = _children(root, "link")
    if not links:
        raise reader.fail(root, "has no <link>")
    if len(links) > MAX_LINKS:
        raise reader.fail(links[MAX_LINKS], f"has {len(links)} links; at most {MAX_LINKS} are accepted")
    reader.check_names(links, "link")
    elements = _children(root, "joint")
    reader.check_names(elements, "joint")
    joints = [reader.joint(element) for element in elements]
    base = reader.base(links, joints)
    reader.note_mimics(elements)
    names = tuple(link.get("name") for link in links)
    return UrdfFile(path, data, root.get("name", ""), names, tuple(joints), base, tuple(reader.notes))


def listing(names: Iterable[str], most: int = 20) -> str:
    """Names for a message: ``a, b, c``, and how many more."""
    names = list(names)
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more if names else "none"


def _tag(element: Any) -> str:
    """The element's name; a default namespace is ignored, a prefixed name is never one of URDF's own."""
    return etree.QName(element).localname if element.prefix is None else f"{element.prefix}:"


def _children(element: Any, tag: str) -> list[Any]:
    return [child for child in element.iterchildren(etree.Element) if _tag(child) == tag]


def _repeated(names: Sequence[str]) -> str | None:
    return next((name for i, name in enumerate(names) if name in names[:i]), None)


def _rotation_vector_from_z(axis: Array) -> Array:
    """The smallest rotation (3,) that turns z into ``axis``; about x where they are opposite."""
    sine = np.hypot(axis[0], axis[1])
    about = np.array([-axis[1], axis[0], 0.0]) / sine if sine > 0 else np.array([1.0, 0.0, 0.0])
    return np.arctan2(sine, axis[2]) * about


@dataclass(frozen=True)
class _Reader:
    """Elements to checked records, every failure with the file and the line."""

    path: Path
    notes: list[str] = field(default_factory=list)

    def fail(self, element: Any, problem: str) -> InputError:
        return InputError(problem, file=self.path, line=element.sourceline)

    def check_names(self, elements: list[Any], kind: str) -> None:
        lines: dict[str, int] = {}
        for element in elements:
            name = element.get("name")
            if not name:
                raise self.fail(element, f"a <{kind}> has no name")
            if len(name) > MAX_NAME or not name.isprintable() or name != name.strip():
                problem = f"a name has at most {MAX_NAME} printable characters and no white space around it"
                raise self.fail(element, f"{kind} {name[:30]!r}: {problem}")
            if name in lines:
                raise self.fail(element, f"{kind} {name!r} is there twice, first in line {lines[name]}")
            lines[name] = element.sourceline

    def joint(self, element: Any) -> Joint:
        name, type_ = element.get("name"), element.get("type")
        where = f"joint {name!r}"
        if type_ not in JOINT_TYPES:
            raise self.fail(element, f"{where} has the type {type_!r}; valid: {', '.join(JOINT_TYPES)}")
        origin = self.child(element, "origin", where)
        xyz, rpy = (self.numbers(origin, key, 3, where) for key in ("xyz", "rpy"))
        axis, lower, upper = np.array([1.0, 0.0, 0.0]), -np.inf, np.inf
        if type_ not in ("fixed", "floating"):
            axis = self.axis(self.child(element, "axis", where), where)
        if type_ in ("revolute", "prismatic"):
            lower, upper = self.limits(element, where)
        parent, child = (self.end(element, tag, where) for tag in ("parent", "child"))
        return Joint(name, type_, parent, child, xyz, rpy, axis, lower, upper, element.sourceline)

    def child(self, element: Any, tag: str, where: str) -> Any | None:
        found = _children(element, tag)
        if len(found) > 1:
            raise self.fail(found[1], f"{where} has {len(found)} <{tag}> elements; one is right")
        return found[0] if found else None

    def end(self, element: Any, tag: str, where: str) -> str:
        found = self.child(element, tag, where)
        if found is None or not found.get("link"):
            raise self.fail(element, f'{where} names no {tag}; give <{tag} link="..."/>')
        return found.get("link")

    def numbers(self, element: Any | None, key: str, count: int, where: str, most: float = _HUGE) -> Array:
        text = None if element is None else element.get(key)
        if text is None:
            return np.zeros(count)
        if "${" in text:
            raise self.fail(element, _XACRO)
        words = text.split()
        if len(words) != count:
            raise self.fail(element, f"{where}: {key} holds {len(words)} numbers, not {count}: {text[:60]!r}")
        for word in words:
            if not _NUMBER.fullmatch(word) or not abs(float(word)) < most:
                raise self.fail(element, f"{where}: {key} holds {word[:30]!r}, which is no finite number")
        return np.array(words, dtype=float)

    def axis(self, element: Any | None, where: str) -> Array:
        if element is None or element.get("xyz") is None:
            return np.array([1.0, 0.0, 0.0])
        axis = self.numbers(element, "xyz", 3, where)
        length = float(np.linalg.norm(axis))
        if abs(length - 1) > _UNIT:
            problem = "is zero; give a direction" if length == 0 else f"has the length {length:.6g}, not 1"
            raise self.fail(element, f"{where}: the axis {problem}")
        if abs(length - 1) > 1e-9:
            self.notes.append(f"{where}, line {element.sourceline}: axis of length {length:.6g} normalised")
        return axis / length

    def limits(self, element: Any, where: str) -> tuple[float, float]:
        limit = self.child(element, "limit", where)
        if limit is None:
            raise self.fail(element, f'{where} has no limit; give <limit lower="..." upper="..."/>')
        lower, upper = (float(self.numbers(limit, key, 1, where, np.inf)[0]) for key in ("lower", "upper"))
        if lower > upper:
            raise self.fail(limit, f"{where}: the lower limit {lower:g} is above the upper limit {upper:g}")
        return lower, upper

    def base(self, links: list[Any], joints: list[Joint]) -> str:
        """The one root, after checking that the joints make one tree of all links."""
        names = [link.get("name") for link in links]
        into: dict[str, Joint] = {}
        for joint in joints:
            for kind, link in (("parent", joint.parent), ("child", joint.child)):
                if link not in names:
                    problem = f"joint {joint.name!r}: its {kind} {link!r} is no link of this file"
                    raise InputError(f"{problem}; valid: {listing(names)}", file=self.path, line=joint.line)
            if joint.child in into:
                first = into[joint.child]
                problem = f"link {joint.child!r} has two parents, by joint {joint.name!r} and by {first.name!r}"
                raise InputError(f"{problem} (line {first.line})", file=self.path, line=joint.line)
            into[joint.child] = joint
        for joint in joints:
            loop = [joint.child, joint.parent]
            while loop[-1] in into and loop[-1] != loop[0] and len(loop) <= len(links):
                loop.append(into[loop[-1]].parent)
            if loop[-1] == loop[0]:
                problem = f"the joints make a loop of the links {listing(reversed(loop))}"
                raise InputError(problem, file=self.path, line=joint.line)
        roots = [link for link in links if link.get("name") not in into]
        if len(roots) > 1:
            problem = f"has {len(roots)} links without a parent, not one: {listing(r.get('name') for r in roots)}"
            raise self.fail(roots[1], problem)
        return roots[0].get("name")

    def note_mimics(self, elements: list[Any]) -> None:
        names = [element.get("name") for element in elements]
        for name, element in zip(names, elements, strict=True):
            mimic = self.child(element, "mimic", f"joint {name!r}")
            if mimic is None:
                continue
            target = mimic.get("joint")
            if target not in names or target == name:
                valid = listing(other for other in names if other != name)
                raise self.fail(mimic, f"joint {name!r} mimics {target!r}, which is no other joint; valid: {valid}")
            self.notes.append(f"joint {name!r}, line {mimic.sourceline}: mimic of {target!r} is not applied")
