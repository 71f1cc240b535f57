"""Options of a solver are checked against the types of its dataclass."""

import re
from dataclasses import dataclass, field

import numpy as np
import pytest

import solvers
from carm_kin.calibration.options import options_of
from carm_kin.errors import InputError


@dataclass(frozen=True)
class Options:
    count: int = 3
    size_m: float = 0.5
    width_m: float | None = None
    flag: bool = True
    maybe: bool | None = None
    name: str = "a"
    steps: int = field(default=5, metadata={"min": 1, "max": 100})
    share: float = field(default=0.5, metadata={"min": 0, "max": 1})


def test_defaults_and_what_is_given():
    given = {"count": 0, "size_m": 2, "width_m": -1.5, "flag": False, "maybe": None, "name": "b", "steps": 100}
    assert options_of(Options, "x", {}) == Options()
    assert options_of(Options, "x", given) == Options(0, 2.0, -1.5, False, None, "b", 100)
    assert isinstance(options_of(Options, "x", {"size_m": 2}).size_m, float)
    assert options_of(Options, "x", {"count": np.int64(4), "size_m": np.float32(0.5)}) == Options(4, 0.5)


WRONG = [
    ("bogus", 1, "solver 'x' has no option 'bogus'; it has count, size_m, width_m"),
    ("count", "abc", "option 'count' of solver 'x' must be a whole number, not 'abc'"),
    ("count", 1.0, "a whole number, not 1.0"),
    ("count", True, "a whole number, not true"),
    ("count", None, "a whole number, not null"),
    ("count", [1], r"a whole number, not \[1\]"),
    ("count", -1, "at least 0, not -1"),
    ("size_m", "1", "a finite number, not '1'"),
    ("size_m", float("nan"), "a finite number, not nan"),
    ("size_m", float("inf"), "a finite number, not inf"),
    ("size_m", 10**400, "a finite number, not 1000"),
    ("size_m", True, "a finite number, not true"),
    ("width_m", "1", "a finite number or null, not '1'"),
    ("flag", 1, "true or false, not 1"),
    ("flag", None, "true or false, not null"),
    ("maybe", 0, "true or false or null, not 0"),
    ("name", 1, "a text, not 1"),
    ("name", {"a": 1}, "a text, not {'a': 1}"),
    ("steps", 0, "at least 1, not 0"),
    ("steps", 101, "at most 100, not 101"),
    ("share", 1.5, "at most 1, not 1.5"),
    ("share", -0.1, "at least 0, not -0.1"),
]


@pytest.mark.parametrize("name, value, expected", WRONG)
def test_a_wrong_option_says_what_would_be_right(name, value, expected):
    with pytest.raises(InputError) as error:
        options_of(Options, "x", {name: value})
    assert re.search(expected, str(error.value)), error.value
    assert len(str(error.value)) < 200


@pytest.mark.parametrize("name", solvers.solver_names())
def test_every_solver_has_options_of_known_types(name):
    """Each default passes for itself, and a list for none."""
    kind = solvers.solver(name).Options
    defaults = vars(kind())
    assert options_of(kind, name, defaults) == kind()
    for option in defaults:
        with pytest.raises(InputError, match=f"option '{option}' of solver '{name}' must be"):
            options_of(kind, name, {option: []})
