"""Intervals hold the true value about as often as they say."""

import numpy as np
import pytest
from interval_coverage import coverage

from sfr_loc_map.metrics.trajectory.confidence import MAX_BLOCKS, BlockSums, interval95


def series(values: np.ndarray) -> BlockSums:
    blocks = BlockSums(values.shape[1])
    blocks.push(values)
    return blocks


def test_sums_do_not_depend_on_the_portions_and_stay_few() -> None:
    values = np.random.default_rng(1).normal(0, 1, (5000, 2))
    whole, parts = series(values), BlockSums(2)
    for first in range(0, 5000, 333):
        parts.push(values[first : first + 333])
    assert np.array_equal(whole.rows, parts.rows)
    assert len(whole.rows) <= MAX_BLOCKS
    assert whole.rows[:, 0].sum() == 5000
    assert whole.rows[:, 1:3].sum(axis=0) == pytest.approx(values.sum(axis=0))
    assert whole.rows[:, 3:].sum(axis=0) == pytest.approx(np.square(values).sum(axis=0))


def test_independent_values() -> None:
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(300):
        interval = interval95(series(rng.normal(2.0, 1.0, (60, 1))), slice(0, 1), 1.0, unsigned=False)
        assert interval is not None
        held += interval[0] <= 5.0 <= interval[1]
    assert 0.90 <= held / 300 <= 0.99


def test_long_series_have_narrow_intervals() -> None:
    values = np.random.default_rng(3).normal(2.0, 1.0, (100_000, 1))
    interval = interval95(series(values), slice(0, 1), 1.0, unsigned=False)
    assert interval is not None
    assert 4.95 < interval[0] < 5.0 < interval[1] < 5.05


def test_too_few_and_perfect() -> None:
    assert interval95(series(np.ones((1, 1))), slice(0, 1), 1.0, unsigned=False) is None
    assert interval95(series(np.random.default_rng(4).normal(0, 1, (9, 1))), slice(0, 1), 5.0, unsigned=False) is None
    assert interval95(series(np.zeros((9, 3))), slice(0, 3), 1.0, unsigned=False) == (0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["white steps", "steps with memory"])
def test_overlapping_sub_trajectories_of_simulated_odometry(law: str) -> None:
    shares = coverage(100, 60.0, 10, law, curved=False, seed=7)
    assert 0.88 <= np.mean(list(shares.values())) <= 1.0
    assert min(shares.values()) >= 0.82
