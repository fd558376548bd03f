"""Exposure without disparities: equalised where the contrast of both images is known, otherwise only shifted."""

import numpy as np

from sfr_loc_map.mapping.disparity.exposure import with_exposure_of_left


def test_a_right_image_of_another_gain_and_offset_gets_the_grey_levels_of_the_left_one() -> None:
    left = np.random.default_rng(0).integers(60, 200, (120, 160), dtype=np.uint8)
    right = np.rint(0.7 * left + 20.0).astype(np.uint8)
    difference = with_exposure_of_left(left, right).astype(int) - left
    assert np.abs(difference).max() <= 2
    np.testing.assert_array_equal(with_exposure_of_left(left, left + np.uint8(8)), left + np.uint8(8))


def test_a_left_image_that_is_mostly_of_one_grey_level_keeps_the_contrast_of_the_right_one() -> None:
    """A gain that was measured there would be 0, and the right image would lose all texture."""
    left = np.full((120, 160), 100, np.uint8)
    left[:20] = np.random.default_rng(0).integers(0, 256, (20, 160))  # a sixth of the image has texture
    right = np.clip(left + np.random.default_rng(1).normal(30.0, 3.0, left.shape), 0, 255).astype(np.uint8)
    equalised = with_exposure_of_left(left, right)
    assert np.median(equalised) == 100
    assert equalised.std() > 0.9 * right.std()
