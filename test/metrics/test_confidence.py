"""Intervals hold the true value about as often as they say."""

import numpy as np
import pytest
from interval_coverage import coverage

from sfr_loc_map.metrics.statistics import MAX_BLOCKS, block_sums, interval95


def test_sums_of_stretches_stay_few() -> None:
    values = np.random.default_rng(1).normal(0, 1, (5000, 2))
    rows, size = block_sums(values)
    assert len(rows) <= MAX_BLOCKS
    assert (rows[:-1, 0] == size).all()
    assert rows[:, 0].sum() == 5000
    assert rows[:, 1:3].sum(axis=0) == pytest.approx(values.sum(axis=0))
    assert rows[:, 3:].sum(axis=0) == pytest.approx(np.square(values).sum(axis=0))


def test_independent_values() -> None:
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(300):
        interval = interval95(block_sums(rng.normal(2.0, 1.0, (60, 1))), slice(0, 1), 1.0, unsigned=False)
        assert interval is not None
        held += interval[0] <= 5.0 <= interval[1]
    assert 0.90 <= held / 300 <= 0.99


def test_long_series_have_narrow_intervals() -> None:
    values = np.random.default_rng(3).normal(2.0, 1.0, (100_000, 1))
    interval = interval95(block_sums(values), slice(0, 1), 1.0, unsigned=False)
    assert interval is not None
    assert 4.95 < interval[0] < 5.0 < interval[1] < 5.05


def test_too_few_and_perfect() -> None:
    assert interval95(block_sums(np.ones((1, 1))), slice(0, 1), 1.0, unsigned=False) is None
    assert (
        interval95(block_sums(np.random.default_rng(4).normal(0, 1, (9, 1))), slice(0, 1), 5.0, unsigned=False) is None
    )
    assert interval95(block_sums(np.zeros((9, 3))), slice(0, 3), 1.0, unsigned=False) == (0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["white steps", "steps with memory"])
def test_overlapping_sub_trajectories_of_simulated_odometry(law: str) -> None:
    shares = coverage(100, 60.0, 10, law, curved=False, seed=7)
    assert 0.88 <= np.mean(list(shares.values())) <= 1.0
    assert min(shares.values()) >= 0.82
