"""The contract of a locus, each check a function of its name; an AssertionError says what is broken."""

from typing import Any

import casadi as ca
import numpy as np

from carm_kin.testing.truth import machine, problem, sweeps_deg
from solvers import direct, loci
from solvers.problem import Problem
from solvers.se3 import Array

LEVER = 0.7
"""m."""


def check_locus(name: str) -> None:
    """Every check below. Raises AssertionError for a broken promise, KeyError where no locus has that name."""
    for check in (
        can_be_a_key,
        residual_is_zero_at_the_truth,
        basis_is_orthonormal_and_tangent,
        normalised_is_idempotent_and_modifies_nothing,
        reports_names_and_derivatives_that_fit,
    ):
        check(name)


def can_be_a_key(name: str) -> None:
    """Two of a kind are equal and have the same hash: a compiled function is kept for each."""
    assert hash(loci.locus(name)) == hash(loci.locus(name)), "two equal loci have different hashes"
    assert loci.locus(name) == loci.locus(name), "two loci of one kind differ"


def residual_is_zero_at_the_truth(name: str) -> None:
    """At the theta that exact poses with a pivot that stands still give, and nowhere near it."""
    chosen, data, theta = at_the_truth(name)
    symbols = ca.SX.sym("theta", chosen.size), ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3), ca.SX.sym("lever")
    residual = ca.Function("residual", list(symbols), [chosen.residual(*symbols)])
    for k in range(0, len(data), 10):
        left = np.abs(residual(theta[0], data.rotations[k], data.p_world_sensor[k], LEVER).full()).max()
        assert left < 1e-6, f"the residual of an exact pose is {left:.3g} m"
    off = theta[0] + 0.01 * np.random.default_rng(0).normal(size=chosen.size)
    left = np.abs(residual(off, data.rotations[0], data.p_world_sensor[0], LEVER).full()).max()
    assert left > 1e-3, "the residual hardly grows where theta is wrong"


def basis_is_orthonormal_and_tangent(name: str) -> None:
    """And its columns that move the placement's own entries come first."""
    chosen, _, theta = at_the_truth(name)
    basis = chosen.basis(theta[0])
    k = basis.shape[1]
    assert basis.shape == (chosen.size, k), f"the basis has {len(basis)} rows, not {chosen.size}"
    np.testing.assert_allclose(basis.T @ basis, np.eye(k), atol=1e-12, err_msg="the basis is not orthonormal")
    for step in 1e-4 * np.eye(k):
        moved = theta[0] + basis @ step
        # tangent to what `normalised` keeps: to come back costs but the square of the step
        np.testing.assert_allclose(chosen.normalised(moved), moved, atol=1e-7, err_msg="the basis is not tangent")
    moves_own = np.any(basis[: chosen.own] != 0, axis=0)
    assert not (np.diff(moves_own.astype(int)) > 0).any(), "columns of the placement's own entries come first"
    both = moves_own & np.any(basis[chosen.own :] != 0, axis=0)
    assert not both.any(), "a column moves entries of the placement and shared ones"


def normalised_is_idempotent_and_modifies_nothing(name: str) -> None:
    """And the start has the shape of theta."""
    chosen, data, theta = at_the_truth(name)
    np.testing.assert_allclose(chosen.normalised(theta), theta, atol=1e-12, err_msg="the answer is not normalised")
    given = theta * 1.7
    before = given.copy()
    once = chosen.normalised(given)
    np.testing.assert_array_equal(given, before, "normalised modifies what it is given")
    np.testing.assert_allclose(chosen.normalised(once), once, atol=1e-15, err_msg="normalised is not idempotent")
    assert chosen.start(data).shape == theta.shape, "the start has not the shape (P, size)"


def reports_names_and_derivatives_that_fit(name: str) -> None:
    """One row a name, one column an unknown."""
    chosen, _, theta = at_the_truth(name)
    names, J = chosen.reported(theta)
    assert J.shape == (len(names), chosen.basis(theta[0]).shape[1]), "the derivative has another shape"
    assert len(set(names)) == len(names), "a name is reported twice"


def at_the_truth(name: str) -> tuple[loci.Locus, Problem, Array]:
    """The locus, exact poses whose pivot stands still, so that every locus has it, and theta (1, size) as found there.

    R = 0 and perpendicular axes make the pivot stand still.
    """
    turn = range(0, 360, 24)
    chosen, data = loci.locus(name), problem(machine(3, 0.0), sweeps_deg((-60, 0, 35, 80), turn, (0, 40, 75), turn))
    spy: Any = _Spy(chosen)
    estimate = direct.minimise(data, spy, chosen.start(data), LEVER, 100)
    assert estimate.residual is not None, "the estimate has lost the residuals that it was given"
    return chosen, data, spy.theta


class _Spy:
    """The locus, with a note of the theta of which it is asked for an estimate."""

    def __init__(self, chosen: loci.Locus):
        self._chosen = chosen

    def __getattr__(self, attribute):
        return getattr(self._chosen, attribute)

    def estimate(self, theta, *args, **more):
        self.theta = np.array(theta)
        return self._chosen.estimate(theta, *args, **more)

    def __hash__(self):
        return hash(self._chosen)
