"""Parts of which the C-arm family is made, and their URDF text. Lengths are m, angles rad."""

from dataclasses import dataclass
from math import cos, pi, radians, sin
from textwrap import fill, indent

Vector = tuple[float, float, float]
ZERO: Vector = (0, 0, 0)
X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
QUARTER = pi / 2
CONVENTIONS = (
    "Lengths are m, angles rad. Where nothing else is said, the C stands upright at zero and opens along x, the "
    "detector above; x points to the patient, y to the left, z up. Effort and velocity are placeholders. Written by "
    "tools/make_urdf.py."
)


@dataclass(frozen=True)
class Shape:
    """A box or a cylinder (along its z) for drawing; its numbers are rounded to 0.1 mm."""

    geometry: str
    xyz: Vector = ZERO
    rpy: Vector = ZERO


@dataclass(frozen=True)
class Stage:
    """A joint and the link that it carries."""

    joint: str
    parent: str
    link: str
    xyz: Vector = ZERO
    rpy: Vector = ZERO
    type: str = "fixed"
    axis: Vector = X
    limits: tuple[float, float] = (0, 0)
    shapes: tuple[Shape, ...] = ()
    comment: str = ""


@dataclass(frozen=True)
class Machine:
    """A URDF: its base link and all stages, parents first."""

    name: str
    what: str
    """What it is, in a sentence or two."""
    sources: str
    """Where its numbers come from."""
    base: str
    stages: tuple[Stage, ...]
    base_shapes: tuple[Shape, ...] = ()


def box(size: Vector, xyz: Vector = ZERO, rpy: Vector = ZERO) -> Shape:
    """A box of this size about its middle."""
    return Shape(f'<box size="{_rounded(size)}"/>', xyz, rpy)


def cylinder(radius: float, length: float, xyz: Vector = ZERO, rpy: Vector = ZERO) -> Shape:
    """A cylinder about its middle."""
    return Shape(f'<cylinder radius="{_rounded([radius])}" length="{_rounded([length])}"/>', xyz, rpy)


def arc(
    radius: float, from_deg: float, to_deg: float, pieces: int, section: tuple[float, float], centre: Vector = ZERO
) -> tuple[Shape, ...]:
    """A curved beam about y in straight pieces; angles from x towards z, the section radial times along y."""
    step = radians(to_deg - from_deg) / pieces
    length = 1.05 * radius * abs(step)
    x, y, z = centre
    middles = [radians(from_deg) + (k + 0.5) * step for k in range(pieces)]
    return tuple(box((*section, length), (x + radius * cos(a), y, z + radius * sin(a)), (0, -a, 0)) for a in middles)


def revolute(joint: str, parent: str, link: str, axis: Vector, limits_deg: tuple[float, float], **rest) -> Stage:
    """A stage that turns, its limits in degrees."""
    low, high = limits_deg
    return Stage(joint, parent, link, type="revolute", axis=axis, limits=(radians(low), radians(high)), **rest)


def prismatic(joint: str, parent: str, link: str, axis: Vector, limits: tuple[float, float], **rest) -> Stage:
    """A stage that slides."""
    return Stage(joint, parent, link, type="prismatic", axis=axis, limits=limits, **rest)


def urdf_text(machine: Machine) -> str:
    """The file. The same machine gives the same text."""
    header = "\n\n".join(fill(part, 110) for part in (machine.what, machine.sources, CONVENTIONS))
    parts = ['<?xml version="1.0"?>', _comment(header), f'<robot name="{machine.name}">', ""]
    parts += [indent(_link(machine.base, machine.base_shapes), "  "), ""]
    for stage in machine.stages:
        text = _comment(stage.comment) + "\n" if stage.comment else ""
        parts += [indent(text + _joint(stage) + "\n" + _link(stage.link, stage.shapes), "  "), ""]
    return "\n".join([*parts, "</robot>", ""])


def _joint(stage: Stage) -> str:
    lines = [f'<joint name="{stage.joint}" type="{stage.type}">']
    lines += [f'  <parent link="{stage.parent}"/>', f'  <child link="{stage.link}"/>']
    if stage.xyz != ZERO or stage.rpy != ZERO:
        lines.append(f"  <origin{_place(stage.xyz, stage.rpy, _exact)}/>")
    if stage.type != "fixed":
        lines.append(f'  <axis xyz="{_exact(stage.axis)}"/>')
    if stage.type in ("revolute", "prismatic"):
        low, high = (_exact([limit]) for limit in stage.limits)
        lines.append(f'  <limit lower="{low}" upper="{high}" effort="500" velocity="0.5"/>')
    return "\n".join([*lines, "</joint>"])


def _link(name: str, shapes: tuple[Shape, ...]) -> str:
    if not shapes:
        return f'<link name="{name}"/>'
    lines = [f'<link name="{name}">']
    for shape in shapes:
        place = _place(shape.xyz, shape.rpy, _rounded)
        origin = f"<origin{place}/>" if place else ""
        lines.append(f"  <visual>{origin}<geometry>{shape.geometry}</geometry></visual>")
    return "\n".join([*lines, "</link>"])


def _place(xyz: Vector, rpy: Vector, words) -> str:
    place = f' xyz="{words(xyz)}"' if xyz != ZERO or rpy != ZERO else ""
    return place + (f' rpy="{words(rpy)}"' if rpy != ZERO else "")


def _comment(text: str) -> str:
    lines = text.strip().splitlines()
    return f"<!-- {lines[0]} -->" if len(lines) == 1 else "<!--\n" + indent("\n".join(lines), "  ") + "\n-->"


def _exact(values) -> str:
    """Numbers that read back to the last bit."""
    return " ".join(repr(value + 0.0).removesuffix(".0") for value in values)


def _rounded(values) -> str:
    return " ".join(f"{round(value, 4) + 0.0:.4f}".rstrip("0").rstrip(".") for value in values)
