"""Saturated pixels: holes where there is nothing else, wider sigma beside them, no change without."""

from typing import Any

import numpy as np
import pytest

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.saturation import SIGMA_GROWTH, saturation
from sfr_loc_map.mapping.mapper import Mapper


def grey(value: int = 100) -> np.ndarray:
    return np.full((60, 80), value, np.uint8)


@pytest.mark.parametrize("level", [0, 255])
def test_a_patch_of_either_image_is_flat_where_its_partner_is_seen(level: int) -> None:
    left, right, disparity = grey(), grey(), np.full((60, 80), 7.0, np.float32)
    right[20:30, 30:40] = level
    found = saturation(left, right, disparity)
    rows, columns = np.nonzero(found.flat)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (22, 27, 39, 44)  # 7 pixels to the right
    assert found.share == pytest.approx(100 / 4800)
    assert found.sigma_factor.min() == pytest.approx(1.0, abs=1e-6)
    assert 1.5 < found.sigma_factor.max() <= 1.0 + SIGMA_GROWTH
    left[20:30, 30:40], right[:] = level, 100
    assert np.flatnonzero(saturation(left, right, disparity).flat.any(axis=0)).tolist() == list(range(32, 38))


def test_without_saturation_nothing_changes() -> None:
    found = saturation(grey(), grey(), np.zeros((60, 80), np.float32))
    assert not found.flat.any()
    assert found.share == 0.0
    assert (found.sigma_factor == 1.0).all()


def test_a_clipped_patch_is_a_hole_and_uncertain_around_it(world: Any, slope_field: Any) -> None:
    made = world(slope_field, width=384, height=320)
    left, right = made.pair.left.copy(), made.pair.right.copy()
    v, u = np.mgrid[:320, :384]
    partner = np.rint(u - made.disparity).astype(int)
    patch = (abs(v - 160) < 8) & (abs(u - 200) < 8)  # small enough to be bridged by smoothness
    left[patch] = 255
    right[v[patch], partner[patch]] = 255
    plain = Mapper(made.rig, MappingConfig()).process(made.pair, Transform.identity(), 0)
    result = Mapper(made.rig, MappingConfig()).process(StereoPair(0, left, right), Transform.identity(), 0)
    inner = (abs(v - 160) < 5) & (abs(u - 200) < 5)
    assert np.isfinite(plain.disparity_px[inner]).all()
    assert np.isnan(result.disparity_px[inner]).all()
    around = (abs(v - 160) < 11) & (abs(u - 200) < 11) & ~patch

    def sigma_around(found: Any) -> float:
        image = np.full(v.shape, np.nan)
        image[found.cloud.v, found.cloud.u] = found.random_sigma
        return float(np.nanmedian(image[around]))

    assert sigma_around(result) > 1.2 * sigma_around(plain)
    fused = Mapper(made.rig, MappingConfig()).fuse([result])
    np.testing.assert_array_equal(fused.random_sigma, result.random_sigma)
    np.testing.assert_array_equal(fused.cloud.sigma, result.cloud.sigma)


def test_many_saturated_pixels_are_told(world: Any, slope_field: Any) -> None:
    made = world(slope_field)
    bright = [np.clip(image.astype(int) * 2, 0, 255).astype(np.uint8) for image in (made.pair.left, made.pair.right)]
    result = Mapper(made.rig, MappingConfig()).process(StereoPair(0, *bright), Transform.identity(), 0)
    assert any("% of the pixels are saturated" in line for line in result.warnings)
    assert result.statistics["saturated_share"] > 0.3
