"""How far the rotation centre wanders over the angles: the smallest ball that holds it, as quality assurance has it.

The point of the sensor's rigid body that is the rotation centre on average stands at

    q(alpha, beta) = c(alpha) - R(alpha, beta) (t(alpha, beta) - t)

in the torus frame, c(alpha) the circle of the major radius, R the orientation of the sensor and t(alpha, beta) the
offset of a C that bends. Without the circle it is what the deformation alone makes of it.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np

from carm_kin.calibrated.rotation_centre import chain_at
from carm_kin.errors import InputError
from carm_kin.results.deformation import Deformation
from carm_kin.results.isocentre_result import Ball, Isocentre
from carm_kin.results.provenance import provenance_of
from carm_kin.results.result import ResultLike, as_result
from solvers.se3 import Array
from solvers.torus import Torus

STEPS = 25
"""Angles of a joint at which the centre is looked at."""
AXES = ("the angular axis", "across it", "outwards from the circle's centre at alpha = 0")
"""x, y and z of the torus frame."""
MOST_ROUNDS = 1000
"""Of the search for the smallest ball, which takes about ten."""
ROUNDING = 1e-9
"""Relative to a ball's radius: points so little outside are held."""


def isocentre(
    result: ResultLike, *, placement: str | None = None, tolerance_m: float | None = None, command: str | None = None
) -> Isocentre:
    """The smallest balls that hold the rotation centre over the range of either axis and of both.

    ``result`` may be a path. With ``tolerance_m``, a diameter, the status is ``passed`` or ``failed`` by the ball of
    the deformation over both axes. Raises InputError for a result that is refused, holds no complete chain or tells no
    deformation, for a placement that it lacks, and for a tolerance that is not above 0.
    """
    if tolerance_m is not None and not 0 < tolerance_m < np.inf:
        raise InputError(f"tolerance_m must be a finite number above 0, not {tolerance_m}")
    saved = as_result(result)
    torus, bent = chain_at(saved, placement), saved.deformation
    if bent is None:
        raise InputError(
            "the calibration tells no deformation of the C: its poses show none beyond the noise, or it was made with "
            "--systematic none, or by another solver than 'kinematic'"
        )
    alpha, beta = (np.linspace(x[0], x[1], STEPS) for x in (bent.alpha_range_rad, bent.beta_range_rad))
    middle = float(alpha.mean()), float(beta.mean())
    ranges = {
        "angular": (alpha, np.full(STEPS, middle[1])),
        "orbital": (np.full(STEPS, middle[0]), beta),
        "both": (np.repeat(alpha, STEPS), np.tile(beta, STEPS)),
    }
    balls = tuple(_ball(axis, torus, bent, *angles) for axis, angles in ranges.items())
    found = Isocentre("found", tolerance_m, placement, bent.alpha_range_rad, bent.beta_range_rad, balls, _walks(balls))
    found = replace(found, deformation=bent, provenance=provenance_of(None, command, None))
    if tolerance_m is None:
        return found
    return replace(found, status="passed" if balls[-1].diameter_m <= tolerance_m else "failed")


def _ball(axis: str, torus: Torus, bent: Deformation, alpha: Array, beta: Array) -> Ball:
    """Over N pairs of angles."""
    angles = np.column_stack([alpha, beta])
    T = torus.T_torus_carm(angles)
    R_torus_sensor = T[:, :3, :3] @ torus.T_sensor_carm[:3, :3].T
    moved = -np.einsum("nij,nj->ni", R_torus_sensor, bent.shift_m(alpha, beta))
    first, last = _farthest(moved)
    sigma = bent.sigma_m(alpha, beta)
    along = np.abs(np.einsum("nij,i->nj", R_torus_sensor[[first, last]], _unit(moved[last] - moved[first])))
    return Ball(
        axis=axis,
        diameter_m=2 * smallest_ball(moved)[1],
        sigma_m=float(np.sqrt(((along * sigma[[first, last]]) ** 2).sum())),
        diameter_with_circle_m=2 * smallest_ball(T[:, :3, 3] + moved)[1],
        walk_torus_m=moved[-1] - moved[0] if axis != "both" else moved[last] - moved[first],
        from_rad=angles[0] if axis != "both" else angles[first],
        to_rad=angles[-1] if axis != "both" else angles[last],
    )


def smallest_ball(points: Array) -> tuple[Array, float]:
    """Centre (3,) and radius of the smallest ball that holds points (N, 3).

    The farthest point outside joins those on which the ball of the others rests; each time the ball grows, so that it
    ends with the smallest of all (Gärtner 1999).
    """
    centre, radius, core = _resting(points[:1])
    for _ in range(MOST_ROUNDS):
        distance = np.linalg.norm(points - centre, axis=1)
        far = int(np.argmax(distance))
        if distance[far] <= radius * (1 + ROUNDING) + ROUNDING**2:
            break
        centre, radius, core = _resting(np.concatenate([core, points[far : far + 1]]))
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _resting(core: Array) -> tuple[Array, float, Array]:
    """Centre and radius of the smallest ball that holds at most five points, and those of them that lie on it."""
    best = None
    for size in range(1, min(len(core), 4) + 1):
        for some in combinations(core, size):
            S = np.array(some)
            A = S[1:] - S[0]
            centre = S[0] + np.linalg.pinv(2 * A) @ (A**2).sum(axis=1) if size > 1 else S[0]
            radius = float(np.linalg.norm(S[0] - centre))
            holds = np.linalg.norm(core - centre, axis=1).max() <= radius * (1 + ROUNDING) + ROUNDING**2
            if holds and (best is None or radius < best[1]):
                best = centre, radius, S
    assert best is not None
    return best


def _farthest(points: Array) -> tuple[int, int]:
    square = ((points[:, None] - points) ** 2).sum(axis=2)
    first, last = np.unravel_index(np.argmax(square), square.shape)
    return int(min(first, last)), int(max(first, last))


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), np.finfo(float).tiny)


def _walks(balls: tuple[Ball, ...]) -> tuple[str, ...]:
    """In words, where it goes over the range of each axis."""
    return tuple(_walk(ball) for ball in balls if ball.axis != "both")


def _walk(ball: Ball) -> str:
    joint = 0 if ball.axis == "angular" else 1
    span = f"from {np.degrees(ball.from_rad[joint]):.0f} to {np.degrees(ball.to_rad[joint]):.0f} deg"
    length, k = float(np.linalg.norm(ball.walk_torus_m)), int(np.argmax(np.abs(ball.walk_torus_m)))
    where = f"mostly along {'+' if ball.walk_torus_m[k] > 0 else '-'}{'xyz'[k]} of the torus frame ({AXES[k]})"
    return f"over the {ball.axis} axis {span} it walks {length * 1e3:.2f} mm, {where}"
