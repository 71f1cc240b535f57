"""The correlation time of noise whose own is known, and intervals that hold where the noise lasts."""

import numpy as np
import pytest
from scipy.signal import lfilter

from helpers.streamed import stream, truth_of
from solvers import direct, kinematic
from solvers.likelihood.correlation import Stretches, correlation_time
from solvers.verdict.assess import assess

N = 4000
ONE = Stretches(np.arange(N), np.zeros(N, dtype=int))
OFFSET = [f"offset_sensor_pivot_{axis}" for axis in "xyz"]


def ar(coefficient: float, seed: int) -> np.ndarray:
    return np.asarray(lfilter([1.0], [1.0, -coefficient], np.random.default_rng(seed).normal(size=(N, 3)), axis=0))


@pytest.mark.parametrize("coefficient", [0.5, 0.9])
def test_the_time_of_an_autoregression(coefficient):
    """T = (1 + a) / (1 - a), of which one series tells about 10% at 0.9: the mean of 10 within 3 of its own sigmas."""
    found = [correlation_time(ar(coefficient, seed), ONE) for seed in range(10)]
    assert np.mean(found) == pytest.approx((1 + coefficient) / (1 - coefficient), rel=0.1)


def test_white_noise_pays_nothing():
    """A false alarm has a probability of about 0.1%."""
    assert sum(correlation_time(ar(0.0, seed), ONE) > 1 for seed in range(100)) <= 2


def test_no_pairs_across_stretches():
    alternating = Stretches(np.arange(N), np.arange(N))
    assert correlation_time(ar(0.9, 0), alternating) == 1.0


def test_a_gap_in_time_ends_a_stretch():
    times = np.arange(10.0)
    times[5:] += 20
    found = Stretches.within([np.zeros(10, dtype=int)], times[::-1].copy())
    assert found.order.tolist() == [*range(9, -1, -1)]
    assert found.number.tolist() == [0] * 5 + [1] * 5


@pytest.mark.parametrize("solver", [kinematic, direct])
def test_intervals_hold_in_noise_that_lasts(solver):
    """Errors over sigma of three components of 6 runs: rms 1 within 4 / sqrt(2 * 18). `kinematic` has 3 over 20 seeds
    if the noise counts as white."""
    ratio = []
    for seed in range(6):
        given = stream(seed, ar=0.9)
        estimate = solver.solve(given)
        assert estimate.covariance is not None
        ratio.append((estimate.offset - truth_of(seed).offset) / estimate.covariance.sigma(*OFFSET))
    assert 0.4 < np.sqrt(np.mean(np.square(ratio))) < 1.67


def test_noise_that_lasts_is_no_move_of_the_sensor():
    """White noise assumed, 6 of the seeds 0 to 19 name one."""
    for seed in range(3):
        given = stream(seed, ar=0.97)
        assert assess(given, kinematic.solve(given)).refusal is None
