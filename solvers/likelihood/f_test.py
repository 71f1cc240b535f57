"""The F-test's probability by a continued fraction: SciPy has it, too, but takes longer to import than a fit takes."""

from math import exp, inf, lgamma, log1p

SMALLEST = 1e-300
"""Stands for 0 where the fraction divides by it."""
ACCURACY = 1e-15
"""Relative change of the fraction at which it ends."""
MOST_TERMS = 10_000


def f_tail(numerator: float, denominator: float, F: float) -> float:
    """The probability that noise alone makes a ratio of variances above ``F``, by the degrees of freedom of both.

    The incomplete beta function I_x(a, b) with a = denominator / 2, b = numerator / 2, x = 2 a / (2 a + 2 b F)
    (DLMF 8.17.22); relative error below 1e-8 up to a million degrees of freedom.
    """
    if not F > 0:
        return 1.0
    if inf == F:
        return 0.0
    a, b = denominator / 2, numerator / 2
    part = b * F / a
    log_x, log_rest = -log1p(part), -log1p(1 / part)
    front = exp(lgamma(a + b) - lgamma(a) - lgamma(b) + a * log_x + b * log_rest)
    x = 1 / (1 + part)
    if x < (a + 1) / (a + b + 2):
        return front * _fraction(a, b, x) / a
    return 1 - front * _fraction(b, a, part / (1 + part)) / b


def _fraction(a: float, b: float, x: float) -> float:
    """The continued fraction of the incomplete beta function, by Lentz's method."""
    d = 1 / _not_zero(1 - (a + b) * x / (a + 1))
    c, found = 1.0, d
    for m in range(1, MOST_TERMS):
        even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        for term in (even, odd):
            d = 1 / _not_zero(1 + term * d)
            c = _not_zero(1 + term / c)
            found *= c * d
        if abs(c * d - 1) < ACCURACY:
            break
    return found


def _not_zero(value: float) -> float:
    return value if abs(value) > SMALLEST else SMALLEST
