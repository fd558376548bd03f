"""Quantiles against printed tables and SciPy, intervals against the truth."""

import numpy as np
import pytest
from scipy import stats

from campaigns.interval_coverage import coverage
from sfr_loc_map.metrics.figures.details import column
from sfr_loc_map.metrics.statistics.intervals import (
    MAX_BLOCKS,
    chi2_interval95,
    chi2_quantile,
    group_moments,
    interval95,
    joined,
    resampled,
    scatter_of_difference,
    student_quantile,
)


def test_columns_are_rounded_and_undefined_where_not_finite() -> None:
    assert column(np.array([1.23456789012, np.nan, np.inf])) == (1.23456789, None, None)


def test_quantiles_are_those_of_printed_tables_and_of_the_library() -> None:
    """Abramowitz and Stegun, table 26.8."""
    assert chi2_quantile(0.95, 1) == pytest.approx(3.84146, abs=5e-6)
    for share in (0.025, 0.5, 0.975):
        for freedom in (1.0, 2.5, 300.0, 1e6):
            assert chi2_quantile(share, freedom) == stats.chi2.ppf(share, freedom)
            assert student_quantile(share, freedom) == stats.t.ppf(share, freedom)
    assert chi2_interval95(12, 4) == pytest.approx(stats.chi2.ppf([0.025, 0.975], 12) / 4)


def test_groups_hold_the_moments_of_consecutive_offsets() -> None:
    offsets = np.random.default_rng(3).normal(size=(11, 2))
    groups = group_moments(offsets, 4)
    assert groups.n.tolist() == [4, 4, 3]
    np.testing.assert_allclose(groups.mean[1], offsets[4:8].mean(axis=0))
    np.testing.assert_allclose(groups.squares[2], 3 * np.var(offsets[8:], axis=0))


@pytest.mark.parametrize("offset", [0.0, 1e3])
def test_joined_moments_are_those_of_all_values(offset: float) -> None:
    """Drawing a value again and again has no scatter, however far the value is from zero."""
    rng = np.random.default_rng(4)
    values = rng.normal(size=(12, 3)) + offset
    parts = group_moments(values, 1)
    found = joined(parts)
    np.testing.assert_allclose(found.mean, values.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(found.squares, 12 * np.var(values - offset, axis=0), rtol=1e-9)
    repeated = joined(parts.rows(np.full((1, 7), 5)))
    assert np.sqrt(repeated.squares).max() <= 1e-15 * max(offset, 10.0)


@pytest.mark.parametrize("shape", [(0,), (0, 3), (1,), (1, 3)])
def test_fewer_than_two_errors_have_no_interval(shape: tuple[int, ...]) -> None:
    assert interval95(np.zeros(shape), 1.0, unsigned=False) is None


def test_an_interval_needs_two_independent_sub_trajectories_and_shrinks_with_more() -> None:
    rng = np.random.default_rng(1)
    errors = rng.normal(0, 1, (40 * MAX_BLOCKS + 7, 3))
    assert interval95(errors[:10], 5.01, unsigned=False) is None
    widths = []
    for count in (10, 100, MAX_BLOCKS + 1, len(errors)):
        low, high = interval95(errors[:count], 5.0, unsigned=False)
        assert low < 3.0 * np.sqrt(3.0) * 1.05
        assert high > 3.0 * np.sqrt(3.0) * 0.95
        widths.append(high - low)
    assert widths == sorted(widths, reverse=True)
    assert interval95(np.full((9, 1), 2.0), 1.0, unsigned=False) == (2.0, 2.0), "nothing scatters"


def test_blocks_of_one_length_show_the_same_fraction_of_the_variance_whatever_their_groups() -> None:
    offsets = np.random.default_rng(6).normal(size=(64, 2))
    shares = [resampled(group_moments(offsets, size), np.zeros(2), 8.0, size)[2] for size in (1, 2, 4)]
    assert shares == pytest.approx([shares[0]] * 3, rel=1e-12)
    assert shares[0] < 1.0


def test_the_scatter_of_a_difference_from_a_constant_is_that_of_the_figure() -> None:
    """Blocks of one value show the complete variance, but for the mean of 40 values that it is taken about."""
    errors = np.random.default_rng(8).normal(size=(40, 1))
    mean = errors.mean(axis=0)
    figures = resampled(group_moments(errors - mean, 1), mean, 1.0)[1]
    found = scatter_of_difference(np.full((40, 1), 3.0), errors, 1.0, unsigned=False)
    assert found is not None
    assert found.sigma == pytest.approx(1.1 * np.std(figures) / np.sqrt(1.0 - 1.0 / 40.0), rel=1e-9)
    assert found.freedom == 39.0
    assert scatter_of_difference(errors[:3], errors[:3], 2.0, unsigned=False) is None


def test_the_scatter_of_overlapping_sums_is_not_underestimated() -> None:
    """Sums of ten unit steps at each of 30 starts, as good as three independent ones: 3 sigma is 3 sqrt(10)."""
    rng = np.random.default_rng(5)
    steps = rng.normal(0.0, 1.0, (400, 39, 1))
    sums = [np.convolve(each[:, 0], np.ones(10), "valid")[:, None] for each in steps]
    bounds = np.array([interval95(each, 10.0, unsigned=False) for each in sums])
    truth = 3.0 * np.sqrt(10.0)
    assert truth / 3.0 < np.median(bounds[:, 0]) < truth < np.median(bounds[:, 1])


@pytest.mark.slow
@pytest.mark.parametrize("law", ["white steps", "steps with memory"])
def test_overlapping_sub_trajectories_of_simulated_odometry(law: str) -> None:
    shares = coverage(40, 60.0, 10, law, curved=False, seed=7)
    assert 0.86 <= np.mean(list(shares.values())) <= 1.0
    assert min(shares.values()) >= 0.78
