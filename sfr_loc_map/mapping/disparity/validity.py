"""Which disparities are valid: visible to both cameras, consistent in both images, and on the correct surface.

The tests are, in their order: those of the matcher (left-right check, uniqueness, speckles), change by the refinement,
occlusion, residual (`locally_valid`), ramps between surfaces (`ramp_mask`), segments (`segments`), the surface beside a
jump (`wrong_surface`), segments again, and saturation. Points beyond the largest range are removed later
(`reprojection`).
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.disparity.filters import SURFACE_JUMP_PX, box_mean, local_variance
from sfr_loc_map.mapping.disparity.saturation import Saturation
from sfr_loc_map.mapping.disparity.segments import valid_segments
from sfr_loc_map.mapping.disparity.variational_refinement import RefinedDisparity
from sfr_loc_map.mapping.disparity.wrong_surface import EdgeScene, wrong_surface_mask
from sfr_loc_map.mapping.robust_statistics import mad_sigma

F = np.float32

MAX_CHI2_PER_DOF = F(4.0)
"""Mean squared normalised residual of a window above which a match is suspicious: twice the noise's standard
deviation."""
CHI2_WINDOW = 5  #: Side of that window, pixels: 25 residuals of noise exceed the threshold in less than one of 1e6.
MAX_CHI2 = F(36.0)  #: Single squared residuals are clipped to this, 6 sigma squared; unknown ones have this value.
MAX_CONTRAST_RATIO = F(0.7)
"""Mean squared residual over the variance of the left image above which a suspicious match is invalid; uncorrelated
images have a ratio of 2. A ratio of 1.2 changes density by 0.001 or less (measurements/mapper_trials.md)."""
MAX_CHANGE_PX = 1.5
"""Change by the refinement that is always accepted, pixels: the matcher's noise and the ramps of its smoothness."""
MAX_CHANGE_SIGMAS = 5.0  #: Larger changes are accepted up to this many standard deviations of all changes.
CHANGE_STRIDE = 4  #: Every fourth pixel of every fourth row measures the standard deviation of all changes.
MAX_SLOPE = F(0.7)
"""Slope along the row above which a pixel is on a ramp, pixels per pixel. A slope of 1 is parallel to a ray of the
right camera: a steep ramp joins two surfaces across an occluded region. Values of 0.5 to 0.85 change density by 0.001
(measurements/mapper_trials.md)."""


def valid_mask(
    left: FloatImage,
    right: FloatImage,
    initial_px: FloatImage,
    refined: RefinedDisparity,
    sigma_px: FloatImage,
    saturation: Saturation,
) -> Mask:
    """Return which pixels `(H, W)` have a valid disparity.

    Invalid are pixels that the matcher left unmatched, that refinement changed too much, that are occluded in the right
    image, that differ between the images, that are on a ramp between two surfaces, that are likely on the wrong side of
    an edge, that belong to a segment that is small or has no common content, or that are completely saturated.
    """
    disparity = refined.disparity_px
    valid = valid_before_edges(left, right, initial_px, refined)
    scene = EdgeScene(left, right, disparity, np.isfinite(initial_px), valid, sigma_px)
    valid = valid & ~wrong_surface_mask(scene)
    valid = valid_segments(left, right, disparity, valid)  # the rest of a segment may be small
    return valid & ~saturation.saturated


def valid_before_edges(left: FloatImage, right: FloatImage, initial_px: FloatImage, refined: RefinedDisparity) -> Mask:
    """Return which pixels `(H, W)` are valid by the tests before that of the wrong surface beside a jump."""
    valid = locally_valid(left, initial_px, refined) & ~ramp_mask(refined.disparity_px)
    return valid_segments(left, right, refined.disparity_px, valid)


def locally_valid(left: FloatImage, initial_px: FloatImage, refined: RefinedDisparity) -> Mask:
    """Return which pixels `(H, W)` are matched and pass the tests of change, occlusion and residual."""
    is_matched = np.isfinite(initial_px)
    change_px = np.abs(refined.disparity_px - initial_px)
    sampled = np.s_[::CHANGE_STRIDE, ::CHANGE_STRIDE]
    change_sigma_px = mad_sigma(change_px[sampled][is_matched[sampled]])
    is_little_changed: Mask = is_matched & (change_px <= max(MAX_CHANGE_PX, MAX_CHANGE_SIGMAS * change_sigma_px))
    if not is_little_changed.any():
        return is_little_changed
    occluded = occlusion_mask(refined.disparity_px, is_little_changed, SURFACE_JUMP_PX)
    return is_little_changed & ~occluded & ~mismatch_mask(left, refined)


def mismatch_mask(left: FloatImage, refined: RefinedDisparity) -> Mask:
    """Return which pixels `(H, W)` have residuals larger than their noise and similar to the image's contrast."""
    chi2_per_dof = box_mean(np.fmin(np.square(refined.normalised_residual), MAX_CHI2), CHI2_WINDOW)
    squared_residual = chi2_per_dof * F(refined.noise_grey * refined.noise_grey)
    is_suspicious = chi2_per_dof > MAX_CHI2_PER_DOF
    mismatch: Mask = is_suspicious & (squared_residual > MAX_CONTRAST_RATIO * local_variance(left))
    return mismatch


def ramp_mask(disparity: FloatImage) -> Mask:
    """Return which pixels `(H, W)` are on a ramp that joins two surfaces, or beside one along the row."""
    taps = np.array([[-0.5, 0.0, 0.5]], F)
    slope = cv2.filter2D(disparity, -1, taps, borderType=cv2.BORDER_REPLICATE)
    steep = (np.abs(slope) > MAX_SLOPE).astype(np.uint8)
    return np.asarray(cv2.dilate(steep, np.ones((1, 3), np.uint8))) > 0


@jit_rows
def occlusion_mask(disparity: FloatImage, valid: Mask, jump: np.float32) -> Mask:
    """Return which pixels `(H, W)` are occluded in the right image.

    Their corresponding pixel is outside the right image, or a valid surface nearer by more than `jump` covers it.
    """
    rows, cols = disparity.shape
    out = np.zeros((rows, cols), np.bool_)
    for y in prange(rows):
        nearest = np.full(cols, F(-1.0))
        for x in range(cols):
            u = int(np.rint(F(x) - disparity[y, x]))
            if valid[y, x] and 0 <= u < cols:
                nearest[u] = max(nearest[u], disparity[y, x])
        for x in range(cols):
            u = int(np.rint(F(x) - disparity[y, x]))
            out[y, x] = not (0 <= u < cols) or nearest[u] > disparity[y, x] + jump
    return out
