"""Statistics against numpy, quantiles against printed tables and SciPy."""

import numpy as np
import pytest
from scipy import stats

from sfr_loc_map.metrics.statistics import (
    chi2_quantile,
    column,
    moments,
    norm,
    sample_statistic,
    statistic,
    student_quantile,
    student_share,
)


@pytest.mark.clause("4.1.3")
@pytest.mark.parametrize("offset", [0.0, 1e9])
def test_moments_are_those_of_numpy_however_large_the_mean(offset: float) -> None:
    values = np.random.default_rng(1).normal(0, 1, (1000, 3)) * [1, 2, 3] + offset
    mean, squares = moments(values)
    sigmas = (values - offset).std(axis=0, ddof=1)
    assert mean == pytest.approx(values.mean(axis=0), rel=1e-12)
    got = statistic(1000, mean, squares)
    assert got.mean == pytest.approx(np.linalg.norm(values.mean(axis=0)), rel=1e-12)
    assert got.sigma == pytest.approx(np.linalg.norm(sigmas), rel=1e-6 if offset else 1e-12)
    signed = statistic(1000, -mean[:1], squares[:1])
    assert signed.mean == -mean[0]
    assert signed.mean_plus_3sigma == pytest.approx(abs(mean[0]) + 3 * sigmas[0], rel=1e-6)


@pytest.mark.clause("4.1.3")
def test_sample_statistics_by_numpy() -> None:
    values = np.random.default_rng(4).lognormal(size=101)
    got = sample_statistic(values)
    assert (got.count, got.mean, got.sigma) == (101, np.mean(values), np.std(values, ddof=1))
    assert got.mean_plus_3sigma == pytest.approx(np.mean(values) + 3 * np.std(values, ddof=1))
    assert (got.p50, got.p95) == pytest.approx((np.median(values), np.percentile(values, 95)))


def test_norm_and_columns() -> None:
    assert norm(np.array([2.0, 3.0, 6.0])) == 7.0
    assert column(np.array([1.23456789012, np.nan, np.inf])) == (1.23456789, None, None)
    assert column(np.array([1.23456789012]), None) == (1.23456789012,)


def test_values_of_printed_tables() -> None:
    """Abramowitz and Stegun, tables 26.8 and 26.10."""
    assert chi2_quantile(0.95, 1) == pytest.approx(3.84146, abs=5e-6)
    assert chi2_quantile(0.975, 6) == pytest.approx(14.4494, abs=5e-5)
    assert student_quantile(0.975, 10) == pytest.approx(2.228, abs=5e-4)
    assert student_quantile(0.975, 1) == pytest.approx(12.706, abs=5e-4)


@pytest.mark.parametrize("share", [0.025, 0.5, 0.975])
@pytest.mark.parametrize("freedom", [1.0, 2.5, 300.0, 1e6])
def test_quantiles_are_those_of_the_library(share: float, freedom: float) -> None:
    assert chi2_quantile(share, freedom) == stats.chi2.ppf(share, freedom)
    assert student_quantile(share, freedom) == stats.t.ppf(share, freedom)
    assert student_share(student_quantile(share, freedom), freedom) == pytest.approx(share)
