"""Trees of frames that move: one frame in another at given times, as ROS' tf does it. No format itself."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from carm_kin.errors import InputError
from solvers.se3 import Array, exp_se3, inverse, log_se3

GAP_S = 0.5
"""Between poses of an edge that are farther apart than this nothing is interpolated."""
MOST_FRAMES = 1000
"""A longer chain of frames is a loop."""


@dataclass(frozen=True, eq=False)
class Edge:
    """The poses of a frame in its parent."""

    parent: str
    T_parent_child: Array
    """(K, 4, 4), m, in the order of time; NaN where it is no rigid motion."""
    time_s: Array
    """(K,) s, increasing; one entry of any time where the frame does not move."""
    stamps_s: Array
    """(M,) s, in the order of time, those of several messages repeated."""
    static: bool

    def at(self, time_s: Array) -> tuple[Array, np.ndarray]:
        """(N, 4, 4) poses at the times (N,), interpolated along the screw motion, and (N,) whether they are known."""
        if self.static:
            return np.tile(self.T_parent_child[-1], (len(time_s), 1, 1)), np.ones(len(time_s), dtype=bool)
        last = len(self.time_s) - 1
        at = np.minimum(np.searchsorted(self.time_s, time_s), last)
        after = np.minimum(np.maximum(at, 1), last)
        before = np.maximum(after - 1, 0)
        span = self.time_s[after] - self.time_s[before]
        share = np.where(span > 0, (time_s - self.time_s[before]) / np.where(span > 0, span, 1), 0.0)
        T = self.T_parent_child[before]
        exact = self.time_s[at] == time_s
        known = exact | ((share >= 0) & (share <= 1) & (span <= GAP_S) & (span > 0))
        step = log_se3(inverse(T) @ self.T_parent_child[after])
        between = T @ exp_se3(np.clip(share, 0, 1)[:, None] * step)
        return np.where(exact[:, None, None], self.T_parent_child[at], between), known


def path_to_root(edges: Mapping[str, Edge], frame: str) -> list[str]:
    """The frame, its parent and so on to the root. Raises InputError where they form a loop."""
    path = [frame]
    while path[-1] in edges:
        path.append(edges[path[-1]].parent)
        if len(path) > MOST_FRAMES:
            raise InputError(f"the frames above '{frame}' form a loop")
    return path


def pose_in(edges: Mapping[str, Edge], tool: str, reference: str) -> tuple[Array, Array, np.ndarray]:
    """The tool's frame in the reference's: times (N,), poses (N, 4, 4), and whether each is known (N,).

    The times are those of the moving frame nearest to the tool. Raises InputError where no path of frames joins the
    two, or none on it moves.
    """
    up, down = path_to_root(edges, tool), path_to_root(edges, reference)
    common = next((frame for frame in up if frame in down), None)
    if common is None:
        raise InputError(f"no chain of frames joins '{tool}' to '{reference}'; its own ends at '{up[-1]}'")
    up, down = up[: up.index(common)], down[: down.index(common)]
    moving = [frame for frame in (*up, *reversed(down)) if not edges[frame].static]
    if not moving:
        raise InputError(f"'{tool}' does not move against '{reference}'")
    time_s = edges[moving[0]].stamps_s
    T_common_tool, known = _product(edges, up, time_s)
    T_common_reference, known_too = _product(edges, down, time_s)
    return time_s, inverse(T_common_reference) @ T_common_tool, known & known_too


def _product(edges: Mapping[str, Edge], path: list[str], time_s: Array) -> tuple[Array, np.ndarray]:
    T, known = np.tile(np.eye(4), (len(time_s), 1, 1)), np.ones(len(time_s), dtype=bool)
    for frame in path:
        step, here = edges[frame].at(time_s)
        T, known = step @ T, known & here
    return T, known
