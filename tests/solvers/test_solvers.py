"""Contracts of every solver and every locus, found by name: a new file is tested by being there."""

import importlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import solvers
from carm_kin.testing import invariance, solver
from carm_kin.testing import locus as locus_contract
from carm_kin.testing.truth import MOTION
from helpers.simulated import machine, problem
from solvers import loci

NAMES = solvers.solver_names()
VECTORS = st.tuples(*[st.floats(-2, 2)] * 3).map(np.array)

every_solver = pytest.mark.parametrize("name", NAMES)
every_locus = pytest.mark.parametrize("name", loci.locus_names())


def test_the_known_solvers_are_found():
    assert set(NAMES) >= {"closed_form", "decomposed", "direct", "kinematic", "surface"}
    assert set(loci.locus_names()) >= {"circle", "point", "published_circle"}


def test_the_parts_that_solvers_share_are_none():
    parts = [importlib.import_module(f"solvers.{part}") for part in solvers.SOLVERS.parts]
    assert not [part for part in parts if hasattr(part, "Options")]
    assert all(hasattr(solvers.solver(name), "solve") for name in NAMES)


@pytest.mark.parametrize("name", ["", "nonsense", "se3", "loci", "estimate", "../direct", "solvers.direct", "os"])
def test_what_is_no_solver_is_refused(name):
    with pytest.raises(KeyError):
        solvers.solver(name)


@every_solver
def test_options_are_a_frozen_dataclass_with_a_docstring_under_each_field(name):
    solver.options_are_documented(name)


@every_solver
def test_solve_takes_a_problem_and_gives_an_estimate_of_its_name(name):
    solver.gives_an_estimate_of_its_name(name)


@every_solver
def test_the_estimate_agrees_with_itself_and_with_the_truth(name):
    solver.agrees_with_itself_and_with_the_truth(name)


@every_solver
def test_the_problem_is_not_modified(name):
    solver.modifies_nothing(name)


@every_solver
def test_the_same_problem_gives_the_same_bytes(name):
    solver.gives_the_same_bytes_again(name)


@every_solver
@given(seed=st.integers(0, 10_000), shift=VECTORS)
@settings(max_examples=8)
def test_moving_the_world_frame_moves_the_world_part_alone(name, seed, shift):
    invariance.moves_with_the_world_frame(name, seed, shift)


@every_solver
@given(seed=st.integers(0, 10_000), shift=VECTORS)
@settings(max_examples=8)
def test_moving_the_sensor_frame_moves_the_offset_with_it(name, seed, shift):
    invariance.moves_with_the_sensor_frame(name, seed, shift)


@every_solver
@given(seed=st.integers(0, 10_000))
@settings(max_examples=4)
def test_turning_the_sensor_frame_alone_changes_nothing_but_the_offsets_frame(name, seed):
    invariance.turns_with_the_sensor_frame(name, seed)


@every_solver
@given(factor=st.floats(0.5, 2.0))
@settings(max_examples=5)
def test_lengths_scale(name, factor):
    invariance.scales_with_lengths(name, factor)


@every_solver
@given(seed=st.integers(0, 10_000))
@settings(max_examples=5)
def test_the_order_of_the_poses_does_not_matter(name, seed):
    # the middle pose of a sweep, of which the order decides, may give a sign but no number
    invariance.does_not_depend_on_the_order(name, seed)


@every_solver
@given(seed=st.integers(0, 10_000))
@settings(max_examples=4)
def test_without_labels_the_order_changes_the_zeros_alone(name, seed):
    invariance.does_not_depend_on_the_order_without_labels(name, seed)


@every_solver
def test_what_is_random_has_a_seed(name):
    solver.has_a_seed_where_it_is_random(name)


@every_locus
def test_the_residual_of_a_locus_is_zero_at_the_truth(name):
    locus_contract.residual_is_zero_at_the_truth(name)


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
    locus_contract.basis_is_orthonormal_and_tangent(name)


@every_locus
def test_normalised_is_idempotent_and_modifies_nothing(name):
    locus_contract.normalised_is_idempotent_and_modifies_nothing(name)


@every_locus
def test_a_locus_is_found_by_name_and_can_be_a_key(name):
    locus_contract.can_be_a_key(name)
    with pytest.raises(KeyError):
        loci.locus(name + "x")


@every_locus
def test_a_locus_reports_names_and_derivatives_that_fit(name):
    locus_contract.reports_names_and_derivatives_that_fit(name)
