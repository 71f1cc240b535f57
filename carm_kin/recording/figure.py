"""A recording drawn: where the sensor was, and how far it had turned."""

from typing import TYPE_CHECKING, Any

import numpy as np

from carm_kin.canvas import figure, in_space
from solvers.se3 import Array, log_so3

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from carm_kin.recording.recording import Recording

COLOURS = ("#1f6feb", "#c2410c", "#0b6e4f", "#9333ea", "#b45309", "#0e7490", "#be185d")
LOOSE = "#6b7280"
"""The colour of poses without a sweep where there are sweeps."""
MOST_NAMED = 12
"""More sweeps have no legend."""


def recording_figure(recording: "Recording") -> "Figure":
    """As `Recording.figure` says."""
    drawn = figure(10, 5)
    space, course = drawn.add_subplot(1, 2, 1, projection="3d"), drawn.add_subplot(1, 2, 2)
    number, labels = _groups(recording)
    course_of, what = _course(recording)
    time = recording.pose_number if recording.time_s is None else recording.time_s
    for group, label in labels.items():
        poses = np.flatnonzero(number == group)
        colour = LOOSE if group < 0 and len(labels) > 1 else COLOURS[group % len(COLOURS)]
        space.plot(*(recording.p_world_sensor[poses] * 1e3).T, ".", color=colour, markersize=3, label=label)
        course.plot(time[poses], course_of[poses], ".", color=colour, markersize=3)
    in_space(space, "Positions in the world of the tracker")
    if 1 < len(labels) <= MOST_NAMED:
        drawn.legend(*space.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    course.set(xlabel="number of the pose" if recording.time_s is None else "time, s", ylabel=what)
    course.set_title("Motion since the first pose")
    course.grid(color="#d0d7de", linewidth=0.5)
    return drawn


def _groups(recording: "Recording") -> tuple[np.ndarray, dict[int, str]]:
    """(N,) the sweep of each pose, -1 where it has none, and what is said of each."""
    labels = {k: _words(sweep) for k, sweep in enumerate(recording.sweeps)}
    loose = {-1: "no sweep"} if (recording.sweep_number < 0).any() else {}
    return recording.sweep_number, labels | loose


def _words(sweep: Any) -> str:
    return f"sweep {sweep.label}".replace("$", r"\$") + (f", {sweep.moving} moves" if sweep.moving else "")


def _course(recording: "Recording") -> tuple[Array, str]:
    """(N,) the turn since the first pose, deg, or the distance, mm, where there are no orientations."""
    R = recording.R_world_sensor
    if R is None:
        p = recording.p_world_sensor
        return np.linalg.norm(p - p[:1], axis=1) * 1e3, "distance, mm"
    return np.degrees(np.linalg.norm(log_so3(np.swapaxes(R[:1], 1, 2) @ R), axis=1)), "turn, deg"
