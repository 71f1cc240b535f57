"""The mathematics of C-arm calibration: arrays in, an estimate out.

Every solver is one module with a frozen dataclass ``Options`` and a function
``solve(problem, options) -> Estimate``; `solver` finds it by its name, in this package or by an entry
point of the group ``carm_kin.solvers``. Nothing here knows a file, a URDF or a screen.
"""

from types import ModuleType
from typing import TYPE_CHECKING, Any

from solvers.plugins import Kind

if TYPE_CHECKING:
    from solvers.estimate import Estimate
    from solvers.problem import Problem

__all__ = ["SOLVERS", "solve", "solver", "solver_names"]

SOLVERS = Kind(
    __name__,
    "carm_kin.solvers",
    needs=("solve", "Options"),
    parts=frozenset({"estimate", "nearest", "pivot", "plugins", "problem", "se3", "still_point", "told", "torus"}),
)


def solver_names() -> tuple[str, ...]:
    """The names of all solvers that can be used; none of this package is imported."""
    return SOLVERS.names()


def solver(name: str) -> ModuleType:
    """The solver's module, imported when asked for.

    Raises KeyError for an unknown name, `solvers.plugins.PluginError` for one of another package that is broken.
    """
    return SOLVERS.find(name)


def solve(name: str, problem: "Problem", options: Any) -> "Estimate":
    """The estimate of the solver ``name``. Raises ValueError where it cannot solve the problem."""
    return SOLVERS.call(name, (ValueError,), solver(name).solve, problem, options)
