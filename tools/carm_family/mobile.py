"""Mobile C-arms on a cart, and the mini C-arm on a boom."""

from dataclasses import dataclass
from math import radians

from carm_family.imaging import half_circle, imaging
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

TYPICAL = (
    "The numbers are those of no particular product: ranges, source to detector distance and free space are typical "
    "data sheet values of mobile C-arms; all other lengths are estimates, and so are the shapes, which serve only for "
    "drawing."
)


@dataclass(frozen=True)
class Mobile:
    """A mobile C-arm: cart, column, wig-wag, horizontal travel, then the two axes."""

    name: str
    what: str
    sources: str = TYPICAL
    R: float = 0.0
    """Major radius: the height of the orbital axis over the angular one."""
    skew_deg: float = 0.0
    """Non-orthogonality of the two axes."""
    aside: float = 0.0
    """How far the middle of the C lies to the left of the angular axis."""
    beam: float = 0.0
    """How far the central ray lies before the orbital axis."""
    angular_deg: float = 225
    orbital_deg: tuple[float, float] = (-40, 110)
    sensor: Vector = (0.05, 0.12, 0.68)
    sensor_rpy: Vector = ZERO

    def machine(self) -> Machine:
        c_arm = revolute(
            "orbital",
            "swivel",
            "c_arm",
            Y,
            self.orbital_deg,
            xyz=(0.85, self.aside, self.R),
            rpy=(0, 0, radians(self.skew_deg)),
            shapes=half_circle(0.66),
            comment="Orbital axis (beta): the axis of the C's own circle.",
        )
        x, y, z = self.sensor
        parts = imaging("c_arm", (self.beam, 0, -0.53), (self.beam, 0, 0.49), (x + self.beam, y, z), self.sensor_rpy)
        stages = (*_cart(), *_column(0.3 - self.R), self._swivel(), c_arm, *parts)
        return Machine(self.name, self.what, self.sources, "floor", stages)

    def _swivel(self) -> Stage:
        """The bracket, and at its end the carriage in which the C slides."""
        return revolute(
            "angular",
            "arm",
            "swivel",
            X,
            (-self.angular_deg, self.angular_deg),
            xyz=(0.4, 0, 0),
            shapes=(
                box((0.12, 0.16, 0.52 + self.R), (0.08, 0, 0.16 + self.R / 2)),
                box((0.1, 0.16, 0.22), (0.218, 0, 0.365 + self.R), (0, radians(-150), 0)),
            ),
            comment="Angular axis (alpha): the arm's own axis. The whole C turns about it.",
        )


def _cart() -> tuple[Stage, ...]:
    """From the floor to the cart."""
    body = box((0.75, 0.6, 0.48), (-0.075, 0, 0.32))
    wheels = [cylinder(0.08, 0.5, (x, 0, 0.08), (QUARTER, 0, 0)) for x in (0.2, -0.35)]
    return (
        prismatic("cart_x", "floor", "cart_along", X, (-2, 2), comment="Cart: it rolls on the floor and turns."),
        prismatic("cart_y", "cart_along", "cart_across", Y, (-2, 2)),
        revolute("cart_yaw", "cart_across", "cart", Z, (-180, 180), shapes=(body, *wheels)),
    )


def _column(head: float) -> tuple[Stage, ...]:
    """From the cart to the arm, whose head sits at this height over the column's middle."""
    return (
        prismatic(
            "lift",
            "cart",
            "column",
            Z,
            (0, 0.45),
            xyz=(0.15, 0, 0.75),
            shapes=(box((0.18, 0.22, 0.55)),),
            comment="Column: it lifts the arm.",
        ),
        revolute(
            "wig_wag",
            "column",
            "head",
            Z,
            (-12, 12),
            xyz=(0, 0, head),
            shapes=(box((0.24, 0.24, 0.16)),),
            comment="Wig-wag: the arm swings sideways on the column.",
        ),
        prismatic(
            "horizontal",
            "head",
            "arm",
            X,
            (-0.1, 0.1),
            shapes=(cylinder(0.05, 0.56, (0.13, 0, 0), (0, QUARTER, 0)),),
            comment="Horizontal travel: the arm slides in the head.",
        ),
    )


MOBILES = (
    Mobile(
        "mobile_isocentric",
        "Isocentric mobile C-arm: the angular and the orbital axis meet, R = 0.",
    ),
    Mobile(
        "mobile_nonisocentric",
        "Non-isocentric mobile C-arm: the orbital axis passes 100 mm above the angular axis at a right angle.",
        R=0.1,
        sensor=(0.08, -0.13, 0.7),
        sensor_rpy=(0, 0, QUARTER),
    ),
    Mobile(
        "mobile_skewed",
        "Non-isocentric mobile C-arm as built: R = 60 mm, the axes 0.7 deg off a right angle, the C 4 mm off the "
        "middle, and the sensor mounted askew.",
        R=0.06,
        skew_deg=0.7,
        aside=0.004,
        sensor=(0.03, 0.14, 0.69),
        sensor_rpy=(0.3, -0.2, 1.1),
    ),
    Mobile(
        "mobile_residual",
        "A mobile C-arm that was designed isocentric, as built: the axes miss each other by R = 12 mm and are "
        "0.2 deg off a right angle.",
        R=0.012,
        skew_deg=0.2,
        aside=-0.002,
        sensor=(0.06, 0.1, 0.7),
        sensor_rpy=(0.05, 0.1, -0.4),
    ),
    Mobile(
        "mobile_3d",
        "Isocentric mobile C-arm for 3D scans: the C slides by 195 deg, the axes meet.",
        "The ranges (orbital 195 deg, angular 220 deg either way) are those published for a Cios Spin; the source to "
        "detector distance is a typical data sheet value; all other lengths are estimates, and so are the shapes, "
        "which serve only for drawing.",
        angular_deg=220,
        orbital_deg=(-97.5, 97.5),
        sensor=(-0.04, 0.15, 0.71),
        sensor_rpy=(0, 0.2, 0.3),
    ),
    Mobile(
        "mobile_beam_offset",
        "Mobile C-arm whose central ray misses the orbital axis: it passes 157.6 mm before it.",
        "157.6 mm is the offset published for a Cios Fusion. Ranges, the source to detector distance (1020 mm) and the "
        "height of the orbital axis over the focal spot (530 mm) are data sheet values of that machine, as DeepDRR has "
        "them; R = 30 mm and all other lengths are estimates, and so are the shapes, which serve only for drawing.",
        R=0.03,
        beam=0.1576,
        sensor=(0.02, 0.13, 0.69),
        sensor_rpy=(0.2, 0.1, -0.6),
    ),
)


def mini_boom() -> Machine:
    """A mini C-arm."""
    boom = [
        revolute(
            f"boom_{k}",
            parent,
            f"boom_link_{k}",
            Z,
            (-limit, limit),
            xyz=xyz,
            shapes=(cylinder(0.05, 0.12), box((length, 0.06, 0.06), (length / 2, 0, 0))),
            comment=comment,
        )
        for k, parent, xyz, length, limit, comment in (
            (1, "column", (0, 0, 0.55), 0.45, 150, "Boom: three parallel vertical axes."),
            (2, "boom_link_1", (0.45, 0, -0.09), 0.4, 160, ""),
            (3, "boom_link_2", (0.4, 0, -0.09), 0.1, 150, ""),
        )
    ]
    base = (
        box((0.62, 0.56, 0.2), (-0.05, 0, 0.16)),
        box((0.3, 0.34, 0.36), (-0.1, 0, 0.44)),
        *(cylinder(0.06, 0.5, (x, 0, 0.06), (QUARTER, 0, 0)) for x in (0.2, -0.3)),
    )
    axes = (
        revolute(
            "angular",
            "boom_link_3",
            "swivel",
            X,
            (-180, 180),
            xyz=(0.12, 0, 0),
            shapes=(cylinder(0.035, 0.1, (0.04, 0, 0), (0, QUARTER, 0)), box((0.08, 0.1, 0.16), (0.12, 0, 0))),
            comment="Angular axis (alpha): the C turns about the end of the boom.",
        ),
        revolute(
            "orbital",
            "swivel",
            "c_arm",
            Y,
            (-75, 75),
            xyz=(0.46, 0, 0),
            shapes=arc(0.3, 90, 270, 9, (0.035, 0.07)),
            comment="Orbital axis (beta): the axis of the C's own circle.",
        ),
    )
    parts = imaging("c_arm", (0, 0, -0.24), (0, 0, 0.21), (0.03, 0.06, 0.32), (0, 0, 0.5), size=0.45)
    column = prismatic(
        "lift",
        "stand",
        "column",
        Z,
        (0, 0.35),
        xyz=(-0.1, 0, 0.6),
        shapes=(box((0.1, 0.1, 0.9), (0, 0, 0.05)),),
        comment="Column: it lifts the boom.",
    )
    return Machine(
        "mini_boom",
        "Mini C-arm for hands and feet on a boom of three parallel revolute joints. The stand is braked.",
        "The numbers are those of no particular product: source to detector distance (450 mm) and ranges are typical "
        "of mini C-arms; all other lengths are estimates, and so are the shapes, which serve only for drawing.",
        "stand",
        (column, *boom, *axes, *parts),
        base,
    )
