"""Medians: numpy's, to the last digit."""

import numpy as np
import pytest

from sfr_loc_map.geometry.arrays import finite_median, median


@pytest.mark.parametrize("count", [1, 2, 3, 10, 101])
def test_a_median_is_that_of_numpy(count: int) -> None:
    random = np.random.default_rng(count)
    for _ in range(20):
        values = random.normal(size=count)
        assert median(values) == np.median(values)
        with_gaps = np.concatenate((values, [np.nan] * 3))
        random.shuffle(with_gaps)
        assert finite_median(with_gaps) == np.median(values)


def test_no_numbers_have_no_median() -> None:
    assert np.isnan(median(np.zeros(0)))
    assert np.isnan(finite_median(np.full(3, np.nan)))
