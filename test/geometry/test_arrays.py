"""Medians: numpy's, to the last digit; of no numbers NaN."""

import numpy as np

from sfr_loc_map.geometry.arrays import median


def test_a_median_is_that_of_numpy() -> None:
    random = np.random.default_rng(0)
    for count in [1, 2, 3, 10, 101] * 20:
        values = random.normal(size=count)
        assert median(values) == np.median(values)
    assert np.isnan(median(np.zeros(0)))
