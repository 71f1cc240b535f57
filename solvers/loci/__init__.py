"""Loci on which the pivot moves, each one file, found by its name, here or by an entry point of ``carm_kin.loci``.

A locus states, in ambient coordinates theta, what the pivot ``R_i t + p_i`` must satisfy. Unit
vectors stand in theta with three entries; `Locus.basis` gives the directions in which theta may move.
"""

from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from solvers.estimate import Estimate
from solvers.plugins import Kind
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Axes

if TYPE_CHECKING:
    import casadi as ca

LOCI = Kind(__name__, "carm_kin.loci", needs=("Locus",))


class Locus(Protocol):
    """What `solvers.direct` needs of a locus. Implementations are frozen dataclasses, hence hashable."""

    size: int
    """Length of theta."""
    own: int
    """How many leading entries of theta belong to one placement; the rest is shared."""

    def residual(self, theta: "ca.SX", R: "ca.SX", p: "ca.SX", lever: "ca.SX") -> "ca.SX":
        """Residuals, m, of one pose: R (3, 3), p (3, 1); ``lever`` (m) turns angles into lengths."""
        ...

    def basis(self, theta: Array) -> Array:
        """(size, k) orthonormal columns; those that move the placement's own entries come first."""
        ...

    def normalised(self, theta: Array) -> Array:
        """theta with its unit vectors normalised."""
        ...

    def start(self, problem: Problem) -> Array:
        """(P, size) initial theta from the poses alone."""
        ...

    def reported(self, theta: Array) -> tuple[tuple[str, ...], Array]:
        """Names of the reported quantities and their derivative (K, k) by the tangent of all unknowns."""
        ...

    def estimate(self, theta: Array, problem: Problem, null_direction_sensor: Array, **more: Any) -> Estimate:
        """The answer in the project's terms, from theta (P, size). ``null_direction_sensor`` is the tangent
        vector of least curvature."""
        ...


@runtime_checkable
class SolvedLocus(Locus, Protocol):
    """A locus that has a better solver of its own."""

    def solve(self, problem: Problem, seed: int, reject_outliers: bool) -> Estimate:
        """The estimate, outliers left out where they are to be rejected."""
        ...


@runtime_checkable
class TwoAxisLocus(Locus, Protocol):
    """A locus that belongs to a C-arm: it can start from its axes."""

    def theta(self, axes: Axes) -> Array:
        """(P, size) of the given axes."""
        ...


def reported_by_name(named: dict[str, Array], placements: dict[str, list[Array]]) -> tuple[tuple[str, ...], Array]:
    """Names and rows of `Locus.reported`: vectors get the endings _x, _y, _z, placements their number."""
    entries = list(named.items())
    entries += [
        (f"{name}[{k}]", rows[k])
        for k in range(max(map(len, placements.values())))
        for name, rows in placements.items()
    ]
    names: list[str] = []
    for name, J in entries:
        names += [name] if len(J) == 1 else [f"{name}_{axis}" for axis in "xyz"]
    return tuple(names), np.vstack([J for _, J in entries])


def locus_names() -> tuple[str, ...]:
    """Names of all loci that can be used."""
    return LOCI.names()


def locus(name: str, **options) -> Locus:
    """The locus of that name.

    Raises KeyError for an unknown one, `solvers.plugins.PluginError` for one of another package that is broken.
    """
    return LOCI.find(name).Locus(**options)


def by_option(names: tuple[str, ...]) -> tuple[str, ...]:
    """Those that a user names; the gauge chooses the published ones."""
    return tuple(name for name in names if not name.startswith("published"))
