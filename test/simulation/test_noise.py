"""Noise: a pure function of position and seed, within its range, continuous across cells, with the right gradient."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.simulation.noise import gradient2, mix, value2, value3

SEED = np.uint32(9)
Field = Callable[..., tuple[float, ...]]
FIELDS: list[tuple[Field, int]] = [(value2, 2), (gradient2, 2), (value3, 3)]
fields = pytest.mark.parametrize(("field", "dimensions"), FIELDS, ids=["value2", "gradient2", "value3"])


def positions(dimensions: int, count: int = 300) -> FloatArray:
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


@fields
def test_value_and_gradient_are_continuous_across_cells(field: Field, dimensions: int) -> None:
    for at in np.rint(positions(dimensions, 50)):
        assert field(*(at - 1e-9), SEED) == pytest.approx(field(*(at + 1e-9), SEED), abs=1e-6)


def test_hash_is_a_bijection_that_mixes_every_bit() -> None:
    values = np.arange(20000, dtype=np.uint32)
    hashes = np.array([mix(value) for value in values], np.uint32)
    assert len(np.unique(hashes)) == len(values)
    bits = np.unpackbits(hashes.view(np.uint8)).reshape(len(values), 32)
    assert np.abs(bits.mean(axis=0) - 0.5).max() < 0.02
    flipped = np.array([mix(value ^ np.uint32(1)) for value in values[:4000]], np.uint32) ^ hashes[:4000]
    assert np.unpackbits(flipped.view(np.uint8)).mean() == pytest.approx(0.5, abs=0.02)
