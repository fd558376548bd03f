"""Pooled errors are those of all values together; the interval holds the truth as often as it says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfr_loc_map.metrics.score import Statistic
from sfr_loc_map.suite.summary import pooled_statistic


def statistics(values: np.ndarray) -> tuple[Statistic, ...]:
    return tuple(
        Statistic(mean=float(column.mean()), sigma=float(column.std(ddof=1)), mean_plus_3sigma=None)
        for column in values.T
    )


@settings(max_examples=50)
@given(
    sizes=st.lists(st.integers(2, 9), min_size=1, max_size=6),
    axes=st.sampled_from([1, 3]),
    seed=st.integers(0, 2**32 - 1),
    offset=st.sampled_from([0.0, 5.0, -300.0]),
)
def test_pooled_is_the_statistic_of_all_values(sizes: list[int], axes: int, seed: int, offset: float) -> None:
    rng = np.random.default_rng(seed)
    drives = [rng.normal(rng.normal() + offset, rng.uniform(0.1, 3.0), (size, axes)) for size in sizes]
    found = pooled_statistic([(len(values), statistics(values)) for values in drives], [*map(str, range(len(drives)))])
    every = np.concatenate(drives)
    mean, sigma = np.linalg.norm(every.mean(axis=0)), np.linalg.norm(every.std(axis=0, ddof=1))
    assert found.mean == pytest.approx(mean, rel=1e-9, abs=1e-9)
    assert found.sigma == pytest.approx(sigma, rel=1e-9)
    assert found.mean_plus_3sigma == pytest.approx(mean + 3 * sigma, rel=1e-9)
    assert (found.mean_plus_3sigma_ci95 is None) == (len(sizes) < 5)
    repeated = pooled_statistic([(len(values), statistics(values)) for values in drives], ["one"] * len(drives))
    assert (repeated.mean, repeated.mean_plus_3sigma_ci95) == (found.mean, None)  # repeats of one drive
    of_one_value = (1, (Statistic(mean=1.0, sigma=None, mean_plus_3sigma=None),))
    assert pooled_statistic([of_one_value], ["a"]).mean is None


def test_the_interval_holds_the_true_figure_nine_times_in_ten_at_least() -> None:
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(200):
        drives = [rng.normal(0.0, 1.0, (30, 3)) * np.exp(rng.normal(0.0, 0.3)) for _ in range(15)]
        found = pooled_statistic([(30, statistics(values)) for values in drives], [*map(str, range(15))])
        assert found.mean_plus_3sigma_ci95 is not None
        low, high = found.mean_plus_3sigma_ci95
        held += low <= 3.0 * np.sqrt(3.0 * np.exp(2 * 0.3**2)) <= high
    assert held >= 180
