"""What the motion cannot determine, in words."""

import numpy as np

from solvers.likelihood.covariance import reported_jacobian
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus
from solvers.verdict.limits import Limits

AMBIGUOUS = (
    "two machines explain the poses equally well, for instance with the angular and the orbital axis exchanged; "
    "say which joint moves in each sweep, or record one more sweep"
)
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


def joints_at_rest(torus: Torus, angles: Array, sigma: tuple[float, float], limits: Limits) -> tuple[str, ...]:
    """Sentences for the joints whose angle does not spread beyond the noise of one pose."""
    lever = max(float(np.linalg.norm(torus.offset)), 0.05)
    noise = min(sigma[1], sigma[0] / lever) if min(sigma) > 0 else max(sigma)
    moving = [np.sqrt(max(0.0, 1 - abs(np.exp(1j * a).mean()) ** 2)) > limits.min_spread_sigmas * noise for a in angles]
    if moving == [True, True]:
        return ()
    if moving == [False, False]:
        return ("no motion about either axis beyond the noise: both axes and the offset are unknown",)
    name = "orbital" if moving[0] else "angular"
    return (f"no {name} motion: the {name} axis and the offset along the other axis are unknown",)


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
