"""Variance components against the dense formulas, finite differences and data of known variances."""

import numpy as np
import pytest

from solvers.effects.rows import Rows
from solvers.effects.variance import Mixed, most_likely

GROUPS = np.repeat([0, 1, 2], (3, 4, 2))
KINDS = 2
BLOCKS = 40


def rows(seed: int, variance=(0.5, 2.0, 0.0), noise=(1.0, 3.0), rho=(0.0, 0.0), blocks=BLOCKS):
    """[U Z y] (6, 4 + 9 + 1, B) of a model with these variances, in two stretches, noise of an AR(1)."""
    rng = np.random.default_rng(seed)
    F = rng.normal(size=(6, 14, blocks))
    e = rng.normal(size=(6, blocks))
    for k in range(1, blocks):
        if k != blocks // 2:
            r = np.repeat(rho, 3)
            e[:, k] = r * e[:, k - 1] + np.sqrt(1 - r**2) * e[:, k]
    c = rng.normal(size=9) * np.sqrt(np.array(variance)[GROUPS])
    F[:, 13] = np.einsum("rxb,x->rb", F[:, :4], rng.normal(size=4)) + np.einsum("rcb,c->rb", F[:, 4:13], c)
    F[:, 13] += np.sqrt(np.repeat(noise, 3))[:, None] * e
    return F, (np.arange(blocks) >= blocks // 2).astype(int)


def rows_of(F, stretch) -> Rows:
    size = F.shape[1]
    count = np.full(KINDS, 3.0 * F.shape[2])
    model = Mixed(np.zeros((KINDS, size, size)), np.zeros((size, size)), count, 4, GROUPS, np.zeros(3), np.ones(KINDS))
    return Rows.of(F, stretch, model)


def model_of(F, variance, noise) -> Mixed:
    return rows_of(F, np.zeros(F.shape[2], dtype=int)).model.at(np.array(variance), np.array(noise))


def dense(F, variance, noise, rho=(0.0, 0.0)):
    """U, y and V of all rows, kind by kind and row by row, blocks one after the other."""
    blocks = F.shape[2]
    stacked = F.transpose(0, 2, 1).reshape(-1, F.shape[1])
    U, Z, y = stacked[:, :4], stacked[:, 4:13], stacked[:, 13]
    steps = np.abs(np.subtract.outer(np.arange(blocks), np.arange(blocks)))
    half = np.arange(blocks) >= blocks // 2
    together = half[:, None] == half
    V = Z @ np.diag(np.array(variance)[GROUPS]) @ Z.T
    for row in range(6):
        here = slice(row * blocks, (row + 1) * blocks)
        r = rho[row // 3]
        V[here, here] += noise[row // 3] * np.where(together, float(r) ** steps if r else np.eye(blocks), 0.0)
    return U, y, V


def likelihood(U, y, V) -> float:
    W = np.linalg.inv(V)
    H = U.T @ W @ U
    P = W - W @ U @ np.linalg.solve(H, U.T @ W)
    return -0.5 * (np.linalg.slogdet(V)[1] + np.linalg.slogdet(H)[1] + y @ P @ y)


AT = [((0.5, 2.0, 0.3), (1.0, 3.0)), ((2.0, 0.1, 0.0), (0.4, 5.0))]


@pytest.mark.parametrize("variance, noise", AT)
def test_the_likelihood_is_the_restricted_one(variance, noise):
    F, _ = rows(1)
    first, second = (
        model_of(F, v, d).log_likelihood - likelihood(*dense(F, v, d)) for v, d in ((variance, noise), AT[0])
    )
    assert first == pytest.approx(second, abs=1e-6)  # the constants are left out


@pytest.mark.parametrize("variance, noise", AT)
def test_the_solution_is_that_of_generalised_least_squares(variance, noise):
    F, _ = rows(2)
    U, y, V = dense(F, variance, noise)
    W = np.linalg.inv(V)
    covariance = np.linalg.inv(U.T @ W @ U)
    model = model_of(F, variance, noise)
    np.testing.assert_allclose(model.solution, covariance @ U.T @ W @ y, rtol=1e-6)
    np.testing.assert_allclose(model.covariance[:4, :4], covariance, rtol=1e-6)
    Z = F.transpose(0, 2, 1).reshape(-1, 14)[:, 4:13]
    predicted = np.array(variance)[GROUPS] * (Z.T @ W @ (y - U @ model.solution))
    np.testing.assert_allclose(model.coefficients, predicted, atol=1e-9)


@pytest.mark.parametrize("variance, noise", AT)
def test_the_gradient(variance, noise):
    F, _ = rows(3)
    model = model_of(F, variance, noise)
    h = 1e-4
    for k in range(5):
        by = np.exp(h * (np.arange(5) == k))
        there, back = (likelihood(*dense(F, np.array(variance) * s[:3], np.array(noise) * s[3:])) for s in (by, 1 / by))
        assert model.gradient[k] == pytest.approx((there - back) / (2 * h), abs=1e-5)


def test_the_average_information():
    (variance, noise), (F, _) = AT[0], rows(4)
    U, y, V = dense(F, variance, noise)
    W = np.linalg.inv(V)
    P = W - W @ U @ np.linalg.solve(U.T @ W @ U, U.T @ W)
    Z = F.transpose(0, 2, 1).reshape(-1, 14)[:, 4:13]
    by = [variance[g] * Z[:, g == GROUPS] @ Z[:, g == GROUPS].T for g in range(3)]
    kind = np.repeat([0, 1], 3 * BLOCKS)
    by += [noise[k] * np.diag((kind == k).astype(float)) for k in range(2)]
    expected = [[0.5 * y @ P @ a @ P @ b @ P @ y for b in by] for a in by]
    np.testing.assert_allclose(model_of(F, variance, noise).average_information, expected, rtol=1e-6)


def test_the_slope_from_nothing():
    F, _ = rows(5)
    score, information = model_of(F, (0.5, 0.0, 0.0), (1.0, 3.0)).from_nothing()
    h = 1e-6
    for g in (1, 2):
        some = np.array([0.5, 0.0, 0.0]) + h * (np.arange(3) == g)
        slope = (likelihood(*dense(F, some, (1.0, 3.0))) - likelihood(*dense(F, (0.5, 0.0, 0.0), (1.0, 3.0)))) / h
        assert score[g] == pytest.approx(slope, rel=1e-2)
    assert score[0] == 0
    assert (information > 0).all()


def test_the_most_likely_variances():
    """The gradient is 0 there, or the variance; over 40 data sets the means are right within 3 standard errors."""
    found = []
    for seed in range(40):
        F, _ = rows(seed, blocks=60)
        fit = most_likely(model_of(F, (1.0, 1.0, 1.0), (1.0, 1.0)))
        live = np.concatenate([fit.variance > 0, [True, True]])
        assert np.abs(fit.gradient[live]).max() < 0.2
        found.append(np.concatenate([fit.variance, fit.noise]))
    mean, error = np.mean(found, axis=0), np.std(found, axis=0) / np.sqrt(40)
    assert (np.abs(mean - (0.5, 2.0, 0.0, 1.0, 3.0))[[0, 1, 3, 4]] < 3 * error[[0, 1, 3, 4]]).all()
    assert mean[2] < 0.01  # half of the sets have none


@pytest.mark.parametrize("rho", [(0.7, 0.0), (0.3, 0.9)])
def test_noise_that_lasts(rho):
    F, stretch = rows(6, rho=rho)
    lasting = rows_of(F, stretch)
    pairs = []
    for variance, noise in AT:
        at = lasting.model.at(np.array(variance), np.array(noise))
        whitened = lasting.whitened(np.array(rho), at)
        U, y, V = dense(F, variance, noise, rho)
        pairs.append(whitened.log_likelihood - likelihood(U, y, V))
        W = np.linalg.inv(V)
        np.testing.assert_allclose(whitened.solution, np.linalg.solve(U.T @ W @ U, U.T @ W @ y), rtol=1e-6)
    assert pairs[0] == pytest.approx(pairs[1], abs=1e-6)


def test_another_correlation_is_comparable():
    F, stretch = rows(7, rho=(0.6, 0.6))
    lasting = rows_of(F, stretch)
    at = lasting.model.at(*map(np.array, AT[0]))
    for rho in ((0.6, 0.6), (0.2, 0.8)):
        off = lasting.whitened(np.array(rho), at).log_likelihood - at.log_likelihood
        assert off == pytest.approx(likelihood(*dense(F, *AT[0], rho)) - likelihood(*dense(F, *AT[0])), abs=1e-6)


def test_the_correlation_is_found():
    F, stretch = rows(8, rho=(0.8, 0.0), blocks=300)
    lasting = rows_of(F, stretch)
    fit = most_likely(lasting.model.at(np.ones(3), np.ones(2)))
    assert lasting.correlation(fit) == pytest.approx((0.8, 0.0), abs=0.08)  # 3 of its standard errors
