"""What is found by its name: the modules of a package, and those that other distributions add by an entry point."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pkgutil import ModuleInfo, iter_modules
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")


class PluginWarning(UserWarning):
    """A plug-in is passed over; the message names it and says why."""


class PluginError(ValueError):
    """A plug-in cannot be used, or raised what it should not; the cause is chained."""


@dataclass(frozen=True)
class Kind:
    """One kind of module, such as the solvers."""

    package: str
    """Every public module of it is one."""
    group: str
    """Of the entry points that name one each."""
    needs: tuple[str, ...]
    """Attributes without which a plug-in is none."""
    parts: frozenset[str] = frozenset()
    """Modules of the package that are none."""

    def own(self) -> tuple[str, ...]:
        """The names of those in the package, sorted; none is imported."""
        found = (info.name for info in self._modules() if not info.ispkg and not info.name.startswith("_"))
        return tuple(sorted(name for name in found if name not in self.parts))

    def listed(self) -> tuple[str, ...]:
        """Every name, first those in the package; no module is imported, so that a broken plug-in is among them."""
        return (*self.own(), *sorted(self._entries()))

    def names(self) -> tuple[str, ...]:
        """The names of those in the package and of the plug-ins that can be used; warns of each that cannot."""
        found, entries = [], self._entries()
        for entry in _entry_points(self.group):
            if entries.get(entry.name) is not entry:
                pass_over(f"{_source(entry)}: the name is taken already")
                continue
            try:
                self._plugin(entry)
            except PluginError as error:
                pass_over(str(error))
            else:
                found.append(entry.name)
        return (*self.own(), *sorted(found))

    def find(self, name: str) -> ModuleType:
        """The module of that name. Raises KeyError for an unknown name, PluginError for a plug-in that is broken."""
        if name in self.own():
            return import_module(f"{self.package}.{name}")
        return self._plugin(self._entries()[name])

    def call(self, name: str, passed: tuple[type[Exception], ...], function: Callable[..., T], *given: Any) -> T:
        """What a function of the module ``name`` gives.

        Whatever one of a plug-in raises becomes a PluginError, but for the kinds that are ``passed`` on.
        """
        if name in self.own():
            return function(*given)
        with _blamed(self._entries()[name], passed):
            return function(*given)

    def _modules(self) -> Iterator[ModuleInfo]:
        return iter_modules(import_module(self.package).__path__)

    def _entries(self) -> "dict[str, EntryPoint]":
        """The entry points by their names, the first of each name that is not one of the package's modules."""
        taken = {info.name for info in self._modules()}
        entries = reversed(_entry_points(self.group))
        return {entry.name: entry for entry in entries if entry.name not in taken}

    def _plugin(self, entry: "EntryPoint") -> ModuleType:
        module = _loaded(entry)
        if isinstance(module, PluginError):
            raise module
        if missing := [name for name in self.needs if not hasattr(module, name)]:
            raise PluginError(f"{_source(entry)}: {entry.value} has no {' and no '.join(missing)}")
        return module


@cache
def pass_over(problem: str) -> None:
    """Warn of a plug-in, once in a process."""
    warnings.warn(f"passed over {problem}", PluginWarning, stacklevel=2)


@cache
def _entry_points(group: str) -> "tuple[EntryPoint, ...]":
    from importlib.metadata import entry_points

    return tuple(entry_points(group=group))


@cache
def _loaded(entry: "EntryPoint") -> Any:
    """What the entry point names, or the PluginError that says why there is nothing: tried once."""
    try:
        with _blamed(entry):
            return entry.load()
    except PluginError as error:
        return error


@contextmanager
def _blamed(entry: "EntryPoint", passed: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """Raise PluginError for whatever the code of another distribution raises, but for what is ``passed``."""
    try:
        yield
    except passed:
        raise
    except (Exception, SystemExit) as error:
        raise PluginError(f"{_source(entry)}: {type(error).__name__}: {error}") from error


def _source(entry: "EntryPoint") -> str:
    distribution = f" of the package {entry.dist.name} {entry.dist.version}" if entry.dist else ""
    return f"'{entry.name}' ({entry.group}){distribution}"
