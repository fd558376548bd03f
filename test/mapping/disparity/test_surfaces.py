"""What a nearer surface hides from the right camera is not kept."""

import numpy as np

from sfr_loc_map.mapping.disparity.surfaces import occlusion_mask, right_surfaces

F = np.float32


def test_the_background_left_of_a_block_is_occluded() -> None:
    """The block covers columns 46-75 of the right image; there the background of columns 52-81 would be."""
    disparity, valid = np.full((40, 120), F(6.0)), np.ones((40, 120), bool)
    disparity[10:30, 60:90] = 14.0
    expected = np.zeros_like(valid)
    expected[:, :6] = True
    expected[10:30, 52:60] = True
    surfaces = right_surfaces(disparity, valid)
    np.testing.assert_array_equal(occlusion_mask(disparity, surfaces), expected)
    nearly_flat = np.where(disparity > 10.0, F(6.9), F(6.0))  # nearer by less than a jump
    assert not occlusion_mask(nearly_flat, right_surfaces(nearly_flat, valid))[:, 7:].any()
    valid[10:30, 60:90] = False  # what is not valid occludes nothing
    assert not occlusion_mask(disparity, right_surfaces(disparity, valid))[:, 6:].any()
