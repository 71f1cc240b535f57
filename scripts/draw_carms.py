"""Draw the bundled C-arms from the side, from their URDFs' own numbers: python scripts/draw_carms.py OUT.svg

All joints stand at zero and the view is along +y. Grey shapes are the URDF's visuals; marks are computed.
"""

import sys
from itertools import product
from pathlib import Path

import lxml.etree as etree
import numpy as np
from scipy.spatial import ConvexHull

from carm_kin.chain import chain_of, nominal_geometry
from carm_kin.urdf import UrdfFile, bundled_urdfs, read_urdf
from solvers.se3 import Array, rot_x, rot_y, rot_z, transform

SCALE = 225.0
"""Pixels per metre."""
PANEL = 580, 470
VIEW = -0.5, -0.06
"""x and z (m) at the lower left corner of a panel."""
FILLS = {"c_arm": "#9fb8d4", "source": "#e8c37e", "detector": "#a9cfa0", "sensor": "#2e8b57", "post": "#2e8b57"}
RED, BLUE, GREEN, GREY = "#c0392b", "#1f4e9c", "#2e8b57", "#555555"
X, Z = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])


def link_poses(urdf: UrdfFile) -> dict[str, Array]:
    """T_base_link (4, 4) of every link with all joints at zero."""
    poses = {urdf.base: np.eye(4)}
    waiting = list(urdf.joints)
    while waiting:
        joint = next(joint for joint in waiting if joint.parent in poses)
        poses[joint.child] = poses[joint.parent] @ joint.origin
        waiting.remove(joint)
    return poses


def outline(visual: etree._Element, T_base_link: Array) -> Array:
    """Corners (n, 2) of a box's or cylinder's shadow on the x-z plane, m."""
    origin = visual.find("origin")
    attributes = {} if origin is None else origin.attrib
    xyz, rpy = (np.array(attributes.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
    T = T_base_link @ transform(rot_z(rpy[2]) @ rot_y(rpy[1]) @ rot_x(rpy[0]), xyz)
    box, cylinder = visual.find("geometry/box"), visual.find("geometry/cylinder")
    if box is not None:
        points = np.array(list(product((-0.5, 0.5), repeat=3))) * np.array(box.get("size").split(), dtype=float)
    else:
        radius, length = float(cylinder.get("radius")), float(cylinder.get("length"))
        phi = np.linspace(0, 2 * np.pi, 25)
        points = np.array([[radius * np.cos(a), radius * np.sin(a), s * length / 2] for a in phi for s in (-1, 1)])
    shadow = (points @ T[:3, :3].T + T[:3, 3])[:, [0, 2]]
    return shadow[ConvexHull(shadow).vertices]


class Panel:
    """One machine's cell of the drawing; positions are x, z in m."""

    def __init__(self, svg: etree._Element, column: int, row: int):
        self.group = etree.SubElement(svg, "g", transform=f"translate({column * PANEL[0]} {row * PANEL[1]})")

    def at(self, point: Array) -> tuple[float, float]:
        return (point[0] - VIEW[0]) * SCALE, PANEL[1] - (point[-1] - VIEW[1]) * SCALE

    def polygon(self, points: Array, fill: str) -> None:
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self.at, points))
        etree.SubElement(self.group, "polygon", points=text, fill=fill, stroke=GREY, **{"stroke-width": "0.6"})

    def line(self, a: Array, b: Array, colour: str, dashes: str = "none", width: float = 1.3) -> None:
        (x1, y1), (x2, y2) = self.at(a), self.at(b)
        ends = {"x1": f"{x1:.1f}", "y1": f"{y1:.1f}", "x2": f"{x2:.1f}", "y2": f"{y2:.1f}"}
        style = {"stroke": colour, "stroke-width": f"{width}", "stroke-dasharray": dashes}
        etree.SubElement(self.group, "line", ends | style)

    def text(self, point: Array, words: str, colour: str = "black", size: int = 14, anchor: str = "start") -> None:
        x, y = self.at(point)
        style = {"fill": colour, "font-size": str(size), "text-anchor": anchor}
        etree.SubElement(self.group, "text", {"x": f"{x:.1f}", "y": f"{y:.1f}"} | style).text = words

    def pivot(self, point: Array) -> None:
        """A dot in a ring: the rotation centre, the orbital axis normal to the page."""
        x, y = self.at(point)
        place = {"cx": f"{x:.1f}", "cy": f"{y:.1f}"}
        etree.SubElement(
            self.group, "circle", place | {"r": "6.5", "fill": "none", "stroke": BLUE, "stroke-width": "1.6"}
        )
        etree.SubElement(self.group, "circle", place | {"r": "2.2", "fill": BLUE})

    def cross(self, point: Array) -> None:
        """The torus centre."""
        for arm in (0.02 * (X + Z), 0.02 * (X - Z)):
            self.line(point - arm, point + arm, RED, width=2)

    def dimension(self, a: Array, b: Array, x: float, words: str, colour: str) -> None:
        """A vertical dimension line at ``x`` between the heights of two points."""
        low, high = np.array([x, 0, a[2]]), np.array([x, 0, b[2]])
        for point, end in ((a, low), (b, high)):
            self.line(point, end + 0.02 * X, colour, "2 3", 0.8)
        self.line(low, high, colour)
        self.text((low + high) / 2 + 0.025 * X - 0.02 * Z, words, colour)


def draw_machine(panel: Panel, urdf: UrdfFile) -> None:
    geometry, poses = nominal_geometry(chain_of(urdf)), link_poses(urdf)
    for link in etree.fromstring(urdf.data).iterchildren("link"):
        for visual in link.iterchildren("visual"):
            panel.polygon(outline(visual, poses[link.get("name")]), FILLS.get(link.get("name"), "#dddddd"))
    center = geometry.T_base_torus[:3, 3]
    pivot = center + geometry.major_radius * geometry.T_base_torus[:3, 2]
    source, detector, sensor = (poses[name][:3, 3] for name in ("source", "detector", "sensor"))
    panel.line(source, detector, GREY, "1 3", 1)
    panel.line(center - X, center + 0.24 * X, RED, "12 3 2 3")
    panel.line(sensor, pivot, GREEN, "5 3")
    panel.cross(center)
    panel.pivot(pivot)
    panel.dimension(source, detector, 1.68, f"{np.linalg.norm(detector - source) * 1e3:.0f} mm", GREY)
    if not geometry.isocentric:
        panel.dimension(center, pivot, 1.52, "R", RED)
    panel.text(source - 0.15 * X + 0.13 * Z, "source", anchor="end")
    panel.text(detector + 0.19 * X + 0.03 * Z, "detector")
    panel.text(sensor + 0.06 * X, "sensor", GREEN)
    size = f"R = {abs(geometry.major_radius) * 1e3:.0f} mm, ε = {np.degrees(geometry.non_orthogonality):.1f}°"
    panel.text(np.array([VIEW[0] + 0.06, 0, 1.93]), f"{urdf.name}: {size}", size=16)


def draw_legend(panel: Panel) -> None:
    x, z = VIEW[0] + 0.25, 1.5
    rows = [
        "angular axis (α): the whole C turns about it",
        "rotation centre (pivot); the orbital axis (β) is normal to the page",
        "torus centre: foot of the axes' common perpendicular, of length R",
        "offset t, from the sensor to the rotation centre",
        "beam, from the focal spot to the detector's face",
    ]
    places = [np.array([x, 0, z - 0.17 * i]) for i in range(len(rows))]
    half = 0.09 * X
    panel.line(places[0] - half, places[0] + half, RED, "12 3 2 3")
    panel.pivot(places[1])
    panel.cross(places[2])
    panel.line(places[3] - half, places[3] + half, GREEN, "5 3")
    panel.line(places[4] - half, places[4] + half, GREY, "1 3", 1)
    for place, words in zip(places, rows, strict=True):
        panel.text(place + 0.14 * X - 0.02 * Z, words, size=13)
    panel.text(np.array([x - 0.09, 0, z - 1.05]), "All joints at zero, seen from the right; x forward, z up.", GREY, 13)


def draw(urdfs: list[UrdfFile]) -> bytes:
    """The drawing as SVG: two machines a row, the legend last."""
    width, height = 2 * PANEL[0], (len(urdfs) // 2 + 1) * PANEL[1]
    size = {"width": str(width), "height": str(height), "viewBox": f"0 0 {width} {height}"}
    svg = etree.Element("svg", size | {"font-family": "sans-serif"}, nsmap={None: "http://www.w3.org/2000/svg"})
    etree.SubElement(svg, "rect", width="100%", height="100%", fill="white")
    for i, urdf in enumerate(urdfs):
        draw_machine(Panel(svg, i % 2, i // 2), urdf)
    draw_legend(Panel(svg, len(urdfs) % 2, len(urdfs) // 2))
    return etree.tostring(svg, pretty_print=True)


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(draw([read_urdf(path) for path in bundled_urdfs().values()]))
