"""A closed form that needs no protocol: no labels, no sweeps, no initial guess.

Two small problems give both axes, the offset and the radius (`solvers.start.axes`), after a search for the poses
that agree with one C-arm (`solvers.start.robust`).
"""

from dataclasses import dataclass, field

import numpy as np

from solvers.estimate import Estimate
from solvers.problem import Problem
from solvers.start import robust
from solvers.start.axes import STARTS, axes_of


@dataclass(frozen=True)
class Options:
    """Options of the closed form."""

    fix_non_orthogonality: bool = True
    """Take the axes as perpendicular (the paper's model) instead of estimating epsilon."""
    starts: int = field(default=STARTS, metadata={"min": 1, "max": 9})
    """How many of the smallest eigenvectors are refined; the best is kept."""
    reject_outliers: bool = True
    """Leave out the poses that do not agree with one C-arm."""
    seed: int = 0
    """Seed of the samples from which the agreeing poses are found."""


def solve(problem: Problem, options: Options = Options()) -> Estimate:
    """The chain from poses alone. Needs orientations; raises ValueError without them."""
    used = robust.inliers(problem, options.seed) if options.reject_outliers else np.ones(len(problem), dtype=bool)
    agreeing = problem if used.all() else problem.select(used)
    axes = axes_of(agreeing, options.fix_non_orthogonality, options.starts)
    return Estimate.of_torus("closed_form", axes.torus(agreeing), used=used)
