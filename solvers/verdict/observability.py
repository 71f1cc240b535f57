"""What the motion cannot determine, in words."""

import numpy as np

from solvers.likelihood.covariance import reported_jacobian
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus
from solvers.verdict.limits import Limits, least_arc
from solvers.verdict.one_axis import one_axis_in_words, swept

AMBIGUOUS = (
    "two machines explain the poses equally well, for instance with the angular and the orbital axis exchanged; "
    "say which joint moves in each sweep, or record one more sweep"
)
MOST_APART = 100.0
"""Ratio of the noises, in lengths at the sensor's lever, beyond which the lesser counts as greater than it is."""
LEAST_LEVER_M = 0.05
"""A sensor nearer to the pivot counts as so far off."""
ONE_AXIS = 0.005
"""1 - |mean direction| of a line fixed in the sensor up to which it counts as fixed in the world too: 5.7 deg rms."""


def turns_about_one_axis(problem: Problem) -> tuple[str, ...]:
    """A sentence if the orientations alone show no more than one direction of axis, whatever the fit."""
    means = [problem.rotations[problem.placement == p].mean(axis=0) for p in np.unique(problem.placement)]
    if min(np.linalg.svd(mean)[1][0] for mean in means) < 1 - ONE_AXIS:
        return ()
    return ("the sensor turns about one direction only: one joint stood still, or the two axes are parallel",)


def thickness(problem: Problem) -> float:
    """Standard deviation, m, of the positions in the direction in which they spread least."""
    p = problem.p_world_sensor
    parts = [p[problem.placement == k] for k in np.unique(problem.placement)]
    return min(float(np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[1][-1]) / np.sqrt(len(x)) for x in parts)


def angular_arcs(problem: Problem, angles: Array) -> Array:
    """(P,) how far alpha of ``angles`` (2, N), rad, is swept in every placement."""
    return np.array([swept(angles[0, problem.placement == p]) for p in np.unique(problem.placement)])


def idle_placements(problem: Problem, angles: Array, sigma_r: float, limits: Limits) -> np.ndarray:
    """Numbers of the placements without angular motion, where others have it: what stands in the way of these alone."""
    idle = angular_arcs(problem, angles) < least_arc(sigma_r, limits)
    return np.flatnonzero(idle) if not idle.all() else np.zeros(0, dtype=int)


def joints_at_rest(problem: Problem, angles: Array, sigma_r: float, limits: Limits) -> tuple[str, ...]:
    """Sentences for the joints that are not swept by `least_arc`, of ``angles`` (2, N), and what is told of the other.

    The angular axis of every placement needs angular motion there; the orbital axis in the sensor needs orbital
    motion anywhere, since the mount is the same everywhere.
    """
    least = least_arc(sigma_r, limits)
    members = [problem.placement == p for p in np.unique(problem.placement)]
    arcs = angular_arcs(problem, angles)
    angular, orbital = arcs.min(), swept(angles[1])
    if angular >= least and orbital >= least:
        return ()
    if arcs.max() < least and orbital < least:
        return (
            f"no motion about either axis beyond {np.degrees(least):.2g} deg: both axes and the offset are unknown",
        )
    name, arc = ("angular", angular) if angular < least else ("orbital", orbital)
    here = members[int(arcs.argmin())] if name == "angular" else np.ones(len(problem), dtype=bool)
    where = "" if len(members) == 1 or name == "orbital" else f" at placement {arcs.argmin() + 1}"
    unknown = "the offset along the other axis" if not where else "where the base stood there"
    named = (problem.held >= 0).any() or np.isfinite(problem.label).any()
    name = name if named else "second"
    return (
        f"no {name} motion{where} (it spans {np.degrees(arc):.2g} deg, at least {np.degrees(least):.2g} are needed): "
        f"the {name} axis and {unknown} are unknown",
        *(() if where else one_axis_in_words(problem.select(here))),
    )


def balanced(sigma: tuple[float, float], torus: Torus) -> tuple[float, float]:
    """The two noises (m, rad) no further apart than `MOST_APART` at the lever of the sensor.

    What a motion determines depends on the motion, not on which of two noises is absent: information that one kind of
    data alone carries counts however much better the other kind is. docs/estimation.md, Exact data.
    """
    lever = max(float(np.linalg.norm(torus.offset)), LEAST_LEVER_M)
    t, r = sigma[0], sigma[1] * lever
    return max(t, r / MOST_APART), max(r, t / MOST_APART) / lever


def in_words(torus: Torus, active: np.ndarray, null: Array) -> tuple[str, ...]:
    """Which reported quantities each null direction (columns of ``null``) moves."""
    J, names = reported_jacobian(torus)
    sentences = []
    for x in null.T:
        change = dict(zip(names, J[:, active] @ x, strict=True))
        offset = np.array([change[f"offset_sensor_pivot_{k}"] for k in "xyz"])
        along = abs(offset @ torus.orbital_axis)
        moved = {
            "the offset along the orbital axis": along,
            "the offset across the orbital axis": np.linalg.norm(offset - torus.orbital_axis * along),
            "the major radius": abs(change["major_radius"]),
            "the torus centre": max(abs(v) for k, v in change.items() if k.startswith("torus_center")),
            "the angular axis": max(abs(v) for k, v in change.items() if k.startswith("angular_axis")),
            "the orbital axis": max(abs(v) for k, v in change.items() if k.startswith("orbital_axis")),
            "the non-orthogonality": abs(change["axis_non_orthogonality"]),
        }
        largest = max(moved.values())
        sentences.append("undetermined together: " + ", ".join(k for k, v in moved.items() if v > 0.1 * largest))
    return tuple(sentences)
