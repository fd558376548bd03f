"""From a stereo pair to its disparity map, before holes are filled."""

from __future__ import annotations

from sfr_loc_map.geometry.arrays import F
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.mapping.disparity.cell_field import cells_from_disparity, disparity_from_cells
from sfr_loc_map.mapping.disparity.disparity_map import DisparityMap
from sfr_loc_map.mapping.disparity.pixel_status import is_valid
from sfr_loc_map.mapping.disparity.right_image_correction import correct_right_image
from sfr_loc_map.mapping.disparity.saturation import measure_saturation
from sfr_loc_map.mapping.disparity.semi_global_matching import semi_global_matching
from sfr_loc_map.mapping.disparity.texture import measured_textured_fraction
from sfr_loc_map.mapping.disparity.uncertainty import disparity_sigma
from sfr_loc_map.mapping.disparity.validity import pixel_status
from sfr_loc_map.mapping.disparity.variational_refinement import refine


def estimate_disparity(pair: StereoPair, disparity_count: int) -> DisparityMap:
    """Return the disparity map of a pair, searched over the disparities from 0 to `disparity_count - 1`.

    The steps are: initial disparity, correction of the right image, refinement, standard deviation, saturation, status.
    """
    left = pair.left.astype(F)
    initial_px = semi_global_matching(pair.left, pair.right, disparity_count)
    initial_cells = cells_from_disparity(initial_px)
    without_holes_px = disparity_from_cells(initial_cells, left.shape)
    corrected = correct_right_image(left, pair.right.astype(F), without_holes_px)
    right = corrected.image
    refined = refine(left, right, initial_cells)
    sigma_px = disparity_sigma(refined)
    saturation = measure_saturation(pair.left, pair.right, refined.disparity_px)
    status = pixel_status(left, right, initial_px, refined, sigma_px, saturation)
    return DisparityMap(
        px=refined.disparity_px,
        sigma_px=sigma_px,
        status=status,
        initial_px=initial_px,
        left=left,
        right=right,
        correction=corrected.correction,
        saturation=saturation,
        noise_grey=refined.noise_grey,
        measured_textured_fraction=measured_textured_fraction(left, is_valid(status)),
    )
