import numpy as np
import pytest

from sfr_loc_map.metrics.timing import timing_histogram, timing_summary


def test_figures_by_hand() -> None:
    got = timing_summary(np.array([5.0, 1.0, 2.0, 3.0, np.nan]))
    assert got["count"] == 4
    assert got["mean"] == pytest.approx(2.75)
    assert got["sigma"] == pytest.approx(np.sqrt(8.75 / 3))
    assert got["mean_plus_3sigma"] == pytest.approx(2.75 + 3 * np.sqrt(8.75 / 3))
    assert (got["p50"], got["max"], got["first"], got["max_after_first"]) == (2.5, 5.0, 5.0, 3.0)
    assert got["clock"] == "host monotonic"


def test_none_and_one() -> None:
    assert timing_summary(np.empty(0))["mean"] is None
    one = timing_summary(np.array([0.5]))
    assert (one["mean"], one["sigma"], one["mean_plus_3sigma"], one["max_after_first"]) == (0.5, None, None, None)


def test_histogram_counts_every_call() -> None:
    times = np.random.default_rng(0).lognormal(-4, 1, 500)
    histogram = timing_histogram(times)
    assert sum(histogram["counts"]) == 500
    assert len(histogram["edges_s"]) == len(histogram["counts"]) + 1
    assert sum(timing_histogram(np.array([0.01]))["counts"]) == 1
