"""Texture of the ground: each position by itself, waves faded by the footprint, cracks between plates."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.simulation.ground import GroundHits, GroundTexture, fade_of, ground_texture, plates
from sfr_loc_map.simulation.terrain import MaterialShares, materials, smooth_step

SHARES, SEED = MaterialShares(0.5, 0.2), np.uint32(4)
RNG = np.random.default_rng(6)
X, Y = RNG.uniform(-20, 20, (2, 400))


def texture(x: np.ndarray, y: np.ndarray, footprint: float, bump: float = 1.0) -> GroundTexture:
    count = len(x)
    hits = GroundHits(np.arange(count), x.copy(), y.copy(), np.full(count, 3.0), np.full(count, footprint))
    out = GroundTexture(*(np.empty(count) for _ in GroundTexture._fields))
    ground_texture(count, hits, bump, SHARES, SEED, out)
    return out


def test_texture_of_a_position_does_not_depend_on_the_others() -> None:
    together = texture(X, Y, 0.002)
    for n in range(0, 400, 40):
        alone = texture(X[n : n + 1], Y[n : n + 1], 0.002)
        assert [values[0] for values in alone] == [values[n] for values in together]


def test_materials_are_those_of_the_terrain() -> None:
    found = texture(X, Y, 0.002)
    for n in range(0, 400, 40):
        assert (found.sand[n], found.gravel[n], found.rock[n]) == materials(X[n], Y[n], SHARES, SEED)


def test_slopes_scale_with_the_bump_and_the_tone_does_not() -> None:
    one, two = texture(X, Y, 0.002), texture(X, Y, 0.002, bump=2.0)
    assert np.allclose(two.slope_x, 2.0 * one.slope_x, atol=1e-12)
    assert np.allclose(two.slope_y, 2.0 * one.slope_y, atol=1e-12)
    assert np.array_equal(one.tone, two.tone)
    assert one.slope_x.std() > 0.02


def test_slopes_are_a_gradient_rotated_by_a_right_angle() -> None:
    """Such a field has curl but no divergence (the coarseness that weighs it changes slowly)."""
    step = 1e-5
    east, west = (texture(X + sign * step, Y, 0.002) for sign in (1.0, -1.0))
    north, south = (texture(X, Y + sign * step, 0.002) for sign in (1.0, -1.0))
    divergence = east.slope_x - west.slope_x + north.slope_y - south.slope_y
    curl = east.slope_y - west.slope_y - north.slope_x + south.slope_x
    assert divergence.std() < 0.1 * curl.std()


def test_waves_fade_between_one_and_a_half_and_three_and_a_half_footprints() -> None:
    assert [fade_of(length, 1.0) for length in (1.0, 1.4, 2.4, 3.4, 9.0)] == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0])
    assert texture(X, Y, 0.4).tone.std() < texture(X, Y, 0.002).tone.std()


def test_smooth_step_is_a_symmetric_cubic() -> None:
    t = np.linspace(-0.5, 1.5, 41)
    values = np.array([smooth_step(2.0, 4.0, 2.0 + 2.0 * value) for value in t])
    inside = np.clip(t, 0, 1)
    assert values == pytest.approx(inside**2 * (3 - 2 * inside), abs=1e-12)
    assert values + values[::-1] == pytest.approx(np.ones(41), abs=1e-12)


def test_plates_are_tilted_constantly_and_dark_at_their_cracks() -> None:
    found = np.array([plates(x, y, 0.002, SEED) for x, y in zip(X, Y, strict=True)])
    assert found[:, 0].min() >= 0.0
    assert found[:, 0].max() <= 1.0
    assert 0.005 < (found[:, 0] > 0.5).mean() < 0.3
    assert np.abs(found[:, 1:]).max() <= 0.08
    moved = np.array([plates(x + 1e-4, y, 0.002, SEED) for x, y in zip(X, Y, strict=True)])
    assert (moved[:, 1] == found[:, 1]).mean() > 0.98
