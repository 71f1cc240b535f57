"""Angiography systems and gantries: on the floor, on the ceiling, on a driven base, both (biplane), and as a ring."""

from carm_family.imaging import imaging
from carm_family.parts import (
    QUARTER,
    ZERO,
    Machine,
    Stage,
    Vector,
    X,
    Y,
    Z,
    arc,
    box,
    cylinder,
    prismatic,
    revolute,
)

ANGIO = (
    "The numbers are those of no particular product: ranges, source to detector distance and the height of the "
    "isocentre (1070 mm) are typical data sheet values of angiography systems; all other lengths are estimates, and so "
    "are the shapes, which serve only for drawing."
)
REACH = 1.05
"""From the holder to the isocentre."""
CEILING = 2.9


def angio_axes(
    carrier: str,
    prefix: str,
    xyz: Vector,
    angular_deg: tuple[float, float],
    orbital_deg: tuple[float, float],
    *,
    rpy: Vector = ZERO,
    R: float = 0.0,
) -> tuple[Stage, ...]:
    """The two axes of an angiography system: about the holder's own axis, then about that of the C's circle."""
    return (
        revolute(
            f"{prefix}angular",
            carrier,
            f"{prefix}holder",
            X,
            angular_deg,
            xyz=xyz,
            rpy=rpy,
            shapes=(box((0.2, 0.24, 0.4), (0.1, 0, 0)),),
            comment="Angular axis (alpha): the holder's own axis.",
        ),
        revolute(
            f"{prefix}orbital",
            f"{prefix}holder",
            f"{prefix}c_arm",
            Y,
            orbital_deg,
            xyz=(REACH, 0, R),
            shapes=arc(0.8, 90, 270, 9, (0.1, 0.16)),
            comment="Orbital axis (beta): the axis of the C's own circle.",
        ),
    )


def floor_angio() -> Machine:
    """One C on a stand."""
    stand = revolute(
        "stand",
        "floor",
        "column",
        Z,
        (-90, 90),
        shapes=(cylinder(0.34, 0.1, (0, 0, 0.05)), box((0.4, 0.36, 1.2), (0, 0, 0.7))),
        comment="Stand: it turns on a bearing in the floor, to park the C.",
    )
    axes = angio_axes("column", "", (0.2, 0, 1.07), (-130, 130), (-55, 55))
    parts = imaging("c_arm", (0, 0, -0.75), (0, 0, 0.35), (0.1, 0.2, 0.6), (0.1, 0.2, 0.3))
    return Machine(
        "floor_angio", "Floor-mounted angiography system, isocentric.", ANGIO, "floor", (stand, *axes, *parts)
    )


def ceiling_angio() -> Machine:
    """One C on a column that hangs from rails."""
    rails = (
        prismatic(
            "rail_x",
            "room",
            "bridge",
            X,
            (-2, 2),
            xyz=(0, 0, CEILING),
            shapes=(box((0.5, 1.2, 0.08), (0, 0, -0.04)),),
            comment="Rails on the ceiling, along and across the table.",
        ),
        prismatic("rail_y", "bridge", "carriage", Y, (-0.5, 0.5), shapes=(box((0.5, 0.5, 0.12), (0, 0, -0.14)),)),
        revolute(
            "column",
            "carriage",
            "column_link",
            Z,
            (-135, 135),
            shapes=(box((0.26, 0.3, 1.86), (0, 0, -1.13)),),
            comment="Column: it hangs from the carriage and turns about its own axis.",
        ),
    )
    axes = angio_axes("column_link", "", (0.13, 0, 1.07 - CEILING), (-120, 120), (-50, 50), R=0.005)
    parts = imaging("c_arm", (0, 0, -0.75), (0, 0, 0.4), (-0.12, 0.18, 0.66), (-0.2, 0.1, 0.8))
    return Machine(
        "ceiling_angio",
        "Ceiling-mounted angiography system, R = 5 mm.",
        f"{ANGIO} R is an estimate of what a long column does to an isocentric design.",
        "room",
        (*rails, *axes, *parts),
        (box((3.0, 1.6, 0.06), (0.6, 0, CEILING + 0.03)),),
    )


def driven_gantry() -> Machine:
    """One C on a base that drives through the room."""
    base = (
        Stage(
            "drive",
            "floor",
            "platform",
            type="planar",
            axis=Z,
            shapes=(
                box((1.5, 0.9, 0.24), (-0.05, 0, 0.2)),
                *(cylinder(0.1, 0.7, (x, 0, 0.1), (QUARTER, 0, 0)) for x in (0.5, -0.6)),
            ),
            comment="Platform: it drives on the floor, freely in its plane.",
        ),
        revolute(
            "offset_arm",
            "platform",
            "column",
            Z,
            (-100, 100),
            xyz=(-0.1, 0, 0.32),
            shapes=(cylinder(0.3, 0.12, (0, 0, 0.06)), box((0.4, 0.36, 0.95), (0, 0, 0.55))),
            comment="Offset arm: the gantry turns on the platform.",
        ),
    )
    axes = angio_axes("column", "", (0.2, 0, 0.75), (-117, 105), (-50, 45), R=-0.008)
    parts = imaging("c_arm", (0, 0, -0.72), (0, 0, 0.36), (0.15, -0.16, 0.64), (0, 0.3, -0.5))
    return Machine(
        "driven_gantry",
        "Angiography gantry on a mobile base that drives through the room, R = 8 mm: the orbital axis passes below the "
        "angular one.",
        f"{ANGIO} R is an estimate.",
        "floor",
        (*base, *axes, *parts),
    )


def biplane() -> Machine:
    """Two branches: a frontal C on the floor and a lateral one on the ceiling, with a common isocentre."""
    shoulder = 0.2 + REACH
    frontal = (
        Stage(
            "stand",
            "room",
            "column",
            shapes=(cylinder(0.34, 0.1, (0, 0, 0.05)), box((0.4, 0.36, 1.2), (0, 0, 0.7))),
            comment="Frontal plane: a stand that is bolted to the floor. Its angular axis gives LAO and RAO.",
        ),
        *angio_axes("column", "frontal_", (0.2, 0, 1.07), (-130, 130), (-50, 50)),
        *imaging("frontal_c_arm", (0, 0, -0.75), (0, 0, 0.35), (0.1, 0.2, 0.6), (0.1, 0.2, 0.3), suffix="_frontal"),
    )
    lateral = (
        prismatic(
            "lateral_rail",
            "room",
            "lateral_carriage",
            X,
            (-0.5, 2.5),
            xyz=(shoulder, 0, CEILING),
            shapes=(box((0.6, 0.6, 0.1), (0, 0, -0.05)), box((0.3, 0.34, 0.7), (0, 0, -0.43))),
            comment="Lateral plane: it hangs from a rail on the ceiling. At zero the C opens downwards, in the\n"
            "upright plane across the table, and the beam is horizontal, from right to left.",
        ),
        *angio_axes(
            "lateral_carriage",
            "lateral_",
            (0, 0, 1.07 + REACH - CEILING),
            (-45, 45),
            (-27, 90),
            rpy=(-QUARTER, QUARTER, 0),
        ),
        *imaging("lateral_c_arm", (0, 0, -0.75), (0, 0, 0.4), (-0.15, 0.1, 0.65), (0.4, 0, -0.3), suffix="_lateral"),
    )
    return Machine(
        "biplane",
        "Biplane angiography system: a frontal and a lateral C about one isocentre, each with a sensor of its own "
        "(sensor_frontal, sensor_lateral).",
        ANGIO,
        "room",
        (*frontal, *lateral),
        (box((3.4, 1.6, 0.06), (1.1, 0, CEILING + 0.03)),),
    )


def ring_gantry() -> Machine:
    """A closed ring on a cart."""
    cart = (
        prismatic(
            "longitudinal",
            "cart",
            "slide",
            Y,
            (-0.2, 0.2),
            xyz=(0, 0, 0.6),
            shapes=(box((0.5, 0.7, 0.3), (0, 0, 0.05)),),
            comment="Cart: braked. The gantry moves along the patient, up and down, and towards the patient.",
        ),
        prismatic("lift", "slide", "column", Z, (0, 0.45), xyz=(0, 0, 0.3), shapes=(box((0.3, 0.4, 0.5)),)),
        prismatic(
            "lateral",
            "column",
            "arm",
            X,
            (-0.15, 0.15),
            xyz=(0, 0, 0.25),
            shapes=(box((0.5, 0.3, 0.24), (0.1, 0, 0)),),
        ),
        revolute("wag", "arm", "head", Z, (-30, 30), xyz=(0.3, 0, 0), shapes=(cylinder(0.13, 0.3, (0.05, 0, 0)),)),
    )
    axes = (
        revolute(
            "angular",
            "head",
            "ring",
            X,
            (-45, 45),
            xyz=(0.15, 0, 0),
            shapes=arc(0.62, 0, 360, 24, (0.2, 0.3), (0.72, 0, 0)),
            comment="Angular axis (alpha): the ring tilts.",
        ),
        revolute(
            "orbital",
            "ring",
            "rotor",
            Y,
            (-180, 180),
            xyz=(0.72, 0, 0.002),
            comment="Orbital axis (beta): the rotor turns inside the ring, by 360 deg.",
        ),
    )
    parts = imaging("rotor", (0, 0, -0.6), (0, 0, 0.5), (0.12, 0.2, 0.62), (0, 0, 1.0), size=0.8)
    return Machine(
        "ring_gantry",
        "Mobile ring gantry (O-arm-like): source and detector turn by 360 deg inside a closed ring that tilts; "
        "R = 2 mm.",
        "The ranges of tilt (45 deg), wag (30 deg) and rotor (360 deg) are typical data sheet values; all lengths are "
        "estimates, and so are the shapes, which serve only for drawing. The sensor sits on the rotor.",
        "cart",
        (*cart, *axes, *parts),
        (
            box((0.9, 0.8, 0.4), (-0.1, 0, 0.36)),
            *(cylinder(0.09, 0.6, (x, 0, 0.09), (QUARTER, 0, 0)) for x in (0.2, -0.4)),
        ),
    )
