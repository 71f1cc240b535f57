"""What the labels of held joints are worth: how far they are off the angles that the poses alone give.

docs/estimation.md, "Labels of held joints".
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers.estimate import Note
from solvers.likelihood.linearise import AngleModel
from solvers.likelihood.reduced import Reduced
from solvers.problem import ANGULAR, Problem
from solvers.se3 import Array
from solvers.torus import near_median

GROSS_RAD = float(np.radians(2.0))
"""A label that the others of its zero contradict by more than this is no reading of its sweep."""
LEAST_TOLD_RAD = float(np.radians(0.05))
"""Labels that are off by less than this are weighed down without a word."""
NAMES = ("angular", "orbital")
STEPS = 400
"""Values of the scale that are tried."""


@dataclass(frozen=True, eq=False)
class Weighed:
    """A problem whose labels have the standard deviation that they show."""

    problem: Problem
    scale: float
    """The standard deviations over those that were stated, at least 1."""
    notes: tuple[Note, ...]


def unlabelled(problem: Problem) -> Problem:
    """The same without the labels that are readings; exact ones and readings of moving joints stay."""
    return replace(problem, label=np.where(problem.label_read, np.nan, problem.label), sigma_label=None)


def weighed(problem: Problem, at: Reduced, angles: Array, C: Array) -> Weighed:
    """The labels of ``problem`` judged by the fit to `unlabelled` poses: its normal equations ``at``, its ``angles``
    (2, N), and the covariance C (D, D) of its unknowns.

    The differences of the labels of one zero, against those of the held angles, have the covariance
    ``s² F + V``, with F the stated variances and V of the angles. s is 1 unless they contradict it, else the most
    likely value above. A label that is off by more than `GROSS_RAD` where most agree has no say: its standard
    deviation becomes infinite.
    """
    sweeps = _Sweeps.of(problem, at, angles)
    gross = sweeps.gross()
    scale, told = 1.0, False
    contrasts = sweeps.contrasts(~gross)
    if contrasts.shape[1]:
        V = at.held_covariance(C)[np.ix_(sweeps.number, sweeps.number)]
        scale, told = _scale(contrasts, sweeps.error, sweeps.sigma, V)
    sigma = np.where(problem.label_read, scale * np.asarray(problem.sigma_label), 0.0)
    sigma[sweeps.poses(gross)] = np.inf
    off = scale * float(np.sqrt((sweeps.sigma**2).mean())) if len(sweeps.sigma) else 0.0
    notes = (_disagree(off, off / scale),) if told and off > LEAST_TOLD_RAD else ()
    notes += tuple(sweeps.wrong_label(problem, int(k)) for k in np.flatnonzero(gross))
    return Weighed(replace(problem, sigma_label=sigma), scale, notes)


@dataclass(frozen=True, eq=False)
class _Sweeps:
    """The labelled sweeps that have used poses."""

    model: AngleModel
    """Of the unlabelled problem."""
    number: np.ndarray
    """(K,) in the model."""
    zero: np.ndarray
    """(K,) number of the zero that the label counts from: of alpha in a placement, of beta in all."""
    error: Array
    """(K,) held angle less label, less their median by zero, rad."""
    sigma: Array
    """(K,) standard deviation as stated, rad."""

    @staticmethod
    def of(problem: Problem, at: Reduced, angles: Array) -> "_Sweeps":
        model, labels = AngleModel.of(unlabelled(problem)), AngleModel.of(problem)
        joint, first = model.sweep_joint[model.sweep_first], model.sweep_first
        here = labels.sweep[first]
        number = np.flatnonzero((labels.sweep_precision[here] > 0) & at.measured)
        here, joint, first = here[number], joint[number], first[number]
        zero = np.where(joint == ANGULAR, model.sweep_placement[number], -1)
        error = angles[joint, first] - labels.sweep_label[here]
        for z in np.unique(zero):
            error[zero == z] = _about_median(error[zero == z])
        return _Sweeps(model, number, zero, error, labels.sweep_precision[here] ** -0.5)

    def gross(self) -> np.ndarray:
        """(K,) mask of the labels that most others of their zero contradict."""
        gross = np.zeros(len(self.number), dtype=bool)
        for z in np.unique(self.zero):
            own = self.zero == z
            far = ~near_median(self.error[own]) & (np.abs(self.error[own]) > GROSS_RAD)
            gross[own] = far & (far.sum() < 0.5 * own.sum())
        return gross

    def wrong_label(self, problem: Problem, k: int) -> Note:
        """What there is to say of the k-th sweep's label."""
        poses, joint = self.poses(np.arange(len(self.number)) == k)
        here = poses[0], joint[0]
        return Note(
            "wrong_label",
            f"sweep {problem.held[here] + 1} (poses {poses.min()} to {poses.max()}) has the {NAMES[here[1]]} joint at "
            f"{np.degrees(problem.label[here]):.4g} deg by its label, which the other sweeps contradict by "
            f"{abs(np.degrees(self.error[k])):.2g} deg; the label was not used",
        )

    def contrasts(self, kept: np.ndarray) -> Array:
        """(K, r) orthonormal differences of the ``kept`` labels of one zero, on which the zero has no effect."""
        columns = [np.zeros((len(kept), 0))]
        for z in np.unique(self.zero):
            own = np.flatnonzero((self.zero == z) & kept)
            column = np.zeros((len(kept), max(len(own) - 1, 0)))
            column[own] = np.linalg.qr(np.column_stack([np.ones(len(own)), np.eye(len(own))[:, 1:]]))[0][:, 1:]
            columns.append(column)
        return np.concatenate(columns, axis=1)

    def poses(self, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The poses of some of the sweeps, and the joint that each of them holds."""
        poses = np.flatnonzero(np.isin(self.model.sweep, self.number[which]))
        return poses, self.model.sweep_joint[poses]


def _about_median(error: Array) -> Array:
    """Angles less their median on the circle."""
    mean = np.angle(np.exp(1j * error).sum())
    off = np.angle(np.exp(1j * (error - mean)))
    return off - np.median(off)


def _scale(contrasts: Array, error: Array, sigma: Array, V: Array) -> tuple[float, bool]:
    """The factor of the labels' stated ``sigma`` (K,), and whether it is beyond doubt that it is not 1.

    With ``F = L Lᵀ`` and ``L⁻¹ V L⁻ᵀ = U diag(v) Uᵀ`` of the contrasts, ``z = Uᵀ L⁻¹ e`` has the variances s² + v.
    """
    L = np.linalg.cholesky(contrasts.T @ (sigma[:, None] ** 2 * contrasts))
    inner = np.linalg.solve(L, contrasts.T @ V @ contrasts)
    v, U = np.linalg.eigh(np.linalg.solve(L, inner.T))
    v, square = np.maximum(v, 0.0), (U.T @ np.linalg.solve(L, contrasts.T @ error)) ** 2
    r, T = len(v), float((square / (1 + v)).sum())
    if r + 2 * np.sqrt(2 * r) >= T:
        return 1.0, False
    s2 = np.geomspace(1.0, 1.0 + square.sum(), STEPS)[:, None]
    cost = (np.log(s2 + v) + square / (s2 + v)).sum(axis=1)
    return float(np.sqrt(s2[np.argmin(cost), 0])), 3 * (r + 1) + 10 < T


def _disagree(off: float, stated: float) -> Note:
    return Note(
        "labels_disagree",
        f"the labels of the held joints contradict the poses by {np.degrees(off):.2g} deg (one sigma), where "
        f"{np.degrees(stated):.2g} deg were expected of them: they were weighed accordingly, and tell little more than "
        "where the angles are zero",
    )
