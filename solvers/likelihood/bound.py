"""The Cramér-Rao bound: how well any unbiased estimator can do on given poses and noise.

It needs no data, only the machine, the planned angles and what will be known of them, so it also
serves to plan an acquisition.
"""

from dataclasses import replace

from solvers.estimate import Covariance
from solvers.likelihood.covariance import active_unknowns, covariance_of, marginal_covariance
from solvers.likelihood.elimination import normal_equations
from solvers.likelihood.linearise import AngleModel
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus


def cramer_rao(
    torus: Torus,
    angles: Array,
    problem: Problem,
    sigma_t: float,
    sigma_r: float,
    fix_non_orthogonality: bool = False,
) -> Covariance:
    """The least covariance of every reported quantity, m and rad: the inverse of the marginal information
    at the true chain and ``angles`` (N, 2), every angle that ``problem`` does not label being a nuisance.

    The poses of ``problem`` are not looked at; its placements, held sweeps and labels are. ``sigma_t`` (m)
    and ``sigma_r`` (rad) are the noise an axis, above 0.
    """
    expected = _at(problem, torus, angles)
    at = normal_equations(torus, angles.T.copy(), expected, AngleModel.of(expected), (sigma_t, sigma_r))
    return covariance_of(torus, marginal_covariance(at.H, active_unknowns(expected, fix_non_orthogonality)))


def _at(problem: Problem, torus: Torus, angles: Array) -> Problem:
    """The problem with the poses that the chain predicts."""
    T = torus.poses(angles, problem.placement)
    return replace(problem, p_world_sensor=T[:, :3, 3], R_world_sensor=T[:, :3, :3])
