"""The contract of a solver, each check a function of the solver's name; an AssertionError says what is broken.

`carm_kin.testing.invariance` has what must not change the answer.
"""

import ast
import dataclasses
import inspect

import numpy as np

import solvers
from carm_kin.testing import invariance
from carm_kin.testing.truth import DATA, TRUTH, assert_close
from solvers.estimate import Estimate
from solvers.problem import Problem


def check_solver(name: str) -> None:
    """Every check here and in `invariance`.

    Raises AssertionError for a broken promise, KeyError where no solver has that name.
    """
    for check in (
        options_are_documented,
        gives_an_estimate_of_its_name,
        agrees_with_itself_and_with_the_truth,
        modifies_nothing,
        gives_the_same_bytes_again,
        has_a_seed_where_it_is_random,
        invariance.moves_with_the_world_frame,
        invariance.moves_with_the_sensor_frame,
        invariance.turns_with_the_sensor_frame,
        invariance.scales_with_lengths,
        invariance.does_not_depend_on_the_order,
        invariance.does_not_depend_on_the_order_without_labels,
    ):
        check(name)


def options_are_documented(name: str) -> None:
    """``Options`` is a frozen dataclass with a default and a docstring under each field."""
    module = solvers.solver(name)
    options, default, other = module.Options, module.Options(), module.Options()
    assert dataclasses.is_dataclass(options), "Options is no dataclass"
    assert options.__dataclass_params__.frozen, "Options is not frozen"  # pyright: ignore[reportAttributeAccessIssue]
    assert default == other, "two default Options differ"
    (body,) = [
        node.body
        for node in ast.parse(inspect.getsource(module)).body
        if isinstance(node, ast.ClassDef) and node.name == "Options"
    ]
    assert _is_text(body[0]), "Options has no docstring"
    fields = [k for k, node in enumerate(body) if isinstance(node, ast.AnnAssign)]
    assert len(fields) == len(dataclasses.fields(options)), "Options has fields that are not written in it"
    for k in fields:
        below = body[k + 1] if k + 1 < len(body) else None
        assert _is_text(below), f"no docstring under {ast.unparse(body[k])}"


def _is_text(node: ast.stmt | None) -> bool:
    value = node.value if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str) and len(value.value) > 10


def gives_an_estimate_of_its_name(name: str) -> None:
    """``solve(problem, options=Options())``, documented, gives an `Estimate` with finite numbers."""
    module = solvers.solver(name)
    parameters = list(inspect.signature(module.solve).parameters.values())
    assert [p.name for p in parameters] == ["problem", "options"], "solve takes (problem, options)"
    assert parameters[1].default == module.Options(), "the options of solve are not Options() by default"
    assert module.__doc__, "the module has no docstring"
    assert module.solve.__doc__, "solve has no docstring"
    estimate = module.solve(DATA)
    assert isinstance(estimate, Estimate), f"solve gives a {type(estimate).__name__}, not an Estimate"
    assert estimate.solver == name, f"the estimate is of '{estimate.solver}', not of '{name}'"
    assert estimate.converged, "the estimate of a clean recording has not converged"
    assert estimate.center.shape == (1, 3), f"the centre has the shape {estimate.center.shape}, not (1, 3)"
    assert np.isfinite(estimate.center).all(), "the centre is not finite"
    for note in estimate.notes:
        assert note.code.isidentifier(), f"the code '{note.code}' is no identifier"
        assert note.message, f"the note '{note.code}' has no message"


def agrees_with_itself_and_with_the_truth(name: str) -> None:
    """105 poses of 1 mm and 1 mrad: any sensible estimate lies within 5 mm and 20 mrad; a swapped axis does not."""
    estimate = solvers.solver(name).solve(DATA)
    assert np.linalg.norm(estimate.center - TRUTH.center) < 5e-3, "the centre is more than 5 mm off"
    assert_close(abs(estimate.major_radius), TRUTH.R, 5e-3, "major_radius")
    if estimate.offset is not None:
        assert np.linalg.norm(estimate.offset - TRUTH.offset) < 5e-3, "the offset is more than 5 mm off"
    if estimate.minor_radius is not None:
        assert_close(estimate.minor_radius, TRUTH.b, 5e-3, "minor_radius")
    if estimate.torus is not None:
        np.testing.assert_array_equal(estimate.offset, estimate.torus.offset, "offset and torus differ")
        np.testing.assert_array_equal(estimate.center, estimate.torus.center, "center and torus differ")
        assert_close(estimate.torus.T_world_torus, TRUTH.T_world_torus, 0.02, "T_world_torus")
        assert_close(estimate.torus.T_sensor_carm, TRUTH.T_sensor_carm, 0.02, "T_sensor_carm")
    if estimate.covariance is not None:
        matrix = estimate.covariance.matrix
        assert matrix.shape == (len(estimate.covariance.names),) * 2, "the covariance has not one name a row"
        assert_close(matrix, matrix.T, 1e-15, "the covariance and its transpose")
        scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
        least = np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min()
        assert least > -1e-6, "the covariance has a negative eigenvalue"


def modifies_nothing(name: str) -> None:
    """The arrays of the problem are as before; they refuse to be written to."""
    data = _frozen(DATA)
    solvers.solver(name).solve(data)
    for field in dataclasses.fields(data):
        np.testing.assert_array_equal(getattr(data, field.name), getattr(DATA, field.name), field.name)


def _frozen(data: Problem) -> Problem:
    copies = {}
    for field in dataclasses.fields(data):
        value = getattr(data, field.name)
        if isinstance(value, np.ndarray):
            value = value.copy()
            value.setflags(write=False)
        copies[field.name] = value
    return Problem(**copies)


def gives_the_same_bytes_again(name: str) -> None:
    """The same problem gives the same numbers to the last bit."""
    one, other = (solvers.solver(name).solve(DATA) for _ in range(2))
    compared = 0
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, (np.ndarray, float, int)):
            assert np.asarray(a).tobytes() == np.asarray(b).tobytes(), f"{field.name} differs from run to run"
            compared += 1
    assert compared > 4, "the estimate has hardly any numbers"


def has_a_seed_where_it_is_random(name: str) -> None:
    """Random numbers come from a generator with the option ``seed``."""
    module = solvers.solver(name)
    source = inspect.getsource(module)
    if "default_rng" in source:
        assert "seed" in {f.name for f in dataclasses.fields(module.Options)}, "Options has no seed"
        assert "default_rng()" not in source, "default_rng() has no seed"
    for loose in ("np.random.rand", "np.random.normal", "np.random.seed", "np.random.choice", "import random"):
        assert loose not in source, f"{loose} has no seed of its own"
