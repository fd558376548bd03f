"""Statistics of endless series against numpy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfr_loc_map.metrics.statistics.running_statistics import (
    Decimated,
    Moments,
    RowQueue,
    column,
    norm,
    sample_statistic,
)


@pytest.mark.parametrize("offset", [0.0, 1e9])
def test_moments_are_those_of_numpy_however_large_the_mean(offset: float) -> None:
    values = np.random.default_rng(1).normal(0, 1, (1000, 3)) * [1, 2, 3] + offset
    moments = Moments(3)
    moments.push(values)
    assert moments.count == 1000
    assert moments.mean == pytest.approx(values.mean(axis=0), rel=1e-12)
    assert moments.sigma == pytest.approx((values - offset).std(axis=0, ddof=1), rel=1e-6 if offset else 1e-12)


@settings(max_examples=30)
@given(st.lists(st.integers(0, 40), max_size=10))
def test_portions_do_not_change_a_bit(portions: list[int]) -> None:
    values = np.random.default_rng(2).normal(5, 1, (sum(portions), 2))
    whole, parts = Moments(2), Moments(2)
    thinned, thinned_parts = Decimated(2, 16), Decimated(2, 16)
    whole.push(values)
    thinned.push(values)
    at = 0
    for size in portions:
        parts.push(values[at : at + size])
        thinned_parts.push(values[at : at + size])
        at += size
    assert np.array_equal(whole.mean, parts.mean)
    assert (whole.sigma is None) == (sum(portions) < 2)
    assert whole.sigma is None or np.array_equal(whole.sigma, parts.sigma)
    assert np.array_equal(thinned.rows, thinned_parts.rows)
    assert np.array_equal(thinned.rows, values[:: thinned.step])
    assert len(thinned.rows) <= 16


def test_a_queue_gives_back_what_was_put_in() -> None:
    queue, kept, rng = RowQueue(), np.empty((0, 2)), np.random.default_rng(3)
    for _ in range(200):
        rows = rng.normal(size=(rng.integers(0, 30), 2))
        queue.append(value=rows, number=np.arange(len(rows)))
        kept = np.concatenate((kept, rows))
        count = int(rng.integers(0, len(kept) + 1))
        queue.drop(count)
        kept = kept[count:]
        assert np.array_equal(queue["value"], kept)
        assert len(queue) == len(kept)


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
