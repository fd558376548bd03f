"""Quantiles of two distributions, as scipy.stats computes them, without its slow import: nodes must start quickly.

SciPy's special functions are imported when the first figure needs them.
"""

from __future__ import annotations


def chi2_quantile(share: float, freedom: float) -> float:
    """Return the value that a chi-squared variable stays below with this probability.

    Its distribution function is the regularised lower incomplete gamma function P(freedom / 2, x / 2)
    (Abramowitz and Stegun 26.4.19).
    """
    from scipy.special import gammaincinv

    return float(2.0 * gammaincinv(freedom / 2.0, share))


def student_quantile(share: float, freedom: float) -> float:
    """Return the value that a Student t variable stays below with this probability."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, share))


def student_share(value: float, freedom: float) -> float:
    """Return the probability with which a Student t variable stays below a value."""
    from scipy.special import stdtr

    return float(stdtr(freedom, value))
