"""How well a fit predicts poses that it was not given."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solvers.estimate import Note


@dataclass(frozen=True)
class HeldOut:
    """How well a fit predicts poses that it was not given. Numbers are None where it was refused.

    Angles that nothing tells are fitted to each pose: they absorb ``6 poses - dof`` of the 6 residuals a pose.
    """

    label: str
    """``fold 1`` ..., or ``overall``."""
    sweeps: tuple[str, ...]
    """Labels of the sweeps that were held out; empty where there are none."""
    poses: int
    """Held-out poses, those left out that the fit to all poses rejects."""
    translation_rms_m: float | None
    """Root mean square length of the position error."""
    rotation_rms_rad: float | None
    """Root mean square rotation angle of the orientation error."""
    chi2_per_dof: float | None
    """Squared errors over the noise of the fit, per degree of freedom: about 1 where the model holds."""
    dof: float | None
    """Residuals less the part that the fitted angles absorb."""
    refusal: Note | None
    """Why there is no prediction."""


@dataclass(frozen=True)
class CrossValidation:
    """Held-out pose errors of `carm_kin.cross_validate`."""

    folds: int
    overall: HeldOut
    """Over the poses of all folds that were not refused; refused where all were."""
    per_fold: tuple[HeldOut, ...]


class Errors(NamedTuple):
    """Sums over held-out poses."""

    poses: int
    position: float
    """Squared position errors, m^2."""
    rotation: float
    """Squared orientation errors, rad^2; NaN where none is predicted, as of a point."""
    chi2: float
    dof: float


def overall_of(rows: list[HeldOut], sums: list[Errors]) -> HeldOut:
    """The errors of all folds that were not refused."""
    sweeps = tuple(label for row in rows if row.refusal is None for label in row.sweeps)
    if not sums:
        refusal = rows[0].refusal
        code, reason = (refusal.code, refusal.message) if refusal else ("refused", "")
        return row_of("overall", sweeps, 0, None, Note(code, f"every fold is refused, the first since {reason}"))
    total = Errors(sum(s.poses for s in sums), *(sum(s[i] for s in sums) for i in range(1, 5)))
    return row_of("overall", sweeps, total.poses, total, None)


def row_of(label: str, sweeps: tuple[str, ...], poses: int, errors: Errors | None, refusal: Note | None) -> HeldOut:
    """A fold's errors, or why there are none."""
    if errors is None:
        return HeldOut(label, sweeps, int(poses), None, None, None, None, refusal)
    return HeldOut(
        label,
        sweeps,
        int(poses),
        float(np.sqrt(errors.position / errors.poses)),
        None if np.isnan(errors.rotation) else float(np.sqrt(errors.rotation / errors.poses)),
        errors.chi2 / errors.dof,
        errors.dof,
        None,
    )
