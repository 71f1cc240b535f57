"""A C in the hand of an industrial robot, and a C whose orbital joint stands before the angular one."""

from math import radians

from carm_family.imaging import half_circle, imaging
from carm_family.parts import (
    QUARTER,
    Machine,
    Shape,
    Stage,
    Vector,
    X,
    Y,
    Z,
    arc,
    box,
    cylinder,
    revolute,
)

READY_DEG = 0, -70, 85, 90, 90, -105
"""The robot's own joint angles with the C upright: zero of the URDF's joints."""
ROBOT_RANGES_DEG = (-185, 185), (-140, -5), (-120, 155), (-350, 350), (-125, 125), (-350, 350)


def robot_held() -> Machine:
    """A C that has no axes of its own."""
    joints: tuple[tuple[Vector, Vector, tuple[Shape, ...]], ...] = (
        ((0, 0, 0.675), Z, (box((0.7, 0.5, 0.4), (0.1, 0, 0)),)),
        ((0.35, 0, 0), Y, (box((1.3, 0.24, 0.28), (0.575, -0.12, 0)),)),
        ((1.15, 0, 0), Y, (box((0.5, 0.3, 0.36), (0.05, 0, -0.041)),)),
        ((0, 0, -0.041), X, (box((0.85, 0.22, 0.22), (0.65, 0, 0)),)),
        ((1.2, 0, 0), Y, (cylinder(0.13, 0.3, rpy=(QUARTER, 0, 0)),)),
        ((0.215, 0, 0), X, (cylinder(0.1, 0.06, rpy=(0, QUARTER, 0)),)),
    )
    stages = []
    for k, ((xyz, axis, shapes), ready, (low, high)) in enumerate(
        zip(joints, READY_DEG, ROBOT_RANGES_DEG, strict=True), 1
    ):
        x, y, z = (radians(ready) * part for part in axis)
        parent = f"link_{k - 1}" if k > 1 else "pedestal"
        limits = (low - ready, high - ready)
        stages.append(revolute(f"joint_{k}", parent, f"link_{k}", axis, limits, xyz=xyz, rpy=(x, y, z), shapes=shapes))
    c_arm = Stage(
        "c_arm_mount",
        "link_6",
        "c_arm",
        (0.085, -0.69, 0),
        (0, 0, -QUARTER),
        shapes=(*half_circle(0.66), box((0.1, 0.2, 0.2), (-0.72, -0.05, 0))),
        comment="The flange holds the back of the C from its right side.",
    )
    isocenter = Stage(
        "isocenter_mount",
        "c_arm",
        "isocenter",
        comment="Virtual pivot of the protocol `virtual`: x is the virtual angular axis, y the virtual orbital one.",
    )
    parts = imaging("c_arm", (0, 0, -0.53), (0, 0, 0.49), (0.07, 0.1, 0.7), (0.1, -0.1, 0.4))
    return Machine(
        "robot_held",
        "A C held by an industrial robot with a spherical wrist: six revolute joints, no angular and no orbital one. "
        "Its axes are virtual: the robot turns the C about the point and the axes that its program chooses.",
        "Lengths and ranges of the robot are those of a KUKA KR 210 R2700 extra (ros-industrial/kuka_experimental), "
        "its zero moved to a posture with the C upright: there the robot's own angles are 0, -70, 85, 90, 90, "
        "-105 deg. How it holds the C is an estimate, the places of source and detector are typical of mobile C-arms, "
        "and the shapes serve only for drawing.",
        "pedestal",
        (*stages, c_arm, isocenter, *parts),
        (cylinder(0.35, 0.1, (0, 0, 0.05)), cylinder(0.28, 0.45, (0, 0, 0.3))),
    )


def orbital_first() -> Machine:
    """A U-arm on a sliding C."""
    outer = revolute(
        "orbital",
        "stand",
        "outer_c",
        Y,
        (-55, 55),
        xyz=(1.25, 0, 1.1),
        shapes=(*arc(0.86, 120, 240, 7, (0.08, 0.14)), cylinder(0.06, 0.14, (-0.78, 0, 0.02), (0, QUARTER, 0))),
        comment="Orbital axis: the outer C slides in the stand. Nearer the base, it is the first axis (alpha).",
    )
    inner = revolute(
        "angular",
        "outer_c",
        "u_arm",
        X,
        (-100, 100),
        xyz=(-0.7, 0, 0.02),
        rpy=(0, 0, radians(0.3)),
        shapes=arc(0.66, 90, 270, 9, (0.06, 0.12), (0.7, 0, 0)),
        comment="Angular axis: the U-arm turns about the middle of the outer C. It is the second axis (beta).",
    )
    parts = imaging("u_arm", (0.7, 0, -0.55), (0.7, 0, 0.49), (0.75, 0.1, 0.72), (0.1, -0.2, 0.3))
    return Machine(
        "orbital_first",
        "A U-arm on the middle of a C that slides: the orbital joint stands before the angular one. R = 20 mm, the "
        "axes 0.3 deg off a right angle.",
        "No product is meant: all numbers are estimates, and so are the shapes, which serve only for drawing.",
        "stand",
        (outer, inner, *parts),
        (
            box((0.7, 0.6, 0.12), (0.15, 0, 0.06)),
            box((0.3, 0.36, 1.1), (0.15, 0, 0.6)),
            box((0.12, 0.24, 0.5), (0.32, 0, 1.1)),
        ),
    )
