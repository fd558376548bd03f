"""Which disparities are valid: visible to both cameras, textured, alike in both images, on the right surface."""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.geometry.median import finite_median
from sfr_loc_map.mapping.disparity.edge_evidence import NEIGHBOURHOOD, Scene, support_weights
from sfr_loc_map.mapping.disparity.edge_network import wrong_surface_log_odds
from sfr_loc_map.mapping.disparity.filters import box_mean, upsample_nearest
from sfr_loc_map.mapping.disparity.occlusion import occlusion_mask
from sfr_loc_map.mapping.disparity.segments import valid_segments
from sfr_loc_map.mapping.disparity.uncertainty import NOISE_INFORMATION
from sfr_loc_map.mapping.disparity.variational_refinement import JUMP_PX, RefinedDisparity
from sfr_loc_map.mapping.robust import MAD_TO_SIGMA

F = np.float32

MIN_TEXTURE = F(0.06)
"""Mean information of a cell beyond that of noise below which a region counts as textureless."""
TEXTURE_CELLS = 13
MAX_CHI2_PER_DOF = F(4.0)
"""Mean square of normalised residuals in 5 x 5 pixels beyond which a match is doubtful."""
MAX_SQUARE = F(36.0)
"""Squares of single normalised residuals are clipped to this, unknown ones take it."""
MAX_CONTRAST_SHARE = F(0.7)
"""Share of the image's own variance that a doubtful match's residuals must reach to be wrong; 2 is no correlation."""
MAX_CHANGE_PX = 1.5
"""Refinement may change a disparity by this, or by five times the typical change if that is more."""
JUMP_RANGE_PX = F(1.5)
"""Disparities of 3 x 3 pixels that span more are a jump; pixels up to `NEIGHBOURHOOD` from it are beside it."""
MAX_LOG_ODDS = F(1.4)
"""A pixel beside a jump is dropped if its log odds of being on the wrong surface exceed this. They are learnt with
weights by the size of the error."""
MAX_SLOPE = F(0.7)
"""Pixels of disparity for each pixel along the row. A ramp of 1 lies on one ray of the right camera: what is steep
joins two surfaces across a part that one of the cameras does not see."""


def valid_mask(left: FloatImage, refined: RefinedDisparity, initial_px: FloatImage, sigma_px: FloatImage) -> Mask:
    """Tell which pixels `(H, W)` have a valid disparity.

    Invalid are pixels that the matcher left out, that refinement moved far, that are occluded in the right image, have
    no texture, differ between the images, are likely on the wrong side of an edge (`edge_network`), or belong to a
    segment that is small or has no content in common (`segments`).
    """
    disparity = refined.disparity_px
    valid = locally_valid(left, refined, initial_px)
    chosen = np.flatnonzero(beside_jump(disparity) & valid)
    scene = Scene(left, refined.right, disparity, np.isfinite(initial_px), sigma_px, *support_weights())
    valid.flat[chosen[wrong_surface_log_odds(scene, chosen) > MAX_LOG_ODDS]] = False
    return valid_segments(left, refined.right, disparity, valid)


def locally_valid(left: FloatImage, refined: RefinedDisparity, initial_px: FloatImage) -> Mask:
    """Tell which pixels `(H, W)` pass the tests that need no decision between two surfaces."""
    disparity = refined.disparity_px
    change = np.abs(disparity - initial_px)
    matched = np.isfinite(initial_px)
    if not matched.any():
        return matched
    valid = matched & (change <= max(MAX_CHANGE_PX, 5.0 * MAD_TO_SIGMA * finite_median(change)))
    valid &= ~occlusion_mask(disparity, valid, JUMP_PX)
    return np.asarray(valid & _textured(refined) & _similar(left, refined) & ~_ramp(disparity))


def _textured(refined: RefinedDisparity) -> Mask:
    height, width = refined.disparity_px.shape
    texture = upsample_nearest(box_mean(refined.information, TEXTURE_CELLS))[:height, :width]
    return np.asarray(texture > NOISE_INFORMATION + MIN_TEXTURE)


def _similar(left: FloatImage, refined: RefinedDisparity) -> Mask:
    """Tell where residuals are no larger than their noise explains, or small against the image's contrast."""
    square = np.minimum(refined.normalised_residual * refined.normalised_residual, MAX_SQUARE)
    square[np.isnan(square)] = MAX_SQUARE
    chi2_per_dof = box_mean(square, 5)
    contrast = box_mean(np.square(left), 7) - np.square(box_mean(left, 7))
    doubtful = chi2_per_dof > MAX_CHI2_PER_DOF
    wrong = chi2_per_dof * F(refined.noise * refined.noise) > MAX_CONTRAST_SHARE * contrast
    return np.asarray(~(doubtful & wrong))


def _ramp(disparity: FloatImage) -> Mask:
    """Tell which pixels, and which beside them along the row, lie on a ramp."""
    taps = np.array([[-0.5, 0.0, 0.5]], F)
    steep = np.abs(cv2.filter2D(disparity, -1, taps, borderType=cv2.BORDER_REPLICATE)) > MAX_SLOPE
    return np.asarray(cv2.dilate(steep.astype(np.uint8), np.ones((1, 3), np.uint8))).astype(np.bool_)


def beside_jump(disparity: FloatImage) -> Mask:
    """Tell which pixels `(H, W)` are at or near a jump of disparity."""
    square = np.ones((3, 3), np.uint8)
    jump = np.asarray(cv2.dilate(disparity, square) - cv2.erode(disparity, square), F) > JUMP_RANGE_PX
    wide = np.ones((2 * NEIGHBOURHOOD + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(jump.astype(np.uint8), wide)).astype(np.bool_)
