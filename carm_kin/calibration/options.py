"""Options of a solver, given by name."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar, get_type_hints

from carm_kin.errors import InputError
from carm_kin.typed import alternatives, typed

T = TypeVar("T")


def options_of(options_class: type[T], solver_name: str, given: Mapping[str, Any]) -> T:
    """The solver's options: its defaults, and what is given.

    A field may bound its values by ``metadata={"min": ..., "max": ...}``; a whole number (a count or a
    seed) is never below 0. Raises InputError that names the option, its type and what is valid.
    """
    known = {f.name: f for f in fields(options_class)}  # pyright: ignore[reportArgumentType]
    hints = get_type_hints(options_class)
    chosen = {}
    for name, value in given.items():
        if name not in known:
            valid = ", ".join(known) or "none"
            raise InputError(f"solver '{solver_name}' has no option '{name}'; it has {valid}")
        place = f"option '{name}' of solver '{solver_name}'"
        chosen[name] = typed(hints[name], value, place)
        _check_range(chosen[name], known[name].metadata, int in alternatives(hints[name]), place)
    return options_class(**chosen)


def _check_range(value: Any, bounds: Mapping[str, Any], whole: bool, place: str) -> None:
    if isinstance(value, (bool, str)) or value is None:
        return
    least, most = bounds.get("min", 0 if whole else None), bounds.get("max")
    if least is not None and value < least:
        raise InputError(f"{place} must be at least {least}, not {value}")
    if most is not None and value > most:
        raise InputError(f"{place} must be at most {most}, not {value}")
