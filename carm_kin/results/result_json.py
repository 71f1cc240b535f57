"""A result as the content of its JSON file, and back: mm and degrees there, metres and radians here.

The unit of a number follows from the name of its field: ``_m`` and ``_rad`` become ``_mm`` and ``_deg``,
a transform ``T_...`` has its translation in mm.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import NoneType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from carm_kin.errors import InputError
from carm_kin.files import write_atomically
from carm_kin.typed import alternatives, check_names, typed
from solvers.estimate import Covariance
from solvers.se3 import Array

T = TypeVar("T")

MAX_BYTES = 200_000_000
"""A larger file is no result."""

_DEGREES = float(np.degrees(1.0))
_MM_OF_TRANSFORM = np.array([[1.0, 1.0, 1.0, 1e3]] * 3 + [[1.0] * 4])


def read_object(path: Path) -> dict[str, Any]:
    """The JSON object in a file. Raises InputError where there is none, or a name in it stands twice."""
    try:
        if not path.is_file():
            raise InputError("is not a file" if path.exists() else "no such file", file=path)
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"is larger than {MAX_BYTES // 1_000_000} MB, which is no result", file=path)
        data = json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=_unique)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    except json.JSONDecodeError as error:
        raise InputError(f"is not JSON: {error.msg}", file=path, line=error.lineno) from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"is not JSON: {error}", file=path) from None
    if not isinstance(data, dict):
        raise InputError("holds no JSON object", file=path)
    return data


def json_text(data: Mapping[str, Any], path: str | os.PathLike | None) -> str:
    """The text of a file with this content; written to ``path``, whole or not at all, where one is given.

    Raises InputError where the place cannot be written.
    """
    text = json.dumps(data, indent=2, allow_nan=False) + "\n"
    if path is not None:
        write_atomically(Path(path), text)
    return text


def object_of(schema: str, record: Any) -> dict[str, Any]:
    """The content of the file of a dataclass: its schema and all its fields, units in the names."""
    written = {name_in_file(f.name): to_json_value(getattr(record, f.name), f.name) for f in fields(record)}
    return {"schema": schema} | written


def to_json_value(value: Any, name: str = "") -> Any:
    """What stands in the file for the value of the field ``name``."""
    if isinstance(value, Covariance):
        names = [_covariance_name(name) for name in value.names]
        return {"names": names, "matrix": (value.matrix * _covariance_scale(names)).tolist()}
    if is_dataclass(value) and not isinstance(value, type):
        return {name_in_file(f.name): to_json_value(getattr(value, f.name), f.name) for f in fields(value)}
    if isinstance(value, Mapping):
        return {name_in_file(str(key)): to_json_value(entry, str(key)) for key, entry in value.items()}
    if isinstance(value, (tuple, list)):
        return [to_json_value(entry, name) for entry in value]
    if isinstance(value, np.ndarray):
        return (value * _scale(name)).tolist()
    if isinstance(value, (float, np.floating)):
        scaled = float(value) * float(_scale(name))
        return scaled if np.isfinite(scaled) else None
    return value.item() if isinstance(value, np.generic) else value


def of_json_value(hint: Any, value: Any, name: str, place: str) -> Any:
    """The value of the field ``name`` of type ``hint``. Raises InputError that says where, in ``place``."""
    kinds = alternatives(hint)
    if value is None and NoneType in kinds:
        return None
    kind = kinds[0]
    if kind == Array:
        return _array(value, name, place)
    if kind is Covariance:
        return _covariance(value, place)
    if isinstance(kind, type) and is_dataclass(kind):
        return of_json_object(kind, value, place)
    if get_origin(kind) is tuple:
        entries = _sequence(value, place)
        return tuple(of_json_value(get_args(kind)[0], x, name, f"{place}[{i}]") for i, x in enumerate(entries))
    value = typed(hint, value, place)
    if isinstance(value, Mapping):
        here = {_name_here(key): entry for key, entry in value.items()}
        return {key: _unscaled(x, _scale(key)).item() if isinstance(x, float) else x for key, x in here.items()}
    return _unscaled(value, _scale(name)).item() if isinstance(value, float) else value


def of_json_object(kind: type[T], value: Any, place: str, skipped: tuple[str, ...] = ()) -> T:
    """The dataclass ``kind``; every field but the ``skipped`` ones must be there, and nothing else."""
    _check_object(value, place)
    hints = {name: hint for name, hint in get_type_hints(kind).items() if name not in skipped}
    keys = [name_in_file(name) for name in hints]
    check_names(keys, keys, value, place or "the result")
    inside = f"{place}." if place else ""
    return kind(
        **{
            name: of_json_value(hint, value[key], name, inside + key)
            for key, (name, hint) in zip(keys, hints.items(), strict=True)
        }
    )


def name_in_file(name: str) -> str:
    """The key in the file: millimetres for metres, degrees for radians."""
    if name.endswith("_m"):
        return name[:-2] + "_mm"
    return name[:-4] + "_deg" if name.endswith("_rad") else name


def _name_here(key: str) -> str:
    """The field of a key in the file."""
    if key.endswith("_mm"):
        return key[:-3] + "_m"
    return key[:-4] + "_rad" if key.endswith("_deg") else key


def _scale(name: str) -> Array:
    """What the value of the field ``name`` is multiplied by in the file; () or (4, 4)."""
    if name.startswith("T_"):
        return _MM_OF_TRANSFORM
    return np.array(1e3 if name.endswith("_m") else _DEGREES if name.endswith("_rad") else 1.0)


def _unscaled(value: ArrayLike, scale: Array) -> Array:
    """Back to m and rad. Scaled again it is what stood in the file, to the last bit."""
    return np.asarray(value, dtype=float) / scale


def _check_object(value: Any, place: str) -> None:
    if not isinstance(value, dict):
        raise InputError(f"{place} must be a JSON object")


def _sequence(value: Any, place: str) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"{place} must be a list")
    return value


def _array(value: Any, name: str, place: str) -> Array:
    """(4, 4) for a transform, (K,) for singular values, else (3,)."""
    if name.startswith("T_"):
        rows = [_numbers(row, f"{place}[{i}]", 4) for i, row in enumerate(_sequence(value, place))]
        if len(rows) != 4:
            raise InputError(f"{place} must have 4 rows, not {len(rows)}")
        return _unscaled(rows, _scale(name))
    return _unscaled(_numbers(value, place, None if name == "singular_values" else 3), _scale(name))


def _numbers(value: Any, place: str, count: int | None) -> list[float]:
    numbers = [typed(float, x, f"{place}[{i}]") for i, x in enumerate(_sequence(value, place))]
    if count is not None and len(numbers) != count:
        raise InputError(f"{place} must have {count} numbers, not {len(numbers)}")
    return numbers


def _covariance(value: Any, place: str) -> Covariance:
    _check_object(value, place)
    check_names(["names", "matrix"], ["names", "matrix"], value, place)
    keys = [typed(str, x, f"{place}.names[{i}]") for i, x in enumerate(_sequence(value["names"], f"{place}.names"))]
    rows = _sequence(value["matrix"], f"{place}.matrix")
    matrix = np.array([_numbers(row, f"{place}.matrix[{i}]", len(keys)) for i, row in enumerate(rows)])
    if len(rows) != len(keys):
        raise InputError(f"{place}.matrix must have {len(keys)} rows, one a name, not {len(rows)}")
    names = tuple(key.removesuffix("_mm").removesuffix("_deg") for key in keys)
    return Covariance(names, _unscaled(matrix.reshape(len(keys), len(keys)), _covariance_scale(keys)))


def _covariance_name(name: str) -> str:
    """The key in the file: non-orthogonality in degrees, axes without a unit, lengths in mm."""
    if "orthogonality" in name:
        return name + "_deg"
    return name if "_axis_" in name else name + "_mm"


def _covariance_scale(keys: list[str]) -> Array:
    scale = [float(_scale(_name_here(key))) for key in keys]
    return np.outer(scale, scale)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"'{next(name for name in names if names.count(name) > 1)}' stands twice in one object")
    return found
