"""What the residuals of an accepted estimate still show: flex of the gantry, and noise that is not independent."""

import numpy as np

from solvers.estimate import Correlation, Note
from solvers.likelihood.f_test import f_tail
from solvers.problem import Problem
from solvers.se3 import Array, rot_y

ORDERS = (1, 2, 3)
"""Harmonics of an angle that a flex is made of."""
FLEX_PROBABILITY = 1e-6
"""Probability of naming a flex where there is none."""
LEAST_FLEX = 0.3
"""A flex below this share of the position noise is not worth a note."""
MOST_POSES = 2000
"""Poses on which the regression is made."""
EXACT = 1e-6
"""Residuals below this, m and rad, are rounding."""
LASTING = 1.5
"""Poses from which on the noise does not count as independent."""


def residual_notes(
    angles: Array, residual: Array, redundancy: float, correlation: Correlation, allowed_for: bool
) -> tuple[Note, ...]:
    """Notes on the residuals (6, N) in the carm frame, m and rad, of the poses at ``angles`` (2, N).

    ``redundancy`` is the number of position residuals less what the angles absorb, ``correlation`` how long the noise
    lasts; systematic effects are ``allowed_for`` in the stated uncertainty, or not.
    """
    remark = "allows for it" if allowed_for else "does not cover this"
    found = *_flex(angles, residual[:3], redundancy, remark), correlated(correlation, residual.shape[1])
    return tuple(note for note in found if note is not None)


def _flex(angles: Array, residual: Array, redundancy: float, remark: str) -> list[Note]:
    """Position residuals that follow an angle, by an F-test on `ORDERS` harmonics in the frame that alpha
    turns and beta does not, in which a sag by gravity and a bending of the C are both of low order."""
    step = -(-residual.shape[1] // MOST_POSES)
    angles, residual = angles[:, ::step], residual[:, ::step]
    y = np.einsum("nij,jn->ni", rot_y(angles[1]), residual)
    rms = float(np.sqrt((y**2).mean()))
    if rms < EXACT:
        return []
    waves = [np.column_stack([f(k * a) for k in ORDERS for f in (np.cos, np.sin)]) for a in angles]
    one = np.ones((len(y), 1))
    whole = np.column_stack([one, *waves])
    rest = _left(whole, y)[0]
    left = redundancy / step - 3 * whole.shape[1]
    notes = []
    for joint, (name, wave) in enumerate(zip(("alpha", "beta"), waves, strict=True)):
        without = _left(np.column_stack([one, waves[1 - joint]]), y)[0]
        terms = 3 * wave.shape[1]
        if left <= terms or rest <= 0:
            continue
        F = (without - rest) / terms / (rest / left)
        fitted = wave @ _left(whole, y)[1][1 + joint * wave.shape[1] :][: wave.shape[1]]
        fitted -= fitted.mean(axis=0)
        amplitude = float(np.sqrt(2 * (fitted**2).sum(axis=1).mean()))
        if f_tail(terms, left, F) < FLEX_PROBABILITY and amplitude > LEAST_FLEX * rms:
            notes.append(
                Note(
                    f"flex_{name}",
                    f"the position residuals follow {name} with an amplitude of {amplitude * 1e3:.2f} mm: the gantry "
                    f"seems to bend, or the tracker to be biased; the stated uncertainty {remark}",
                )
            )
    return notes


def _left(A: Array, y: Array) -> tuple[float, Array]:
    """Sum of squares that a regression on the columns of A (N, K) leaves of y (N, 3), and the coefficients."""
    x = np.asarray(np.linalg.lstsq(A, y, rcond=1e-6)[0], dtype=float)
    return float(((y - A @ x) ** 2).sum()), x


def neighbour_correlation(problem: Problem, residual: Array) -> float:
    """`correlation` of the residuals (6, N) of neighbouring poses of a sweep."""
    return correlation(_neighbours(problem), residual)


def correlation(same: np.ndarray, residual: Array) -> float:
    """Correlation of the residuals (6, N) of neighbouring poses, in position or in orientation, whichever is greater;
    0 where there is no telling. ``same`` (N - 1,) says which poses count as neighbours of the next."""
    worst = 0.0
    for part in (residual[:3], residual[3:]):
        square = float((part**2).mean()) if part.size else 0.0
        if same.any() and square > EXACT**2:
            worst = max(worst, float((part[:, :-1] * part[:, 1:])[:, same].mean()) / square)
    return worst


def _neighbours(problem: Problem) -> np.ndarray:
    return (np.diff(problem.held, axis=0) == 0).all(axis=1) & (np.diff(problem.placement) == 0)


def correlated(lasts: Correlation, poses: int) -> Note | None:
    """A note where the noise of so many ``poses`` lasts for longer than a pose."""
    if lasts.longest < LASTING:
        return None
    return Note(
        "correlated_residuals",
        f"residuals of neighbouring poses agree: the noise lasts for {lasts.longest:.1f} poses, so that "
        f"{poses / lasts.longest:.0f} of {poses} count; the stated standard deviations heed it",
    )
