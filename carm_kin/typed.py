"""Values from outside (options, protocol files, result files) checked against the types of a dataclass."""

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields
from math import inf, isfinite
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from carm_kin.errors import InputError

T = TypeVar("T")

_WORDS = {
    bool: "true or false",
    int: "a whole number",
    float: "a finite number",
    str: "a text",
    NoneType: "null",
    Mapping: "a table",
}


def typed(hint: Any, value: Any, place: str) -> Any:
    """``value`` as the type ``hint``: bool, int, float, str, None, a union of these (Any: of all), or Mapping[str, X].

    A whole number serves as a float, nothing else is converted. Raises InputError that names ``place``
    and what would be right; numbers must be finite.
    """
    for option in alternatives(hint):
        if (get_origin(option) or option) is Mapping and isinstance(value, Mapping):
            return {key: typed(get_args(option)[1], entry, f"{place}.{key}") for key, entry in value.items()}
        if _fits(option, value):
            return option(value) if option in (int, float) else value
    right = " or ".join(_WORDS[get_origin(option) or option] for option in alternatives(hint))
    raise InputError(f"{place} must be {right}, not {_shown(value)}")


def alternatives(hint: Any) -> tuple[Any, ...]:
    """The types of a union, the scalar ones for Any, else the type itself."""
    if hint is Any:
        return bool, int, float, str, NoneType
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def record(kind: type[T], values: Any, place: str) -> T:
    """The dataclass ``kind`` made of ``values``. Raises InputError for a wrong, missing or unknown entry."""
    if not isinstance(values, Mapping):
        raise InputError(f"{place} must be a table, not {_shown(values)}")
    every: tuple[Field, ...] = fields(kind)  # pyright: ignore[reportArgumentType]
    required = [f.name for f in every if f.default is MISSING and f.default_factory is MISSING]
    check_names([f.name for f in every], required, values, place)
    hints = get_type_hints(kind)
    return kind(**{name: typed(hints[name], value, f"{place}: {name}") for name, value in values.items()})


def check_names(known: list[str], required: list[str], values: Mapping[str, Any], place: str) -> None:
    """Raise InputError where an entry is unknown or a required one is missing."""
    for name in values:
        if name not in known:
            raise InputError(f"{place}: '{name}' is unknown; it may have {', '.join(known)}")
    for name in required:
        if name not in values:
            raise InputError(f"{place}: '{name}' is missing; needed are {', '.join(required)}")


def above_zero(named: str, value: float | None, unit: float) -> float | None:
    """A value times its ``unit``. Raises InputError where it is not a finite number above 0."""
    if value is None:
        return None
    if not 0 < value < inf:
        raise InputError(f"{named} must be a finite number above 0, not {value}; leave it out if it is not known")
    return value * unit


def check_from_zero(named: str, value: float | None) -> None:
    """Raise InputError for a value that is not a finite number from 0 on."""
    if value is not None and not 0 <= value < inf:
        raise InputError(f"{named} must be a finite number from 0 on, not {value}")


def _fits(kind: Any, value: Any) -> bool:
    if kind in (bool, str, NoneType):
        return isinstance(value, kind)
    if isinstance(value, bool):
        return False
    if kind is int:
        return isinstance(value, Integral)
    try:
        return kind is float and isinstance(value, Real) and isfinite(value)
    except OverflowError:
        return False


def _shown(value: Any) -> str:
    """A value as it would stand in a file, cut to a readable length."""
    words = {None: "null", True: "true", False: "false"}
    if value is None or isinstance(value, bool):
        return words[value]
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
