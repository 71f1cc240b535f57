"""The view of space: the poses, and the machine that was found.

It is drawn in the frame of the torus (x the angular axis, origin the torus centre), so that the poses of several base
placements come to lie on one machine; where a result has no such frame, in that of the world.
"""

import numpy as np

from carm_kin.report.colours import PIVOT, REJECTED
from carm_kin.report.machine import AXIS_COLOURS, machine_marks
from carm_kin.report.marks import Line, Mark, Points, Space, Surface
from carm_kin.report.poses import Fit, Poses
from carm_kin.results.result import CalibrationResult
from solvers.se3 import Array, inverse

NAME = "scene"
ROOM = 0.06
"""Free space around what is drawn, of its extent."""
AXES = "x, mm", "y, mm", "z, mm"


def scene(result: CalibrationResult, poses: Poses) -> Space:
    """The view, in mm."""
    if poses.fit is None:
        return _positions(result, poses)
    p = _in_torus(poses, poses.fit) * 1e3
    marks, words = machine_marks(result, poses, p)
    limits = _limits(p[poses.used], marks)
    dots, hidden = _dots(poses, p, limits)
    caption = (
        "In the frame of the torus: x along the angular axis, z towards the rotation centre at α = 0. "
        f"The C-arm and the sensor are drawn as at the pose in the middle of the motion.{words}{hidden}"
    )
    return Space(NAME, "The machine and the poses", caption, AXES, limits, _eye(p[poses.used]), (*dots, *marks))


def _in_torus(poses: Poses, fit: Fit) -> Array:
    """(N, 3) positions of the sensor in the torus of its placement, m."""
    T = inverse(fit.torus.T_world_torus)[poses.recording.placement_number]
    return np.einsum("nij,nj->ni", T[:, :3, :3], poses.recording.p_world_sensor) + T[:, :3, 3]


def _positions(result: CalibrationResult, poses: Poses) -> Space:
    """The recorded positions in the world, and of the machine what the result holds."""
    p = poses.recording.p_world_sensor * 1e3
    marks: list[Mark] = []
    for placement in result.placements:
        centre = placement.torus_center_world_m * 1e3
        marks.append(Points("centre", centre[None], PIVOT, symbol="diamond", size=6))
        if placement.angular_axis_world is not None:
            reach = 0.6 * float(np.ptp(p, axis=0).max())
            ends = centre + reach * np.outer([-1, 1], placement.angular_axis_world)
            marks.append(Line("angular axis", ends, AXIS_COLOURS[0], 4))
    limits = _limits(p[poses.used] if poses.used.any() else p, marks)
    dots, hidden = _dots(poses, p, limits)
    return Space(
        NAME, "The recorded positions", f"In the world of the tracker.{hidden}", AXES, limits, _eye(p), (*dots, *marks)
    )


def _limits(p: Array, marks: list[Mark]) -> Array:
    """(3, 2) around the used positions (N, 3) and the lines and surfaces."""
    drawn = [mark.at.reshape(-1, 3) for mark in marks if isinstance(mark, (Line, Surface, Points))]
    every = np.concatenate([p, *drawn])
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    room = max(ROOM * float((high - low).max()), 1.0)
    return np.stack([low - room, high + room], axis=1)


def _dots(poses: Poses, p: Array, limits: Array) -> tuple[list[Mark], str]:
    """The poses (N, 3), mm, by group; those that were not used are left out where they lie outside of the view."""
    marks: list[Mark] = []
    for group in poses.groups:
        drawn = group.member & poses.used & poses.shown
        if drawn.any():
            colour, words = tuple(poses.colour[drawn]), tuple(poses.words[drawn])
            marks.append(Points(group.name, p[drawn], colour, words, group.symbol, 3.5))
    inside = ((p >= limits[:, 0]) & (p <= limits[:, 1])).all(axis=1)
    drawn = ~poses.used & poses.shown & inside
    if drawn.any():
        marks.append(Points("not used", p[drawn], REJECTED, tuple(poses.words[drawn]), "cross", 5))
    left = int((~poses.used & ~inside).sum())
    several = "poses that were not used lie" if left > 1 else "pose that was not used lies"
    return marks, f" {left} {several} outside of the view." if left else ""


def _eye(p: Array) -> Array:
    """(3,) a direction from which the poses (N, 3) are seen from the side and from above."""
    east = np.nan_to_num(p).mean(axis=0)[:2]
    length = float(np.linalg.norm(east))
    towards = np.arctan2(east[1], east[0]) if length > 0 else 0.0
    azimuth = towards + np.radians(50)
    return np.array([1.45 * np.cos(azimuth), 1.45 * np.sin(azimuth), 0.7])
