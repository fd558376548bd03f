"""From a stereo pair to its disparity map, before holes are filled."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.mapping.disparity.disparity_map import DisparityMap
from sfr_loc_map.mapping.disparity.filters import local_variance
from sfr_loc_map.mapping.disparity.saturation import measure_saturation
from sfr_loc_map.mapping.disparity.semi_global_matching import semi_global_matching
from sfr_loc_map.mapping.disparity.texture import matched_fraction
from sfr_loc_map.mapping.disparity.uncertainty import disparity_sigma
from sfr_loc_map.mapping.disparity.validity import valid_mask
from sfr_loc_map.mapping.disparity.variational_refinement import refine


def estimate_disparity(pair: StereoPair, disparity_count: int) -> DisparityMap:
    """Match a pair over the disparities from 0 to `disparity_count - 1`, refine the match and judge each pixel."""
    left = pair.left.astype(np.float32)
    right = pair.right.astype(np.float32)
    matched_px = semi_global_matching(pair.left, pair.right, disparity_count)
    refined = refine(left, right, matched_px)
    sigma_px = disparity_sigma(refined)
    saturation = measure_saturation(pair.left, pair.right, refined.disparity_px)
    variance = local_variance(left)
    valid = valid_mask(left, refined, matched_px, sigma_px, variance) & ~saturation.flat
    return DisparityMap(
        px=refined.disparity_px,
        sigma_px=sigma_px,
        valid=valid,
        matched_px=matched_px,
        left=left,
        right=refined.right,
        correction=refined.correction,
        saturation=saturation,
        noise_grey=refined.noise_grey,
        matched_fraction=matched_fraction(left, variance, valid),
    )
