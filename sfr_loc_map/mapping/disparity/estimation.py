"""From a stereo pair to its disparity map, before holes are filled."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.mapping.disparity.cell_field import field_from_disparity, padded, pixels_from_cells
from sfr_loc_map.mapping.disparity.disparity_map import DisparityMap
from sfr_loc_map.mapping.disparity.filters import SURFACE_JUMP_PX
from sfr_loc_map.mapping.disparity.rectification_correction import correct_rectification
from sfr_loc_map.mapping.disparity.saturation import measure_saturation
from sfr_loc_map.mapping.disparity.semi_global_matching import semi_global_matching
from sfr_loc_map.mapping.disparity.texture import matched_fraction
from sfr_loc_map.mapping.disparity.uncertainty import disparity_sigma
from sfr_loc_map.mapping.disparity.validity import valid_mask
from sfr_loc_map.mapping.disparity.variational_refinement import refine


def estimate_disparity(pair: StereoPair, disparity_count: int) -> DisparityMap:
    """Return the disparity map of a pair, searched over the disparities from 0 to `disparity_count - 1`.

    The steps are: initial disparity, correction of the right image, refinement, standard deviation, validity.
    """
    left = pair.left.astype(np.float32)
    initial_px = semi_global_matching(pair.left, pair.right, disparity_count)
    initial_field = field_from_disparity(initial_px)
    right, correction = correct_rectification(
        padded(left), padded(pair.right.astype(np.float32)), pixels_from_cells(initial_field, SURFACE_JUMP_PX)
    )
    refined = refine(left, right, initial_field)
    height, width = left.shape
    right = np.ascontiguousarray(right[:height, :width])
    sigma_px = disparity_sigma(refined)
    saturation = measure_saturation(pair.left, pair.right, refined.disparity_px)
    valid = valid_mask(left, right, initial_px, refined, sigma_px) & ~saturation.flat
    return DisparityMap(
        px=refined.disparity_px,
        sigma_px=sigma_px,
        valid=valid,
        initial_px=initial_px,
        left=left,
        right=right,
        correction=correction,
        saturation=saturation,
        noise_grey=refined.noise_grey,
        matched_fraction=matched_fraction(left, valid),
    )
