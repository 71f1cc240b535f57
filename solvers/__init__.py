"""The mathematics of C-arm calibration: arrays in, an estimate out.

Every solver is one module with a frozen dataclass ``Options`` and a function
``solve(problem, options) -> Estimate``; `solver` finds it by its name. Nothing here knows a file,
a URDF or a screen.
"""

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType

from solvers.estimate import Estimate
from solvers.problem import Problem
from solvers.torus import Torus

__all__ = ["Estimate", "Problem", "Torus", "solver", "solver_names"]


def solver_names() -> tuple[str, ...]:
    """The names of all solvers: the modules of this package that have ``solve`` and ``Options``."""
    modules = (info.name for info in iter_modules(__path__) if not info.ispkg)
    return tuple(name for name in modules if _is_solver(import_module(f"{__name__}.{name}")))


def solver(name: str) -> ModuleType:
    """The solver's module, imported when asked for. Raises KeyError for an unknown name."""
    if name.isidentifier() and name in {info.name for info in iter_modules(__path__)}:
        module = import_module(f"{__name__}.{name}")
        if _is_solver(module):
            return module
    raise KeyError(name)


def _is_solver(module: ModuleType) -> bool:
    return hasattr(module, "solve") and hasattr(module, "Options")
