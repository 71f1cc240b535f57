"""Draw frames, axes and angles from the chain itself: python tools/draw_conventions.py docs/conventions.svg

Every point comes from `solvers.torus.Torus`; lengths are free, the non-orthogonality is zero.
"""

import sys
from pathlib import Path

import lxml.etree as etree
import numpy as np

from solvers.se3 import Array, inverse, rot_x, rot_y, rot_z, transform
from solvers.torus import Torus

SIZE = 780, 540
SCALE = 165.0
"""Pixels a unit of length."""
ORIGIN = 470, 345
"""Where the torus centre stands, pixels."""
VIEW = rot_x(np.radians(20)) @ rot_y(np.radians(-140))
"""From the drawing's right, up, towards the reader to the screen's."""
ALPHA, BETA = np.radians(40), np.radians(50)
RADIUS = 1.0
P_CARM_SENSOR = np.array([0.3, -0.65, 1.3])
R_CARM_SENSOR = rot_z(0.5) @ rot_x(-0.5) @ rot_y(0.4)
RED, GREEN, BLUE, ORANGE, PURPLE, GREY, INK = (
    "#c0392b",
    "#2a8a4a",
    "#1f5fbf",
    "#c46a00",
    "#7d3c98",
    "#7a7f87",
    "#1d2126",
)
TRIAD = RED, GREEN, BLUE


def pixels(point: Array) -> Array:
    """Torus coordinates (3,) -> screen (2,); the torus z points up, n to the left and out."""
    x, y, z = point
    u, v, _ = VIEW @ np.array([x, z, -y])
    return np.array([ORIGIN[0] + SCALE * u, ORIGIN[1] - SCALE * v])


class Drawing:
    """SVG elements in torus coordinates."""

    def __init__(self) -> None:
        style = {"font-family": "Helvetica, Arial, sans-serif", "stroke-linecap": "round"}
        self.svg = etree.Element("svg", xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {SIZE[0]} {SIZE[1]}", **style)
        self.add("title", {}).text = "Frames, axes and angles of the two-axis chain"
        self.add("rect", {"width": SIZE[0], "height": SIZE[1], "rx": 14, "fill": "#ffffff"})

    def add(self, tag: str, attributes: dict) -> etree._Element:
        return etree.SubElement(self.svg, tag, {key: str(value) for key, value in attributes.items()})

    def path(self, points: Array, colour: str, width: float = 1.6, dashes: str = "none", closed: bool = False) -> None:
        text = "M" + " L".join(f"{u:.1f} {v:.1f}" for u, v in map(pixels, points)) + ("Z" if closed else "")
        style = {"stroke": colour, "stroke-width": width, "stroke-dasharray": dashes, "fill": "none"}
        self.add("path", {"d": text} | style)

    def arrow(self, start: Array, end: Array, colour: str, width: float = 2.0, head: float = 9.0) -> None:
        a, b = pixels(start), pixels(end)
        along = (b - a) / np.linalg.norm(b - a)
        base, across = b - head * along, 0.38 * head * np.array([-along[1], along[0]])
        line = dict(zip(("x1", "y1", "x2", "y2"), np.round([*a, *base], 1), strict=True))
        self.add("line", line | {"stroke": colour, "stroke-width": width})
        corners = " ".join(f"{u:.1f},{v:.1f}" for u, v in (b, base + across, base - across))
        self.add("polygon", {"points": corners, "fill": colour})

    def dot(self, point: Array, colour: str, radius: float = 4.5) -> None:
        u, v = np.round(pixels(point), 1)
        self.add("circle", {"cx": u, "cy": v, "r": radius, "fill": colour})

    def text(
        self, point: Array, words: str, shift: tuple[float, float], colour: str = INK, size: int = 15, **style: str
    ) -> None:
        u, v = np.round(pixels(point) + shift, 1)
        # A white rim keeps words legible where a line passes behind them.
        rim = {"paint-order": "stroke", "stroke": "#ffffff", "stroke-width": 4, "stroke-linejoin": "round"}
        look = {"x": u, "y": v, "fill": colour, "font-size": size} | rim
        self.add("text", look | {key.replace("_", "-"): value for key, value in style.items()}).text = words

    def triad(self, T: Array, length: float, shifts: list[tuple[float, float]]) -> None:
        """The axes of a frame (4, 4) and their letters."""
        for axis, colour, letter, shift in zip(T[:3, :3].T, TRIAD, "xyz", shifts, strict=True):
            tip = T[:3, 3] + length * axis
            self.arrow(T[:3, 3], tip, colour, 2.6, 8)
            self.text(tip, letter, shift, colour, 13, font_weight="bold")

    def arc(self, center: Array, start: Array, end: Array, colour: str) -> Array:
        """An angle's arc with an arrowhead; returns its middle."""
        turn = np.linspace(0, 1, 40)[:, None]
        points = (1 - turn) * start + turn * end
        radius = np.linalg.norm(start)
        points = center + radius * points / np.linalg.norm(points, axis=1, keepdims=True)
        self.path(points[:-4], colour, 2)
        self.arrow(points[-5], points[-1], colour, 2, 8)
        return points[len(points) // 2]


def circle(center: Array, radius: float, e: Array, f: Array) -> Array:
    turn = np.linspace(0, 2 * np.pi, 121)[:-1, None]
    return center + radius * (np.cos(turn) * e + np.sin(turn) * f)


def draw(torus: Torus) -> Drawing:
    angles = np.array([[ALPHA, BETA], [ALPHA, 0.0], [0.0, 0.0]])
    carm, at_beta_zero, at_zero = torus.T_torus_carm(angles)
    sensor = torus.poses(angles[:1], np.zeros(1, dtype=int))[0]
    c, pivot, s = np.zeros(3), carm[:3, 3], sensor[:3, 3]
    n, a, z0 = np.eye(3)[0], carm[:3, 1], at_beta_zero[:3, 2]
    middle = pivot + a * (a @ (s - pivot))
    picture = Drawing()

    picture.path(circle(c, torus.major_radius, *np.eye(3)[1:]), GREY, 1.6, "6 5", closed=True)
    orbit = circle(middle, torus.minor_radius, at_beta_zero[:3, 0], z0)
    picture.path(orbit, ORANGE, 1.6, "6 5", closed=True)
    picture.arrow(-1.15 * n, 1.5 * n, INK, 1.6)
    picture.arrow(pivot - 1.0 * a, pivot + 1.35 * a, INK, 1.6)
    picture.path(np.array([c, at_zero[:3, 3]]), GREY, 1.2, "2 4")
    picture.path(np.array([c, pivot]), INK, 2.2)
    for z in (z0, carm[:3, 2]):
        picture.path(np.array([pivot, pivot + 0.95 * z]), GREY, 1.2, "2 4")
    picture.path(np.array([middle, s]), ORANGE, 1.8)
    picture.arrow(s, pivot, PURPLE, 2.6, 11)

    alpha = picture.arc(c, 0.55 * at_zero[:3, 2], 0.55 * z0, INK)
    beta = picture.arc(pivot, 0.8 * z0, 0.8 * carm[:3, 2], INK)
    picture.triad(np.eye(4), 0.36, [(-4, 19), (6, 10), (-15, 4)])
    picture.triad(carm, 0.36, [(-4, 17), (6, 12), (-14, 2)])
    picture.triad(sensor, 0.28, [(5, 14), (6, 2), (-14, 0)])
    for point, colour in ((c, INK), (pivot, PURPLE), (s, ORANGE)):
        picture.dot(point, colour)
    picture.dot(middle, ORANGE, 3)

    rim = circle(c, torus.major_radius, *np.eye(3)[1:])
    picture.text(alpha, "α", (-6, -9), size=19)
    picture.text(beta, "β", (-12, -8), size=19)
    picture.text(0.5 * (c + pivot), "R", (-22, 10), size=19, font_style="italic")
    picture.text(0.5 * (middle + s), "b", (-6, 24), ORANGE, 19, font_style="italic")
    picture.text(0.5 * (s + pivot), "t", (-34, -9), PURPLE, 19, font_style="italic")
    picture.text(c, "torus", (-34, 46), font_weight="bold")
    picture.text(c, "centre c", (-34, 63), GREY, 13)
    picture.text(pivot, "carm", (18, 14), font_weight="bold")
    picture.text(pivot, "pivot", (18, 31), GREY, 13)
    picture.text(s, "sensor", (-62, 22), font_weight="bold")
    picture.text(1.5 * n, "angular axis n", (-112, 12))
    picture.text(pivot + 1.35 * a, "orbital axis a", (8, 4))
    picture.text(rim[98], "circle of the pivot", (10, 14), GREY, 13)
    picture.text(orbit[60], "orbit of the sensor", (14, -4), ORANGE, 13)
    return picture


def main() -> None:
    T_sensor_carm = inverse(transform(R_CARM_SENSOR, P_CARM_SENSOR))
    torus = Torus(np.eye(4)[None], RADIUS, 0.0, T_sensor_carm, np.array([True]), orbital_referenced=True)
    Path(sys.argv[1]).write_bytes(etree.tostring(draw(torus).svg, pretty_print=True))


if __name__ == "__main__":
    main()
