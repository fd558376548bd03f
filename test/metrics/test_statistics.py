"""Statistics against numpy, quantiles against printed tables and SciPy, intervals against the truth."""

import numpy as np
import pytest
from interval_coverage import coverage
from scipy import stats

from sfr_loc_map.metrics.statistics import (
    add_moments,
    chi2_quantile,
    column,
    sample_statistic,
    statistic,
    student_quantile,
)


@pytest.mark.clause("4.1.3")
@pytest.mark.parametrize("offset", [0.0, 1e9])
def test_moments_are_those_of_numpy_however_large_the_mean(offset: float) -> None:
    values = np.random.default_rng(1).normal(0, 1, (1000, 3)) * [1, 2, 3] + offset
    mean, squares = np.zeros((2, 3))
    for begin, end in ((0, 1), (1, 700), (700, 1000)):
        add_moments(values[begin:end], begin, mean, squares)
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
    assert column(np.array([1.23456789012, np.nan, np.inf])) == (1.23456789, None, None)


def test_quantiles_are_those_of_printed_tables_and_of_the_library() -> None:
    """Abramowitz and Stegun, table 26.8."""
    assert chi2_quantile(0.95, 1) == pytest.approx(3.84146, abs=5e-6)
    for share in (0.025, 0.5, 0.975):
        for freedom in (1.0, 2.5, 300.0, 1e6):
            assert chi2_quantile(share, freedom) == stats.chi2.ppf(share, freedom)
            assert student_quantile(share, freedom) == stats.t.ppf(share, freedom)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["white steps", "steps with memory"])
def test_overlapping_sub_trajectories_of_simulated_odometry(law: str) -> None:
    shares = coverage(100, 60.0, 10, law, curved=False, seed=7)
    assert 0.88 <= np.mean(list(shares.values())) <= 1.0
    assert min(shares.values()) >= 0.82
