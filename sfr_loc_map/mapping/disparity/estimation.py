"""From a stereo pair to its disparity map, before holes are filled."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.mapping.disparity.cell_field import cells_from_disparity, disparity_from_cells
from sfr_loc_map.mapping.disparity.disparity_map import DisparityMap
from sfr_loc_map.mapping.disparity.right_image_correction import correct_right_image
from sfr_loc_map.mapping.disparity.saturation import measure_saturation
from sfr_loc_map.mapping.disparity.semi_global_matching import semi_global_matching
from sfr_loc_map.mapping.disparity.texture import valid_textured_fraction
from sfr_loc_map.mapping.disparity.uncertainty import disparity_sigma
from sfr_loc_map.mapping.disparity.validity import valid_mask
from sfr_loc_map.mapping.disparity.variational_refinement import refine


def estimate_disparity(pair: StereoPair, disparity_count: int) -> DisparityMap:
    """Return the disparity map of a pair, searched over the disparities from 0 to `disparity_count - 1`.

    The steps are: initial disparity, correction of the right image, refinement, standard deviation, validity.
    """
    left = pair.left.astype(np.float32)
    initial_px = semi_global_matching(pair.left, pair.right, disparity_count)
    initial_cells = cells_from_disparity(initial_px)
    without_holes_px = disparity_from_cells(initial_cells, left.shape)
    corrected = correct_right_image(left, pair.right.astype(np.float32), without_holes_px)
    right = corrected.image
    refined = refine(left, right, initial_cells)
    sigma_px = disparity_sigma(refined)
    saturation = measure_saturation(pair.left, pair.right, refined.disparity_px)
    valid = valid_mask(left, right, initial_px, refined, sigma_px, saturation)
    return DisparityMap(
        px=refined.disparity_px,
        sigma_px=sigma_px,
        valid=valid,
        initial_px=initial_px,
        left=left,
        right=right,
        correction=corrected.correction,
        saturation=saturation,
        noise_grey=refined.noise_grey,
        valid_textured_fraction=valid_textured_fraction(left, valid),
    )
