"""The contracts that every solver, locus, format and export keeps, for authors of one to run on their own.

A check takes the name under which it is found, a format a `Sample` besides; docs/extending.md has an example of each.
"""

from carm_kin.testing.export import check_export
from carm_kin.testing.format import Sample, check_format
from carm_kin.testing.locus import check_locus
from carm_kin.testing.solver import check_solver

__all__ = ["Sample", "check_export", "check_format", "check_locus", "check_solver"]
