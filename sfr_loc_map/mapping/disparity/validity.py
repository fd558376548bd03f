"""Validity tests of disparities: visible to both cameras, consistent in both images, and on the correct surface.

The tests in the order of the calls, with the `PixelStatus` of the pixels that fail:

1. UNMATCHED: the matcher rejects the pixel (`semi_global_matching`).
2. CHANGED: the refinement changes the disparity too much (`_changed_mask`).
3. OCCLUDED: a nearer surface hides the point from the right camera, or the point is outside the right image
   (`surfaces`). Only pixels that pass the tests above can occlude.
4. MISMATCHED: the residual exceeds the noise and is similar to the contrast of the image (`_mismatch_mask`).
5. RAMP: the pixel is on a ramp that joins two surfaces (`_ramp_mask`).
6. NOT_A_SURFACE: the segment of the pixel is too small or consists of noise (`segments`).
7. WRONG_SURFACE: the pixel is beside a jump and probably has the disparity of the wrong side (`wrong_surface`).
8. NOT_A_SURFACE, again: test 7 may have reduced a segment to a small one.
9. SATURATED: the neighbourhood of the pixel is completely saturated (`saturation`).
10. BEYOND_RANGE: the point is beyond the maximum depth. `final_disparity` applies this test after holes are filled and
    the roll is removed.

The reason for an invalid pixel is the first test that it fails. `hole_filling` may make any invalid pixel valid again,
except in saturated neighbourhoods (`Saturation.square_saturated`).

To add a test of the pixels of one pair:

- Add a value at the end of `PixelStatus`. The values are part of the results (`MappedPair.pixel_status`) and must not
  be renumbered.
- Add a function that returns the mask of the pixels that fail, and its call `with_reason(...)` in `judge_pixels`. The
  position of the call determines the reason of a pixel that fails several tests.
- A call in `status_before_wrong_surface` changes the pixels with which the network of test 7 was trained. Train the
  network again (`tools/train_jump_network.py`).
- If the pixels must not be filled, exclude them in `hole_filling.fill_holes` in the same way as saturated pixels.

A test that compares pairs does not change the status of pixels. `multiview.fixed_content` removes content of images,
and `multiview.fusion` drops points.
"""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage, Mask
from sfr_loc_map.geometry.robust_statistics import mad_sigma
from sfr_loc_map.mapping.disparity.jump_network import JumpScene
from sfr_loc_map.mapping.disparity.pair_refinement import RefinedPair
from sfr_loc_map.mapping.disparity.pixel_status import PixelStatus, StatusImage, is_valid, with_reason
from sfr_loc_map.mapping.disparity.saturation import Saturation
from sfr_loc_map.mapping.disparity.segments import not_a_surface_mask
from sfr_loc_map.mapping.disparity.surfaces import occlusion_mask, right_surfaces, slope_along_rows
from sfr_loc_map.mapping.disparity.wrong_surface import wrong_surface_mask
from sfr_loc_map.mapping.filters import box_mean

MAX_CHI2_PER_DOF = F(4.0)
"""A match is suspicious if the mean squared normalised residual of a window around it exceeds this: twice the standard
deviation of the noise."""
CHI2_WINDOW = 5  #: Side of that window, pixels: 25 residuals of noise exceed the threshold with p < 1e-6.
MAX_CHI2 = F(36.0)
"""Squared residuals are clipped to this value, (6 sigma)^2; unknown residuals have this value. With a larger value, a
few outliers dominate the mean over a window. Values of 16 and 100 change the density by 0.002 or less
(measurements/mapper_trials.md)."""
MAX_CONTRAST_RATIO = F(0.7)
"""A suspicious match is invalid if the ratio of its mean squared residual to the variance of the left image exceeds
this. Uncorrelated images have a ratio of 2. A threshold of 1.2 changes the density by 0.001 or less
(measurements/mapper_trials.md)."""
MAX_CHANGE_PX = 1.5
"""A change of the disparity by the refinement is always accepted up to this limit, pixels. With a larger limit, more
pixels of the real pairs are valid, but a larger fraction of them is wrong. Rendered pairs hardly change
(measurements/mapper_trials.md)."""
MAX_CHANGE_SIGMAS = 5.0
"""Larger changes are accepted up to this many standard deviations of all changes, because the noise of the matcher is
larger for pairs that match poorly. Chosen like `MAX_CHANGE_PX`."""
CHANGE_STRIDE = 4  #: The standard deviation of all changes is measured on every fourth pixel of every fourth row.
MAX_SLOPE = F(0.7)
"""Slope along the row above which a pixel is on a ramp, pixels per pixel. A surface with a slope of 1 is parallel to a
ray of the right camera, so that a steep ramp joins two surfaces across an occluded region. Values of 0.5 to 0.85 change
the density by 0.001 (measurements/mapper_trials.md)."""


def judge_pixels(pair: RefinedPair, left_variance: FloatImage, saturation: Saturation) -> StatusImage:
    """Return the status of each pixel: measured, or the reason why its disparity is invalid.

    `left_variance` is the local variance of the left image (`filters.local_variance`), for the test of the residuals.
    """
    status = status_before_wrong_surface(pair, left_variance)
    wrong_surface = wrong_surface_mask(jump_scene(pair, is_valid(status)))
    status = with_reason(status, wrong_surface, PixelStatus.WRONG_SURFACE)
    # The wrong-surface test may have reduced a segment to a small one.
    not_a_surface = not_a_surface_mask(pair.left, pair.right, pair.px, is_valid(status))
    status = with_reason(status, not_a_surface, PixelStatus.NOT_A_SURFACE)
    return with_reason(status, saturation.square_saturated, PixelStatus.SATURATED)


def status_before_wrong_surface(pair: RefinedPair, left_variance: FloatImage) -> StatusImage:
    """Return the status of each pixel after tests 1 to 6.

    These tests are a separate function, because the network of test 7 is trained with the pixels that pass them.
    """
    measured = np.full(pair.px.shape, PixelStatus.MEASURED, np.uint8)
    status = with_reason(measured, np.isnan(pair.initial_px), PixelStatus.UNMATCHED)
    status = with_reason(status, _changed_mask(pair.initial_px, pair.px), PixelStatus.CHANGED)
    occluded = occlusion_mask(pair.px, right_surfaces(pair.px, is_valid(status)))
    status = with_reason(status, occluded, PixelStatus.OCCLUDED)
    status = with_reason(status, _mismatch_mask(pair, left_variance), PixelStatus.MISMATCHED)
    status = with_reason(status, _ramp_mask(pair.px), PixelStatus.RAMP)
    not_a_surface = not_a_surface_mask(pair.left, pair.right, pair.px, is_valid(status))
    return with_reason(status, not_a_surface, PixelStatus.NOT_A_SURFACE)


def jump_scene(pair: RefinedPair, valid: Mask) -> JumpScene:
    """Return the input of the wrong-surface test; `valid` `(H, W)` is the mask of the pixels that pass tests 1 to 6."""
    return JumpScene(
        left=pair.left,
        right=pair.right,
        disparity=pair.px,
        has_initial=np.isfinite(pair.initial_px),
        valid=valid,
        sigma=pair.sigma_px,
    )


def _changed_mask(initial_px: FloatImage, disparity_px: FloatImage) -> Mask:
    """Return the mask of the pixels `(H, W)` that the refinement changed too much; `initial_px` may be NaN."""
    change_px = np.abs(disparity_px - initial_px)
    sampled = change_px[::CHANGE_STRIDE, ::CHANGE_STRIDE]
    known = sampled[np.isfinite(sampled)]
    change_sigma_px = mad_sigma(known) if len(known) else 0.0
    changed: Mask = change_px > max(MAX_CHANGE_PX, MAX_CHANGE_SIGMAS * change_sigma_px)
    return changed


def _mismatch_mask(pair: RefinedPair, left_variance: FloatImage) -> Mask:
    """Return the mask of the pixels `(H, W)` with residuals above the noise and similar to the contrast of the image.

    Residuals are normalised by the noise of each cell. Multiplied by the median noise of the pair, they are
    approximately in grey levels: too small in bright regions and too large in dark regions, because noise grows with
    the light.
    """
    chi2_per_dof = box_mean(np.fmin(np.square(pair.field.normalised_residual), MAX_CHI2), CHI2_WINDOW)
    squared_residual = chi2_per_dof * F(pair.field.noise_grey * pair.field.noise_grey)
    is_suspicious = chi2_per_dof > MAX_CHI2_PER_DOF
    mismatch: Mask = is_suspicious & (squared_residual > MAX_CONTRAST_RATIO * left_variance)
    return mismatch


def _ramp_mask(disparity_px: FloatImage) -> Mask:
    """Return the mask of the pixels `(H, W)` on a ramp that joins two surfaces, or beside such a ramp along the row."""
    steep = (np.abs(slope_along_rows(disparity_px)) > MAX_SLOPE).astype(np.uint8)
    return np.asarray(cv2.dilate(steep, np.ones((1, 3), np.uint8))) > 0
