"""Draw the bundled C-arms from their URDFs' own numbers: python tools/draw_carms.py OUT.svg

All joints stand at zero. Grey shapes are the URDF's visuals; marks are computed. Each machine has a scale of its own.
"""

import sys
from itertools import product
from pathlib import Path

import lxml.etree as etree
import numpy as np
from scipy.spatial import ConvexHull

from carm_kin.machine.chain import NominalGeometry, chain_of, nominal_geometry
from carm_kin.machine.urdf import UrdfFile, bundled_urdfs, read_urdf
from carm_kin.simulation.virtual import PIVOT, virtual_motions
from solvers.se3 import Array, rot_x, rot_y, rot_z, transform

COLUMNS = 3
PANEL = 460, 430
LEGEND = 290
"""Height of the legend below all panels."""
MARGIN = 40, 65, 85, 45
"""Left, top, right and bottom of a panel, pixels, for marks and words."""
FILLS = {"source": "#e8c37e", "detector": "#a9cfa0", "sensor": "#2e8b57"}
C_FILL = "#9fb8d4"
RED, BLUE, GREEN, GREY = "#c0392b", "#1f4e9c", "#2e8b57", "#555555"
FROM_RIGHT = np.array([[1.0, 0, 0], [0, 0, 1]])
"""Rows: what points right and up in the drawing, seen along y."""
FROM_PATIENT = np.array([[0, 1.0, 0], [0, 0, 1]])
"""The same seen against x."""


def link_poses(urdf: UrdfFile) -> dict[str, Array]:
    """T_base_link (4, 4) of every link with all joints at zero."""
    poses = {urdf.base: np.eye(4)}
    waiting = list(urdf.joints)
    while waiting:
        joint = next(joint for joint in waiting if joint.parent in poses)
        poses[joint.child] = poses[joint.parent] @ joint.origin
        waiting.remove(joint)
    return poses


def corners(visual: etree._Element, T_base_link: Array) -> Array:
    """Points (n, 3) whose hull is the box or cylinder, m."""
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
    return points @ T[:3, :3].T + T[:3, 3]


class Panel:
    """A cell of the drawing; positions are (3,) in m, placed by `fit`, or pixels from its upper left corner."""

    def __init__(self, svg: etree._Element, number: int):
        column, row = number % COLUMNS, number // COLUMNS
        self.group = etree.SubElement(svg, "g", transform=f"translate({column * PANEL[0]} {row * PANEL[1]})")
        self.view, self.scale, self.shift = FROM_RIGHT, 1.0, np.zeros(2)

    def fit(self, points: Array, view: Array) -> None:
        """Choose the scale and the place with which all points (n, 3) are seen."""
        flat = points @ view.T
        low, high = flat.min(axis=0), flat.max(axis=0)
        left, top, right, bottom = MARGIN
        room = np.array([PANEL[0] - left - right, PANEL[1] - top - bottom])
        self.view, self.scale = view, float((room / (high - low)).min())
        spare = room - self.scale * (high - low)
        self.shift = np.array([left + spare[0] / 2 - self.scale * low[0], PANEL[1] - bottom + self.scale * low[1]])

    def at(self, point: Array) -> Array:
        """Pixels of a position (3,), m; a pair is pixels already."""
        if len(point) == 2:
            return point
        return self.shift + self.scale * (self.view @ point) * (1, -1)

    def lower_right(self, solids: list[tuple[str, Array]], name: str) -> Array:
        """Pixels of the lower right corner of a link's shapes."""
        return np.concatenate([[self.at(p) for p in points] for link, points in solids if link == name]).max(axis=0)

    def add(self, tag: str, **attributes: object) -> etree._Element:
        words = {key.replace("_", "-"): f"{v:.1f}" if isinstance(v, float) else str(v) for key, v in attributes.items()}
        return etree.SubElement(self.group, tag, words)

    def polygon(self, points: Array, fill: str) -> None:
        flat = np.array([self.at(point) for point in points])
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in flat[ConvexHull(flat).vertices])
        self.add("polygon", points=text, fill=fill, stroke=GREY, stroke_width="0.6")

    def line(self, a: Array, b: Array, colour: str, dashes: str = "none", width: str = "1.3") -> None:
        (x1, y1), (x2, y2) = self.at(a), self.at(b)
        ends = {"x1": float(x1), "y1": float(y1), "x2": float(x2), "y2": float(y2)}
        self.add("line", **ends, stroke=colour, stroke_width=width, stroke_dasharray=dashes)

    def text(self, point: Array, words: str, colour: str = "black", size: int = 14, anchor: str = "start") -> None:
        """Words with a white edge, to be read over shapes."""
        x, y = map(float, self.at(point))
        for edge in ({"stroke": "white", "stroke_width": "3", "stroke_linejoin": "round"}, {}):
            self.add("text", x=x, y=y, fill=colour, font_size=size, text_anchor=anchor, **edge).text = words

    def axis(self, point: Array, direction: Array, colour: str) -> None:
        """An axis through a point: a line, longer to the left or up, or a ring where it is normal to the page."""
        flat = self.view @ direction * (1, -1)
        if np.linalg.norm(flat) > 0.1:
            along = flat / np.linalg.norm(flat) * (1 if flat @ (2, 1) > 0 else -1)
            self.line(self.at(point) - 150 * along, self.at(point) + 60 * along, colour, "12 3 2 3")
            return
        x, y = map(float, self.at(point))
        self.add("circle", cx=x, cy=y, r="6.5", fill="none", stroke=colour, stroke_width="1.6")
        self.add("circle", cx=x, cy=y, r="2.2", fill=colour)

    def cross(self, point: Array) -> None:
        """The torus centre."""
        middle = self.at(point)
        for arm in (np.array([4.5, 4.5]), np.array([4.5, -4.5])):
            self.line(middle - arm, middle + arm, RED, width="2")


def draw_machine(panel: Panel, urdf: UrdfFile, sensor_link: str) -> None:
    """The whole machine, and the marks of the branch that bears this sensor."""
    chain, poses = chain_of(urdf, sensor_link), link_poses(urdf)
    virtual = PIVOT in urdf.links
    geometry = virtual_motions(urdf, chain)[1] if virtual else nominal_geometry(chain)
    suffix = sensor_link.removeprefix("sensor")
    places = {name: poses[name + suffix][:3, 3] for name in ("source", "detector", "sensor")}
    beam = places["detector"] - places["source"]
    view = FROM_PATIENT if abs(beam[1]) > abs(beam[2]) else FROM_RIGHT
    solids = [
        (link.get("name"), corners(visual, poses[link.get("name")]))
        for link in etree.fromstring(urdf.data).iterchildren("link")
        for visual in link.iterchildren("visual")
    ]
    panel.fit(np.concatenate([points for _, points in solids]), view)
    carriers = {joint.parent for joint in urdf.joints if joint.child in urdf.sensors}
    for name, points in solids:
        role = name.split("_")[0]
        panel.polygon(points, FILLS.get(role, C_FILL if name in carriers else "#dddddd"))
    corner = {name: panel.lower_right(solids, name + suffix) for name in places}
    draw_marks(panel, geometry, places, corner)
    title = urdf.name + suffix.replace("_", ", ")
    numbers = f"R = {abs(geometry.major_radius) * 1e3:.0f} mm, ε = {np.degrees(geometry.non_orthogonality):.1f}°"
    panel.text(np.array([14.0, 22.0]), title, size=17)
    words = f"{'virtual axes, ' if virtual else ''}{numbers}, source to detector {np.linalg.norm(beam) * 1e3:.0f} mm"
    panel.text(np.array([14.0, 41.0]), words, GREY, 13)
    right, low = PANEL[0] - 20.0, PANEL[1] - 14.0
    panel.line(np.array([right - panel.scale / 2, low]), np.array([right, low]), GREY, width="3")
    panel.text(np.array([right - panel.scale / 4, low - 6]), "0.5 m", GREY, 12, "middle")


def draw_marks(panel: Panel, geometry: NominalGeometry, places: dict[str, Array], corner: dict[str, Array]) -> None:
    """Axes, pivot, torus centre, offset and beam; the names of the parts beside their lower right corners."""
    center, n, z = (geometry.T_base_torus[:3, k] for k in (3, 0, 2))
    pivot = center + geometry.major_radius * z
    epsilon = geometry.non_orthogonality
    a = geometry.T_base_torus[:3, :3] @ np.array([-np.sin(epsilon), np.cos(epsilon), 0])
    panel.line(places["source"], places["detector"], GREY, "1 3", "1")
    panel.axis(center, n, RED)
    panel.axis(pivot, a, BLUE)
    panel.line(places["sensor"], pivot, GREEN, "5 3")
    panel.cross(center)
    upright = abs(panel.view @ (places["detector"] - places["source"]))[0] < 1e-9
    for name in ("source", "detector"):
        if upright:
            panel.text(corner[name] + np.array([6, 3]), name, size=13)
        else:
            panel.text(corner[name] + np.array([0, 17]), name, size=13, anchor="end")
    panel.text(panel.at(places["sensor"]) + np.array([0.06 * panel.scale + 4, -3]), "sensor", GREEN, 13)


def draw_legend(panel: Panel) -> None:
    rows = [
        "first axis (α): all that follows turns about it; a ring where it is normal to the page",
        "second axis (β): the sensor turns about it; a ring where it is normal to the page",
        "torus centre: foot of the axes' common perpendicular on the first axis",
        "offset t, from the sensor to the rotation centre on the second axis",
        "beam, from the focal spot to the detector's face",
    ]
    places = [np.array([45.0, 50.0 + 36 * i]) for i in range(len(rows))]
    half = np.array([25.0, 0.0])
    for place, colour in zip(places, (RED, BLUE), strict=False):
        panel.line(place - half, place + half, colour, "12 3 2 3")
    panel.cross(places[2])
    panel.line(places[3] - half, places[3] + half, GREEN, "5 3")
    panel.line(places[4] - half, places[4] + half, GREY, "1 3", "1")
    for place, words in zip(places, rows, strict=True):
        panel.text(place + np.array([38, 5]), words, size=14)
    note = "All joints at zero, seen from the right (x to the right, z up); biplane, lateral: seen from the patient."
    panel.text(np.array([20.0, 250.0]), note, GREY, 14)


def draw(urdfs: list[UrdfFile]) -> bytes:
    """The drawing as SVG: a panel for each sensor, the legend last."""
    branches = [(urdf, sensor) for urdf in urdfs for sensor in urdf.sensors]
    rows = -(-len(branches) // COLUMNS)
    width, height = COLUMNS * PANEL[0], rows * PANEL[1] + LEGEND
    size = {"width": str(width), "height": str(height), "viewBox": f"0 0 {width} {height}"}
    svg = etree.Element("svg", size | {"font-family": "sans-serif"}, nsmap={None: "http://www.w3.org/2000/svg"})
    etree.SubElement(svg, "rect", width="100%", height="100%", fill="white")
    for number, (urdf, sensor) in enumerate(branches):
        draw_machine(Panel(svg, number), urdf, sensor)
    draw_legend(Panel(svg, rows * COLUMNS))
    return etree.tostring(svg, pretty_print=True)


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(draw([read_urdf(path) for path in bundled_urdfs().values()]))
