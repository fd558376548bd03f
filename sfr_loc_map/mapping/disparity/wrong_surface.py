"""Detection of pixels beside a disparity jump that probably have the disparity of the wrong surface.

A network classifies these pixels (`jump_network`). A pixel is on the wrong surface if its log odds exceed a threshold
that depends on the sigma of the pair and on the depth of the pixel.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import F, Mask, median
from sfr_loc_map.mapping.disparity.jump_network import SURFACE_RADIUS, JumpScene, classified_pixels, log_odds_of_pixels
from sfr_loc_map.mapping.disparity.surfaces import depth_ratio

LOG_ODDS_AT_1_PX = F(3.3)
"""Log odds above which a pixel is invalid if the median sigma of the pair is 1 pixel. The threshold is this value plus
the logarithm of the median sigma in pixels, because a single outlier dominates the error of a precise map. For a median
sigma of 0.05 pixels the threshold is 0.3. Chosen on rendered ground, Teddy and Motorcycle
(measurements/mapper_trials.md)."""
DEPTH_POWER = F(2.0)
"""The odds are multiplied by this power of the depth ratio, because the error in metres of a disparity on the wrong
surface grows with the square of the depth (measurements/mapper_trials.md)."""
SIGMA_STRIDE = 16  #: Every sixteenth valid pixel is used for the median sigma: tens of thousands of samples suffice.


def wrong_surface_mask(scene: JumpScene) -> Mask:
    """Return the mask of the valid pixels `(H, W)` beside a jump that are probably on the wrong surface."""
    wrong = np.zeros(scene.valid.shape, np.bool_)
    flat_indices = classified_pixels(scene)
    if not len(flat_indices):
        return wrong
    log_odds = log_odds_of_pixels(scene, flat_indices)
    log_depth_ratio = np.log(depth_ratio(scene.disparity, SURFACE_RADIUS).flat[flat_indices])
    median_sigma_px = median(scene.sigma[scene.valid][::SIGMA_STRIDE])
    threshold = LOG_ODDS_AT_1_PX + np.log(median_sigma_px)
    wrong.flat[flat_indices] = log_odds + DEPTH_POWER * log_depth_ratio > threshold
    return wrong
