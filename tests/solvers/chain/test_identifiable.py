"""Which parameters of a chain the poses determine: hand-made columns, and the counts of the theory."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.machines import (
    drawn,
    everything,
    free,
    hand_made,
    observed,
    without,
)
from solvers.chain.chain import solve_chain
from solvers.chain.identifiable import identifiable


def test_dependent_columns_are_named():
    rng = np.random.default_rng(3)
    J = rng.normal(size=(40, 6))
    J[:, 4] = 2 * J[:, 0] - 3 * J[:, 2]
    J[:, 5] = 0
    found = identifiable(J, np.linalg.norm(J, axis=0), [np.arange(4), np.array([4, 5])])
    assert found.active.tolist() == [True] * 4 + [False] * 2
    first, second = found.dependent
    assert (first.unknown, sorted(first.others)) == (4, [0, 2])
    assert dict(zip(first.others, first.coefficients, strict=True)) == pytest.approx({0: 2, 2: -3})
    assert (second.unknown, len(second.others)) == (5, 0)


def test_earlier_stages_are_preferred():
    rng = np.random.default_rng(4)
    J = rng.normal(size=(30, 3))
    J = np.column_stack([J, J @ [1, 1, 1]])
    for preferred in range(4):
        rest = np.delete(np.arange(4), preferred)
        found = identifiable(J, np.linalg.norm(J, axis=0), [np.array([preferred]), rest])
        assert found.active[preferred]
        assert found.active.sum() == 3


def test_a_weak_column_is_active():
    """What is weak is told all the same; how well, the covariance says."""
    J = np.random.default_rng(5).normal(size=(30, 2)) * [1, 1e-5]
    assert identifiable(J, np.ones(2), [np.arange(2)]).active.all()


def test_a_column_that_the_values_explain_is_not_active():
    """Its length after the elimination of the values is nothing next to that before."""
    J = np.random.default_rng(5).normal(size=(30, 2)) * [1, 1e-9]
    found = identifiable(J, np.ones(2), [np.arange(2)])
    assert found.active.tolist() == [True, False]


COUNTS = {"r": 4, "p": 2}
"""Identifiable parameters a joint; 6 more place the end: Everett and Hsu, The theory of kinematic parameter
identification for industrial robots, J. Dyn. Sys. Meas. Control 110 (1988)."""


@pytest.mark.parametrize("kinds", ["rr", "rp", "pr", "rrr", "prr", "rpr", "rrrrrr", "prprr"])
def test_count_of_identifiable_parameters(kinds):
    machine = hand_made(kinds, seed=len(kinds))
    values = drawn(machine, 40)
    found = solve_chain(observed(machine, values), machine, values, everything(machine))
    assert found.active.sum() == sum(COUNTS[kind] for kind in kinds) + 6
    assert len(found.dependent) == 12 + 6 * len(kinds) - found.active.sum()


def test_parallel_axes_have_as_many():
    """Right perturbations of the placements have no singularity where axes are parallel."""
    machine = hand_made("rrr")
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, :3, 3] = [[0.1, 0.2, 0], [0.3, 0, 0.1], [0, 0.4, 0.2]]
    machine = replace(machine, axes=np.array([[0.0, 0, 1], [0, 0, 1], [1, 0, 0]]), placements=T)
    values = drawn(machine, 40)
    assert solve_chain(observed(machine, values), machine, values, everything(machine)).active.sum() == 18


@pytest.mark.parametrize("unlabelled, count", [((), 14), ((0,), 13), ((1,), 13), ((0, 1), 12)])
def test_two_axes_have_14_unknowns_less_one_for_every_joint_without_a_zero(unlabelled, count):
    machine = hand_made("rr")
    values = drawn(machine, 30)
    problem = observed(machine, values)
    for j in unlabelled:
        problem = without(problem, j)
    assert solve_chain(problem, machine, values, everything(machine)).active.sum() == count


def test_gains_and_zeros_beside_placements():
    """A zero is a turn of the placement about its axis, so it adds nothing; a gain does."""
    machine = hand_made("rrr")
    values = drawn(machine, 40)
    problem = observed(machine, values)
    found = solve_chain(problem, machine, values, free(machine, range(3), range(3), range(3)))
    assert found.active.sum() == 18 + 3
    layout = found.layout
    assert found.active[[layout.gain(j) for j in range(3)]].all()
    zeros_alone = solve_chain(problem, machine, values, free(machine, (), range(3)))
    assert zeros_alone.active.sum() == 12 + 1  # those of the outer joints turn with the base and the mount
