"""What the motion cannot determine, in words."""

import numpy as np

from solvers.likelihood.covariance import reported_jacobian
from solvers.problem import Problem
from solvers.se3 import Array, orthonormal_complement
from solvers.torus import Torus
from solvers.verdict.limits import Limits, least_arc

AMBIGUOUS = (
    "two machines explain the poses equally well, for instance with the angular and the orbital axis exchanged; "
    "say which joint moves in each sweep, or record one more sweep"
)
STRAYS, MANY = 3, 100
"""So many poses at each end of an arc may be wrong, where there is one for every so many."""
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


def swept(angle: Array) -> float:
    """The arc, rad, that an angle (N,) spans: the circle less its largest gap.

    Of many poses `STRAYS` at each end of it do not count, which may be wrong.
    """
    angle = np.sort(np.mod(angle, 2 * np.pi))
    if not len(angle):
        return 0.0
    gaps = np.diff(angle, append=angle[0] + 2 * np.pi)
    start = int(np.argmax(gaps)) + 1
    along = np.mod(np.roll(angle, -start) - angle[start % len(angle)], 2 * np.pi)
    strays = min(STRAYS, len(along) // MANY)
    return float(along[-1 - strays] - along[strays])


def joints_at_rest(problem: Problem, angles: Array, sigma_r: float, limits: Limits) -> tuple[str, ...]:
    """Sentences for the joints that are not swept by `least_arc`, of ``angles`` (2, N), and what is told of the other.

    The angular axis of every placement needs angular motion there; the orbital axis in the sensor needs orbital
    motion anywhere, since the mount is the same everywhere.
    """
    least = least_arc(sigma_r, limits)
    members = [problem.placement == p for p in np.unique(problem.placement)]
    arcs = [swept(angles[0, here]) for here in members]
    angular, orbital = min(arcs), swept(angles[1])
    if angular >= least and orbital >= least:
        return ()
    if max(arcs) < least and orbital < least:
        return (
            f"no motion about either axis beyond {np.degrees(least):.2g} deg: both axes and the offset are unknown",
        )
    name, arc = ("angular", angular) if angular < least else ("orbital", orbital)
    here = members[int(np.argmin(arcs))] if name == "angular" else np.ones(len(problem), dtype=bool)
    where = "" if len(members) == 1 or name == "orbital" else f" at placement {int(np.argmin(arcs)) + 1}"
    unknown = "the offset along the other axis" if not where else "where the base stood there"
    return (
        f"no {name} motion{where} (it spans {np.degrees(arc):.2g} deg, at least {np.degrees(least):.2g} are needed): "
        f"the {name} axis and {unknown} are unknown",
        *(() if where else one_axis_in_words(problem.select(here))),
    )


def one_axis_in_words(problem: Problem) -> tuple[str, ...]:
    """What the motion about one axis tells: its direction in the sensor and the world, and the orbit's radius.

    The axis u of the world is fixed in the sensor as v where ``R_i v = u``: the first singular vectors of the mean
    orientation. The sensor circles it, so that the positions across u lie on a circle.
    """
    if problem.placements > 1 or problem.R_world_sensor is None:
        return ()
    left, _, right = np.linalg.svd(problem.rotations.mean(axis=0))
    u, v = left[:, 0], right[0]
    e = orthonormal_complement(u)
    turned = problem.rotations @ orthonormal_complement(v)[:, 0] @ e
    wobble = np.arctan2(np.linalg.norm(np.cross(problem.rotations @ v, u), axis=1), problem.rotations @ v @ u)
    across = problem.p_world_sensor @ e
    across = across - across.mean(axis=0)
    A = np.column_stack([2 * across, np.ones(len(across))])
    x = np.linalg.lstsq(A, (across**2).sum(axis=1), rcond=None)[0]
    arc, radius = swept(np.arctan2(turned[:, 1], turned[:, 0])), np.sqrt(max(float(x[2] + x[:2] @ x[:2]), 0.0))
    return (
        f"one axis turned, by {np.degrees(arc):.3g} deg: it stands along {_vector(v)} in the sensor and along "
        f"{_vector(u)} in the world, the sensor circles it at {radius * 1e3:.4g} mm, and it wobbles by "
        f"{np.degrees(np.sqrt((wobble**2).mean())):.2g} deg (rms)",
    )


def _vector(direction: Array) -> str:
    return "(" + ", ".join(f"{x:+.3f}" for x in direction) + ")"


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
