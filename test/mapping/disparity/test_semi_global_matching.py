"""Semi-global matching on random-dot stereograms; the range that is searched."""

import cv2
import numpy as np
import pytest
from disparity_world import two_planes

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.semi_global_matching import WIDE, search_range, semi_global_matching


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.5, 0.0), (0.6, 80.0), (1.0, -30.0)])
def test_a_random_dot_stereogram_of_any_exposure_is_matched(gain: float, offset: float) -> None:
    left, right, truth = two_planes((120, 200), np.s_[30:90, 80:150], 12, 4, 0.0)
    left, right = (np.asarray(64 + image / 2, np.uint8) for image in (left, right))
    other = np.clip(np.rint(gain * right + offset), 0, 255).astype(np.uint8)
    disparity = semi_global_matching(left, other, 32)
    known = np.isfinite(disparity)
    assert known[:, 4:].mean() > 0.85
    assert (np.abs(disparity - truth)[known] < 0.5).mean() > 0.97
    assert np.nanmedian(disparity[35:85, 85:145]) == pytest.approx(12.0, abs=1.0 / 16.0)


@pytest.mark.parametrize("cols", [WIDE - 1, WIDE, WIDE + 1])
def test_wide_images_are_matched_as_narrow_ones_are(cols: int) -> None:
    """Noise that is smooth over two pixels, shifted by an odd number of columns."""
    rng = np.random.default_rng(1)
    wide = cv2.GaussianBlur(rng.integers(0, 256, (60, cols + 40)).astype(np.float32), (0, 0), 2.0)
    wide = cv2.normalize(wide, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    left, right = wide[:, :cols].copy(), wide[:, 9 : cols + 9].copy()
    disparity = semi_global_matching(left, right, 32)
    known = np.isfinite(disparity)
    assert known[:, 9:].mean() > 0.95
    assert np.nanmedian(disparity) == pytest.approx(9.0, abs=0.25)
    assert (np.abs(disparity - 9.0)[known] < 1.0).mean() > 0.97


def test_the_search_range_covers_the_depths_and_at_most_half_the_width() -> None:
    rig = StereoRig(1000, 800, 500.0, 500.0, 499.5, 399.5, 0.2)
    found = search_range(rig, MappingConfig(min_range_m=2.0, max_range_m=25.0))
    assert found.min_disparity_px == pytest.approx(500.0 * 0.2 / 25.0)
    assert found.count == 64 > 500.0 * 0.2 / 2.0
    narrow = StereoRig(300, 200, 500.0, 500.0, 149.5, 99.5, 0.2)
    assert search_range(narrow, MappingConfig(min_range_m=0.1)).count == 160
    with pytest.raises(ConfigError, match=r"min_range_m 5\.0 must be less than max_range_m 5\.0"):
        search_range(rig, MappingConfig(min_range_m=5.0, max_range_m=5.0))
