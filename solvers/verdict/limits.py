"""Where a result is refused, and the refusals that follow from one number each."""

from dataclasses import dataclass

import numpy as np

from solvers import told
from solvers.estimate import Covariance, Note
from solvers.told import FLOOR_RAD, MIN_ARC_RAD, NOISE_MULTIPLE

A_MACHINE_M = 1.0
"""The size of a C-arm: a standard deviation beyond it is no number worth telling."""


@dataclass(frozen=True)
class Limits:
    """Where a result is refused."""

    min_poses: int = 6
    """Fewest poses."""
    max_sigma_t_m: float = 0.010
    """Estimated position noise above which the residuals are a misfit, not noise."""
    max_sigma_r_rad: float = float(np.radians(2.0))
    """Estimated orientation noise above which the residuals are a misfit."""
    max_chi2_per_dof: float = 2.0
    """Misfit above this, where the noise is given."""
    max_offset_sigma_m: float = 0.020
    """Largest one-sigma of the offset in any direction."""
    min_relative_information: float = 1e-9
    """Least eigenvalue of the scaled information that counts as information."""
    max_rejected_share: float = 0.7
    """Largest share of poses that may be rejected."""
    silent_rejected_share: float = 0.02
    """Share of rejected poses from which on a warning says so."""
    max_moved_share: float = 0.2
    """Largest share of poses that may belong to another place of the base."""
    min_arc_rad: float = MIN_ARC_RAD
    """A joint that an unknown needs is swept by at least so much: noise, wobble and sag turn one at rest by less."""
    min_arc_sigmas: float = NOISE_MULTIPLE
    """And by so many standard deviations of the orientation of one pose."""
    least_sigma_r_rad: float = FLOOR_RAD
    """Orientation noise that is counted with at least, since a fit may take a wobble for motion."""
    min_spread_sigmas: float = 4.0
    """Positions fill a surface if they spread by more than so many standard deviations across it."""
    max_length_m: float = 20.0
    """Distance of the sensor from the pivot above which the unit of the positions is wrong."""
    systematic_correlation: float = 0.8
    """Correlation of the residuals of neighbouring poses from which on a cause is looked for."""
    min_gain: float = 5.0
    """A cause is named if without it the residuals are at least so many times smaller."""


def least_arc(sigma_r: float, limits: Limits) -> float:
    """Range, rad, that a joint's angle has to span under an orientation noise of ``sigma_r`` (rad) to count as motion.

    A noise beyond `Limits.max_sigma_r_rad` is a misfit, and tells nothing of the arcs.
    """
    noise = min(max(sigma_r, limits.least_sigma_r_rad), limits.max_sigma_r_rad)
    return told.least_arc(noise, limits.min_arc_rad, limits.min_arc_sigmas)


def uncertain(covariance: Covariance, limits: Limits) -> Note | None:
    worst = float(np.sqrt(max(np.linalg.eigvalsh(covariance.block("offset"))[-1], 0.0)))
    if worst <= limits.max_offset_sigma_m:
        return None
    return Note("too_uncertain", f"the arcs are too short for the noise: the offset is {uncertainty(worst)}")


def uncertainty(sigma_m: float) -> str:
    """How uncertain something is that is not given, in words."""
    return f"uncertain by {sigma_m * 1e3:.0f} mm (one sigma)" if sigma_m < A_MACHINE_M else "not determined"


def misfit(sigma_t: float, sigma_r: float) -> Note:
    return Note(
        "misfit",
        f"no C-arm of two axes explains these poses: the residuals amount to a noise of {sigma_t * 1e3:.1f} mm and "
        f"{np.degrees(sigma_r):.2f} deg; was the base moved, or is the unit or the direction of the poses wrong?",
    )
