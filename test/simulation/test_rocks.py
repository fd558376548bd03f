"""Rocks: their number by size follows the distribution of Golombek and Rapp."""

import numpy as np
import pytest

from sfr_loc_map.simulation.rocks import rocks_per_area


def test_rock_cover_is_that_of_the_law() -> None:
    """The areas of all rocks above D add up to k exp(-q D), here for k = 5 % (Golombek and Rapp 1997)."""
    diameters = np.geomspace(0.1, 5.0, 20000)
    numbers = rocks_per_area(diameters, 0.05)
    areas = 0.25 * np.pi * (0.5 * (diameters[1:] + diameters[:-1])) ** 2 * -np.diff(numbers)
    assert areas.sum() == pytest.approx(0.05 * np.exp(-(1.79 + 0.152 / 0.05) * 0.1), rel=5e-3)
