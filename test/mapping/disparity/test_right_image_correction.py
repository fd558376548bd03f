"""What the correction of the right image states as removed is what it has removed from the image."""

import numpy as np
import pytest

from helpers.disparity_world import hills, make_world
from sfr_loc_map.mapping.disparity.right_camera.right_image_correction import MIN_VERTICAL_PX, correct_right_image
from sfr_loc_map.mapping.disparity.right_camera.vertical_disparity import (
    VerticalPolynomial,
    fit_vertical_disparity,
    shift_rows,
)


@pytest.mark.parametrize("offset_px", [0.01, 0.3])
def test_the_stated_and_the_remaining_vertical_disparity_add_up_to_that_of_the_pair(offset_px: float) -> None:
    made = make_world(hills, width=512, height=448, noise=1.0, seed=4)
    left = made.pair.left.astype(np.float32)
    disparity_px = made.disparity.astype(np.float32)
    right = made.pair.right.astype(np.float32)

    def offset_of(image: np.ndarray) -> float:
        """Return the mean vertical disparity of an image, pixels."""
        fit = fit_vertical_disparity(left, image, disparity_px, made.rig.camera, term_count=1, min_count=1000)
        assert fit is not None
        return fit.polynomial.constant

    lowered = shift_rows(right, np.full(right.shape, offset_of(right) - offset_px, np.float32))
    image, correction = correct_right_image(left, lowered, disparity_px, made.rig.camera)
    stated_px = correction.vertical.constant
    if offset_px < MIN_VERTICAL_PX:
        assert correction.vertical == VerticalPolynomial()
    assert stated_px + offset_of(image) == pytest.approx(offset_px, abs=0.004)
