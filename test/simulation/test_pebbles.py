"""Pebbles cast shadows away from the sun."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.simulation.pebbles import PebbleCover, PebbleField, pebble_cache, pebbles

SUN = np.array([0.8, 0.0, 0.6])
FIELD = PebbleField.of(1.0, 1.0, np.uint32(7), SUN)
FINE_M = 0.0005


def positions(count: int = 1500) -> FloatArray:
    return np.random.default_rng(4).uniform(-3.0, 3.0, (count, 2))


def covers(fill: float, at: FloatArray, footprint: float = FINE_M) -> list[PebbleCover]:
    cache = pebble_cache()
    return [pebbles(x, y, footprint, fill, FIELD, cache) for x, y in at]


def test_shadows_lie_on_the_side_away_from_the_sun() -> None:
    """Step from shadow towards the sun and a pebble is met sooner than stepping away from it."""
    at = positions(4000)
    shadow = np.array([cover.shadow > 0.5 and cover.cover == 0.0 for cover in covers(1.0, at)])
    assert shadow.sum() > 30
    step = np.array([0.004, 0.0])
    sunward, leeward = (
        np.mean([cover.cover for cover in covers(1.0, at[shadow] + sign * step)]) for sign in (1.0, -1.0)
    )
    assert sunward > 1.3 * leeward
