"""Limits against closed forms and against counting; rules by hand."""

import numpy as np
import pytest
from scipy import stats

from carm_kin.quality.control_chart import (
    ALERT_WITHIN,
    NOTE_WITHIN,
    Limits,
    Scatter,
    Values,
    judged,
    limits_of,
    scatter_of,
    scatters_more_than_stated,
    worst,
)

NONE = Scatter(np.zeros(1), 1.0)


def scalar(x: list[float], sigma: float, n: int) -> Values:
    return Values(np.array(x)[:, None], np.full((len(x), 1, 1), sigma**2), n)


def test_with_known_deviations_the_limits_are_two_and_three_of_them():
    limits = limits_of(scalar([0.0] * 6, 0.1, 4), NONE, None, 0.0)
    of_difference = 0.1 * np.sqrt(1 + 1 / 4)
    np.testing.assert_allclose(limits.note[4:], 2 * of_difference, rtol=1e-4)
    np.testing.assert_allclose(limits.alert[4:], 3 * of_difference, rtol=1e-4)
    np.testing.assert_allclose(limits.note[:4], 2 * 0.1 * np.sqrt(1 - 1 / 4), rtol=1e-4)


def test_fail_is_the_tolerance_or_the_alert_but_not_below_the_least():
    given = scalar([0.0, 0.0], 0.1, 1)
    assert limits_of(given, NONE, 0.2, 5.0).fail == pytest.approx(0.2)
    free = limits_of(given, NONE, None, 0.25)
    assert free.fail[1] == free.alert[1] == pytest.approx(3 * 0.1 * np.sqrt(2), rel=1e-4)
    assert limits_of(given, NONE, None, 5.0).fail == pytest.approx(5.0)


def test_scatter_by_hand():
    found = scatter_of(scalar([1.0, 3.0, 2.0, 2.0, 9.0], 0.5, 4))
    assert found.variances == pytest.approx([(4 + 1 + 0) / 3 / 2 - 0.25])
    assert found.dof == pytest.approx(2 * 9 / 8)
    assert scatter_of(scalar([1.0, 1.1, 9.0], 0.5, 2)).variances == 0.0
    assert scatter_of(scalar([1.0, 9.0], 0.5, 1)).variances == 0.0


def test_where_scatter_alone_counts_the_limits_are_students():
    scatter = Scatter(np.array([0.04]), 6.0)
    limits = limits_of(scalar([0.0] * 9, 1e-9, 8), scatter, None, 0.0)
    for found, p in ((limits.note[8], NOTE_WITHIN), (limits.alert[8], ALERT_WITHIN)):
        assert found == pytest.approx(stats.t.isf((1 - p) / 2, 6.0) * 0.2 * np.sqrt(1 + 1 / 8), rel=1e-6)


@pytest.mark.parametrize("sigma", [(1.0, 1.0, 1.0), (1.0, 1.0, 0.3), (3.0, 0.2, 0.1)])
def test_a_distance_is_beyond_its_limits_as_often_as_a_number(sigma):
    rng, n = np.random.default_rng(1), 4
    covariance = np.diag(np.square(sigma))
    limits = limits_of(Values(np.zeros((5, 3)), np.tile(covariance, (5, 1, 1)), n), Scatter(np.zeros(3), 1.0), None, 0)
    x = rng.normal(size=(100_000, 5, 3)) * sigma
    distance = np.linalg.norm(x[:, 4] - x[:, :4].mean(axis=1), axis=1)
    assert np.mean(distance > limits.note[4]) == pytest.approx(1 - NOTE_WITHIN, rel=0.15)
    assert np.mean(distance > limits.alert[4]) == pytest.approx(1 - ALERT_WITHIN, abs=0.002)


@pytest.mark.parametrize("n, scatter", [(5, 0.0), (10, 0.0), (10, 0.5), (10, 4.0)])
def test_false_alarms_are_rare_whether_results_scatter_or_not(n, scatter):
    """The stated deviation is 1, what results differ by is sqrt(1 + scatter^2)."""
    rng, runs = np.random.default_rng(2), 1500
    beyond = np.zeros(2)
    for _ in range(runs):
        given = scalar([*rng.normal(size=n + 1) * np.hypot(1, scatter)], 1.0, n)
        limits, change = limits_of(given, scatter_of(given), None, 0.0), abs(given.values[n, 0] - given.reference[0])
        beyond += change > limits.note[n], change > limits.alert[n]
    assert 0.02 < beyond[0] / runs < 0.075
    assert beyond[1] / runs < 0.012


LIMITS = Limits(*(np.full(8, limit) for limit in (2.0, 3.0, 5.0)))
RULES = {
    "within": ([0, 0, 1, -1.9, 1.9], "pass pass pass"),
    "one beyond each": ([0, 0, 2.5, 0, 0, 3.5, 0, -5.5], "note pass pass alert pass fail"),
    "two of three on one side": ([0, 0, 2.5, 0, 2.5], "note pass alert"),
    "in a row": ([0, 0, -2.1, -2.1, 0], "note alert pass"),
    "two of four": ([0, 0, 2.5, 0, 0, 2.5], "note pass pass note"),
    "on both sides": ([0, 0, 2.5, -2.5], "note note"),
    "the baseline has no part in it": ([2.5, 2.5, 2.5], "note"),
    "at the limit": ([0, 0, 2.0, 3.0, 5.0], "pass note alert"),
}


@pytest.mark.parametrize("case", RULES)
def test_rules(case):
    change, expected = RULES[case]
    limits = Limits(*(limit[: len(change)] for limit in (LIMITS.note, LIMITS.alert, LIMITS.fail)))
    assert judged(np.array(change, dtype=float), limits, 2) == ("baseline", "baseline", *expected.split())


def test_the_worst_counts():
    assert worst(["pass", "alert", "note"]) == "alert"
    assert worst(["baseline", "baseline"]) == "baseline"


def test_a_baseline_that_scatters_is_told_from_one_that_does_not():
    rng = np.random.default_rng(3)
    sound = [scatters_more_than_stated(scalar([*rng.normal(size=6)], 1.0, 5)) for _ in range(1000)]
    wild = [scatters_more_than_stated(scalar([*rng.normal(size=6) * 5], 1.0, 5)) for _ in range(200)]
    assert np.mean(sound) < 0.01
    assert np.mean(wild) > 0.9
    assert not scatters_more_than_stated(scalar([1.0, 50.0], 1.0, 1))
