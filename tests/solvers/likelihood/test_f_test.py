"""The F-test's probability, against SciPy's."""

import numpy as np
import pytest
from scipy.special import fdtrc

from solvers.likelihood.f_test import f_tail


@pytest.mark.parametrize("denominator", [1, 2, 7, 60, 1000, 40_000, 4_000_000])
@pytest.mark.parametrize("numerator", [1, 2, 3, 5, 6, 18, 36])
def test_the_tail_is_scipys(numerator, denominator):
    for F in np.geomspace(1e-3, 1e2, 26):
        expected = fdtrc(numerator, denominator, F)
        assert f_tail(numerator, denominator, F) == pytest.approx(expected, rel=1e-7, abs=1e-200)


def test_no_ratio_at_all_is_certain_and_an_infinite_one_impossible():
    assert f_tail(6, 100, 0.0) == f_tail(6, 100, -1.0) == 1.0
    assert f_tail(6, 100, float("inf")) == 0.0
