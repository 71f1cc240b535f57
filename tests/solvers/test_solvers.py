"""Contracts of every solver and every locus, found by name: a new file is tested by being there."""

import ast
import dataclasses
import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import solvers
from helpers.simulated import machine, problem, shuffled, sweeps_deg
from solvers import direct, loci
from solvers.estimate import Estimate
from solvers.problem import Problem

TURN = np.arange(0, 360, 24)
MOTION = sweeps_deg((-60, 0, 35, 80), TURN, (0, 40, 75), TURN)
TRUTH = machine(1, 0.25)
SIGMA_T, SIGMA_R = 1e-3, 1e-3
DATA = problem(TRUTH, MOTION, SIGMA_T, SIGMA_R)
NAMES = solvers.solver_names()
VECTORS = st.tuples(*[st.floats(-2, 2)] * 3).map(np.array)

every_solver = pytest.mark.parametrize("name", NAMES)
every_locus = pytest.mark.parametrize("name", loci.locus_names())


def solve(name: str, data: Problem) -> Estimate:
    """With the solver's defaults, its random sampling off where it has one: sampling follows the order and the
    rounding of the poses, and the invariances here are those of the estimator."""
    module = solvers.solver(name)
    known = {f.name for f in dataclasses.fields(module.Options)}
    plain = module.Options(iterations=0) if {"seed", "iterations"} <= known else module.Options()
    return module.solve(data, plain)


def test_the_known_solvers_are_found():
    assert set(NAMES) >= {"closed_form", "decomposed", "direct", "kinematic", "surface"}
    assert set(loci.locus_names()) >= {"circle", "point", "published_circle"}


@pytest.mark.parametrize("name", ["", "nonsense", "se3", "loci", "estimate", "../direct", "solvers.direct", "os"])
def test_what_is_no_solver_is_refused(name):
    with pytest.raises(KeyError):
        solvers.solver(name)


@every_solver
def test_options_are_a_frozen_dataclass_with_a_docstring_under_each_field(name):
    options = solvers.solver(name).Options
    assert dataclasses.is_dataclass(options)
    assert options.__dataclass_params__.frozen
    assert options() == options()
    (body,) = [
        node.body
        for node in ast.parse(inspect.getsource(solvers.solver(name))).body
        if isinstance(node, ast.ClassDef) and node.name == "Options"
    ]
    assert isinstance(body[0], ast.Expr)
    fields = [k for k, node in enumerate(body) if isinstance(node, ast.AnnAssign)]
    assert len(fields) == len(dataclasses.fields(options))
    for k in fields:
        below = body[k + 1] if k + 1 < len(body) else None
        assert isinstance(below, ast.Expr), f"no docstring under {body[k].target.id}"
        assert isinstance(below.value, ast.Constant)
        assert len(below.value.value) > 10


@every_solver
def test_solve_takes_a_problem_and_gives_an_estimate_of_its_name(name):
    module = solvers.solver(name)
    parameters = list(inspect.signature(module.solve).parameters.values())
    assert [p.name for p in parameters] == ["problem", "options"]
    assert parameters[1].default == module.Options()
    assert module.__doc__
    assert module.solve.__doc__
    estimate = module.solve(DATA)
    assert isinstance(estimate, Estimate)
    assert estimate.solver == name
    assert estimate.converged
    assert estimate.center.shape == (1, 3)
    assert np.isfinite(estimate.center).all()
    for note in estimate.notes:
        assert note.code.isidentifier()
        assert note.message


@every_solver
def test_the_estimate_agrees_with_itself_and_with_the_truth(name):
    estimate = solvers.solver(name).solve(DATA)
    # 105 poses of 1 mm and 1 mrad: any sensible estimate lies within some mm and mrad; a swapped axis does not
    assert np.linalg.norm(estimate.center - TRUTH.center) < 5e-3
    assert abs(estimate.major_radius) == pytest.approx(TRUTH.R, abs=5e-3)
    if estimate.offset is not None:
        assert np.linalg.norm(estimate.offset - TRUTH.offset) < 5e-3
    if estimate.minor_radius is not None:
        assert estimate.minor_radius == pytest.approx(TRUTH.b, abs=5e-3)
    if estimate.torus is not None:
        np.testing.assert_array_equal(estimate.offset, estimate.torus.offset)
        np.testing.assert_array_equal(estimate.center, estimate.torus.center)
        np.testing.assert_allclose(estimate.torus.T_world_torus, TRUTH.T_world_torus, atol=0.02)
        np.testing.assert_allclose(estimate.torus.T_sensor_carm, TRUTH.T_sensor_carm, atol=0.02)
    if estimate.covariance is not None:
        matrix = estimate.covariance.matrix
        assert matrix.shape == (len(estimate.covariance.names),) * 2
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-15)
        scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
        assert np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min() > -1e-6


def frozen(data: Problem) -> Problem:
    """A copy whose arrays refuse to be written to."""
    copies = {}
    for field in dataclasses.fields(data):
        value = getattr(data, field.name)
        if isinstance(value, np.ndarray):
            value = value.copy()
            value.setflags(write=False)
        copies[field.name] = value
    return Problem(**copies)


@every_solver
def test_the_problem_is_not_modified(name):
    data = frozen(DATA)
    solvers.solver(name).solve(data)
    for field in dataclasses.fields(data):
        np.testing.assert_array_equal(getattr(data, field.name), getattr(DATA, field.name))


@every_solver
def test_the_same_problem_gives_the_same_bytes(name):
    one, other = (solvers.solver(name).solve(DATA) for _ in range(2))
    compared = 0
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, (np.ndarray, float, int)):
            assert np.asarray(a).tobytes() == np.asarray(b).tobytes(), field.name
            compared += 1
    assert compared > 4


def same(one: Estimate, other: Estimate, tolerance: float = 1e-2):
    """Equal to a hundredth of the noise of one pose: what iterations that stop at 1e-3 sigma can promise."""
    near, turn = tolerance * SIGMA_T, tolerance * SIGMA_R
    np.testing.assert_allclose(one.center, other.center, atol=near)
    assert one.major_radius == pytest.approx(other.major_radius, abs=near)
    for field, atol in (("offset", near), ("minor_radius", near), ("angular_axis", turn), ("sigma_t", near)):
        a, b = getattr(one, field), getattr(other, field)
        assert (a is None) == (b is None)
        if a is not None:
            np.testing.assert_allclose(a, b, atol=atol, err_msg=field)
    if one.torus is not None:
        np.testing.assert_allclose(one.torus.T_world_torus, other.torus.T_world_torus, atol=near)
        np.testing.assert_allclose(one.torus.T_sensor_carm, other.torus.T_sensor_carm, atol=near)
    if one.covariance is not None:
        assert one.covariance.names == other.covariance.names


def rotation(seed: int) -> np.ndarray:
    return Rotation.random(random_state=seed).as_matrix()


@every_solver
@given(seed=st.integers(0, 10_000), shift=VECTORS)
@settings(max_examples=8)
def test_moving_the_world_frame_moves_the_world_part_alone(name, seed, shift):
    Q = rotation(seed)
    there = dataclasses.replace(
        DATA, p_world_sensor=DATA.p_world_sensor @ Q.T + shift, R_world_sensor=Q @ DATA.rotations
    )
    one, other = solve(name, DATA), solve(name, there)
    back = {"center": (other.center - shift) @ Q}
    if other.angular_axis is not None:
        back["angular_axis"] = directed(other.angular_axis @ Q, one.angular_axis, other.torus)
    if other.torus is not None:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Q, shift
        moved = dataclasses.replace(other.torus, T_world_torus=np.linalg.inv(T) @ other.torus.T_world_torus)
        back["torus"] = moved
    same(one, dataclasses.replace(other, **back))


def directed(axis: np.ndarray, like: np.ndarray, torus) -> np.ndarray:
    """Without a chain the direction of an axis is a convention."""
    return axis if torus is not None else axis * np.sign((axis * like).sum(axis=1, keepdims=True))


@every_solver
@given(seed=st.integers(0, 10_000), shift=VECTORS)
@settings(max_examples=8)
def test_moving_the_sensor_frame_moves_the_offset_with_it(name, seed, shift):
    # the new sensor frame stands at `move` in the old one; positions are then those of another point, whose
    # errors are no longer isotropic and independent of the orientations, so the data have none
    exact = problem(TRUTH, MOTION)
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = rotation(seed), 0.1 * shift
    p = exact.p_world_sensor + exact.rotations @ move[:3, 3]
    there = dataclasses.replace(exact, p_world_sensor=p, R_world_sensor=exact.rotations @ move[:3, :3])
    one, other = solve(name, exact), solve(name, there)
    np.testing.assert_allclose(one.center, other.center, atol=1e-6)
    assert abs(one.major_radius) == pytest.approx(abs(other.major_radius), abs=1e-6)
    if one.offset is not None:
        np.testing.assert_allclose(move[:3, :3] @ other.offset + move[:3, 3], one.offset, atol=1e-6)
    if one.torus is not None:
        np.testing.assert_allclose(move @ other.torus.T_sensor_carm, one.torus.T_sensor_carm, atol=1e-6)
        np.testing.assert_allclose(other.torus.T_world_torus, one.torus.T_world_torus, atol=1e-6)


@every_solver
@given(seed=st.integers(0, 10_000))
@settings(max_examples=4)
def test_turning_the_sensor_frame_alone_changes_nothing_but_the_offsets_frame(name, seed):
    Q = rotation(seed)  # isotropic noise stays what it is
    one, other = solve(name, DATA), solve(name, dataclasses.replace(DATA, R_world_sensor=DATA.rotations @ Q))
    back = {}
    if other.offset is not None:
        back["offset"] = Q @ other.offset
    if other.torus is not None:
        T = np.eye(4)
        T[:3, :3] = Q
        back["torus"] = dataclasses.replace(other.torus, T_sensor_carm=T @ other.torus.T_sensor_carm)
    same(one, dataclasses.replace(other, **back))


@every_solver
@given(factor=st.floats(0.5, 2.0))
@settings(max_examples=5)
def test_lengths_scale(name, factor):
    one = solve(name, DATA)
    other = solve(name, dataclasses.replace(DATA, p_world_sensor=factor * DATA.p_world_sensor))
    lengths = ("center", "offset", "major_radius", "minor_radius", "sigma_t")
    back = {k: getattr(other, k) / factor for k in lengths if getattr(other, k) is not None}
    if other.torus is not None:
        tori, mount = other.torus.T_world_torus.copy(), other.torus.T_sensor_carm.copy()
        tori[:, :3, 3] /= factor
        mount[:3, 3] /= factor
        back["torus"] = dataclasses.replace(other.torus, T_world_torus=tori, T_sensor_carm=mount)
    same(one, dataclasses.replace(other, **back))


@every_solver
@given(seed=st.integers(0, 10_000))
@settings(max_examples=5)
def test_the_order_of_the_poses_does_not_matter(name, seed):
    one, other = solve(name, DATA), solve(name, shuffled(DATA, seed))
    if other.angular_axis is not None:
        axis = directed(other.angular_axis, one.angular_axis, other.torus)
        other = dataclasses.replace(other, angular_axis=axis)
    # the middle pose of a sweep, of which the order decides, may give a sign but no number
    same(one, other)


@every_solver
@given(seed=st.integers(0, 10_000))
@settings(max_examples=4)
def test_without_labels_the_order_changes_the_zeros_alone(name, seed):
    data = dataclasses.replace(DATA, label=np.full(DATA.label.shape, np.nan))
    one, other = solve(name, data), solve(name, shuffled(data, seed))
    near = 1e-2 * SIGMA_T
    np.testing.assert_allclose(one.center, other.center, atol=near)
    assert abs(one.major_radius) == pytest.approx(abs(other.major_radius), abs=near)
    if one.offset is not None:
        np.testing.assert_allclose(one.offset, other.offset, atol=near)
    if one.torus is not None:
        assert abs(one.torus.orbital_axis @ other.torus.orbital_axis) == pytest.approx(1, abs=1e-6)
        assert not other.torus.referenced.any()
        assert not other.torus.orbital_referenced


@every_solver
def test_what_is_random_has_a_seed(name):
    module = solvers.solver(name)
    source = inspect.getsource(module)
    if "default_rng" in source:
        assert "seed" in {f.name for f in dataclasses.fields(module.Options)}
        assert "default_rng()" not in source
    for loose in ("np.random.rand", "np.random.normal", "np.random.seed", "np.random.choice", "import random"):
        assert loose not in source


def isocentric() -> Problem:
    """R = 0 and perpendicular axes: the pivot stands still, so that every locus has it."""
    return problem(machine(3, 0.0), sweeps_deg((-60, 0, 35, 80), TURN, (0, 40, 75), TURN))


def at_the_truth(name: str) -> tuple[loci.Locus, Problem, np.ndarray]:
    """The locus and its theta where the residuals of exact data must vanish: as the solver finds it."""
    chosen, data = loci.locus(name), isocentric()
    found: list = []

    class Spy:
        """The locus, with a note of the theta that it is asked to report."""

        def __getattr__(self, attribute):
            return getattr(chosen, attribute)

        def estimate(self, theta, *args, **more):
            found.append(np.array(theta))
            return chosen.estimate(theta, *args, **more)

        def __hash__(self):
            return hash(chosen)

    estimate = direct.minimise(data, Spy(), chosen.start(data), 0.7, 100)
    assert estimate.residual is not None
    return chosen, data, found[0]


@every_locus
def test_the_residual_of_a_locus_is_zero_at_the_truth(name):
    import casadi as ca

    chosen, data, theta = at_the_truth(name)
    symbols = ca.SX.sym("theta", chosen.size), ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3), ca.SX.sym("lever")
    residual = ca.Function("residual", list(symbols), [chosen.residual(*symbols)])
    for k in range(0, len(data), 10):
        assert np.abs(residual(theta[0], data.rotations[k], data.p_world_sensor[k], 0.7).full()).max() < 1e-6
    off = theta[0] + 0.01 * np.random.default_rng(0).normal(size=chosen.size)
    assert np.abs(residual(off, data.rotations[0], data.p_world_sensor[0], 0.7).full()).max() > 1e-3


@pytest.mark.parametrize("R", [0.1, -0.1, 0.0])
@pytest.mark.parametrize("epsilon", [0.0, 0.01])
def test_the_residual_of_the_circles_is_zero_at_a_truth_written_out(R, epsilon):
    import casadi as ca

    truth = machine(4, R, epsilon)
    data = problem(truth, MOTION)
    known = {
        "circle": [*truth.center[0], *truth.n[0], R, *truth.offset, *truth.a, np.sin(epsilon)],
        "published_circle": [*truth.center[0], *truth.n[0], abs(R), *truth.offset],
    }
    for name, theta in known.items():
        chosen = loci.locus(name)
        symbols = ca.SX.sym("theta", chosen.size), ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3), ca.SX.sym("lever")
        residual = ca.Function("residual", list(symbols), [chosen.residual(*symbols)])
        for k in range(0, len(data), 7):
            assert np.abs(residual(theta, data.rotations[k], data.p_world_sensor[k], 0.7).full()).max() < 2e-9


@every_locus
def test_the_basis_of_a_locus_is_orthonormal_and_tangent(name):
    chosen, _, theta = at_the_truth(name)
    basis = chosen.basis(theta[0])
    k = basis.shape[1]
    assert basis.shape == (chosen.size, k)
    np.testing.assert_allclose(basis.T @ basis, np.eye(k), atol=1e-12)
    for step in 1e-4 * np.eye(k):
        moved = theta[0] + basis @ step
        # tangent to what `normalised` keeps: to come back costs but the square of the step
        np.testing.assert_allclose(chosen.normalised(moved), moved, atol=1e-7)
    moves_own = np.any(basis[: chosen.own] != 0, axis=0)
    assert not (np.diff(moves_own.astype(int)) > 0).any(), "columns of the placement's own entries come first"
    assert not (moves_own & np.any(basis[chosen.own :] != 0, axis=0)).any()


@every_locus
def test_normalised_is_idempotent_and_modifies_nothing(name):
    chosen, data, theta = at_the_truth(name)
    np.testing.assert_allclose(chosen.normalised(theta), theta, atol=1e-12)
    given_theta = theta * 1.7
    before = given_theta.copy()
    once = chosen.normalised(given_theta)
    np.testing.assert_array_equal(given_theta, before)
    np.testing.assert_allclose(chosen.normalised(once), once, atol=1e-15)
    assert chosen.start(data).shape == theta.shape


@every_locus
def test_a_locus_is_found_by_name_and_can_be_a_key(name):
    chosen = loci.locus(name)
    assert hash(chosen) == hash(loci.locus(name))
    assert chosen == loci.locus(name)
    with pytest.raises(KeyError):
        loci.locus(name + "x")


@every_locus
def test_a_locus_reports_names_and_derivatives_that_fit(name):
    chosen, _, theta = at_the_truth(name)
    names, J = chosen.reported(theta)
    assert J.shape == (len(names), chosen.basis(theta[0]).shape[1])
    assert len(set(names)) == len(names)
