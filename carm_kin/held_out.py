"""How well a fit predicts poses that it was not given."""

from dataclasses import dataclass

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
