"""How far a number of a new recording may be from the saved one: the tolerance and three standard deviations."""

from collections.abc import Sequence

import numpy as np

from solvers.estimate import Covariance

SIGMAS = 3.0
"""How many standard deviations a difference may have beyond the tolerance."""


def against(tolerance: float, difference: float, sigma: float) -> tuple[float, float, float, bool]:
    """Difference, sigma, limit and whether it is within, as `Length` and `Angle` have them."""
    limit = tolerance + SIGMAS * float(sigma)
    return float(difference), float(sigma), limit, bool(difference <= limit)


def worst(covariances: Sequence[Covariance], name: str) -> float:
    """One sigma of the difference of the two values, in the worst direction where they are vectors."""
    total = np.sum([c.block(name) for c in covariances], axis=0) if covariances else np.zeros((1, 1))
    return float(np.sqrt(max(np.linalg.eigvalsh(total)[-1], 0.0)))
