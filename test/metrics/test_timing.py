import numpy as np
import pytest

from sfr_loc_map.metrics.calls.timing import HOST_CLOCK, call_histogram, call_score


@pytest.mark.clause("4.2.1")
def test_figures_by_hand() -> None:
    got = call_score(np.array([5.0, 1.0, 2.0, 3.0, np.nan]), HOST_CLOCK)
    assert got.count == 4
    assert got.mean == pytest.approx(2.75)
    assert got.sigma == pytest.approx(np.sqrt(8.75 / 3))
    assert got.mean_plus_3sigma == pytest.approx(2.75 + 3 * np.sqrt(8.75 / 3))
    assert (got.p50, got.max, got.first, got.max_after_first) == (2.5, 5.0, 5.0, 3.0)
    assert got.clock == "host monotonic"


def test_none_and_one() -> None:
    assert call_score(np.empty(0), HOST_CLOCK).mean is None
    one = call_score(np.array([0.5]), HOST_CLOCK)
    assert (one.mean, one.sigma, one.mean_plus_3sigma, one.max_after_first) == (0.5, None, None, None)


def test_histogram_counts_every_call() -> None:
    times = np.random.default_rng(0).lognormal(-4, 1, 500)
    histogram = call_histogram(times)
    assert sum(histogram.counts) == 500
    assert len(histogram.edges_s) == len(histogram.counts) + 1
    assert sum(call_histogram(np.array([0.01])).counts) == 1
