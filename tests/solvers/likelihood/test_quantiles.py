"""The quantiles that stand in the source as numbers, against SciPy's."""

import numpy as np
from scipy.special import chdtri, ndtri

from solvers.kinematic import OUTLIER_BOUND, OUTLIER_PROBABILITY
from solvers.likelihood.covariance import NORMAL_95


def test_the_bound_of_an_outlier_is_the_quantile_of_chi_square():
    np.testing.assert_allclose(OUTLIER_BOUND, chdtri([6, 5, 4], OUTLIER_PROBABILITY), rtol=1e-15)


def test_the_half_width_is_the_quantile_of_the_normal():
    np.testing.assert_allclose(NORMAL_95, ndtri(0.975), rtol=1e-15)
