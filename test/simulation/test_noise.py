"""Noise: a function of position and seed, within its range, continuous across cells, with the correct gradient."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.simulation.noise import gradient2, value2, value3

SEED = np.uint32(9)
Field = Callable[..., tuple[float, ...]]
FIELDS: list[tuple[Field, int]] = [(value2, 2), (gradient2, 2), (value3, 3)]
fields = pytest.mark.parametrize(("field", "dimensions"), FIELDS, ids=["value2", "gradient2", "value3"])


def positions(dimensions: int, count: int = 60) -> FloatArray:
    return np.random.default_rng(0).uniform(-50, 50, (count, dimensions))


@fields
def test_gradient_is_that_of_the_value(field: Field, dimensions: int) -> None:
    step = 1e-6
    for at in positions(dimensions):
        _, *gradient = field(*at, SEED)
        central = [
            (field(*(at + offset), SEED)[0] - field(*(at - offset), SEED)[0]) / (2 * step)
            for offset in step * np.eye(dimensions)
        ]
        assert gradient == pytest.approx(central, abs=1e-7)
