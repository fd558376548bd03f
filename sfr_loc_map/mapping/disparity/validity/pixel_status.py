"""The status of each pixel: measured, filled, or the first validity test that its disparity fails.

A valid disparity is visible to both cameras, consistent in both images, and on the correct surface. `judge_pixels`
calls the tests in the order of `PixelStatus`. Exceptions: NOT_A_SURFACE is tested again after WRONG_SURFACE, because
that test may reduce a segment to a small one. `estimation` tests BEYOND_RANGE after holes are filled and the roll of
the right camera is removed. `hole_filling` may make any invalid pixel valid again, except in saturated neighbourhoods
(`Saturation.square_saturated`).

To add a test of the pixels of one pair:

- Add a value at the end of `PixelStatus`. The values are part of the results (`MappedPair.pixel_status`) and must not
  be renumbered.
- Add a function that returns the mask of the pixels that fail, and its call `_rejected(...)` in `judge_pixels`. The
  position of the call determines the reason of a pixel that fails several tests. If the order of the calls differs from
  the order of the values, add the test to the exceptions above.
- A call in `judge_before_wrong_surface` changes the pixels with which the network of WRONG_SURFACE was trained. Train
  the network again (`tools/train_jump_network.py`).
- If the pixels must not be filled, exclude them in `hole_filling.fill_holes` in the same way as saturated pixels.

Tests that compare pairs do not change the status of pixels. They remove content from views (`multiview.fixed_content`)
or drop points (`multiview.fusion`).
"""

from __future__ import annotations

from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatImage, Mask
from sfr_loc_map.geometry.robust_statistics import mad_sigma
from sfr_loc_map.mapping.disparity.refinement.variational_refinement import RefinedDisparity
from sfr_loc_map.mapping.disparity.surfaces import DisparityScene, occlusion_mask, right_surfaces, slope_along_rows
from sfr_loc_map.mapping.disparity.validity.jump_network import wrong_surface_mask
from sfr_loc_map.mapping.disparity.validity.segments import not_a_surface_mask
from sfr_loc_map.mapping.filters import box_mean

StatusImage = NDArray[np.uint8]  #: `(H, W)`, the `PixelStatus` of each pixel.
MAX_CHI2_PER_DOF = F(4.0)
"""A match is suspicious if the mean squared normalised residual around it exceeds this: (2 sigma)^2."""
CHI2_WINDOW = 5  #: Side of the window of that mean, pixels.
MAX_CHI2 = F(36.0)  #: Squared normalised residuals are clipped to (6 sigma)^2; unknown residuals have this value.
MAX_CONTRAST_RATIO = F(0.7)
"""A suspicious match is invalid if the ratio of its mean squared residual to the variance of the left image exceeds
this. Uncorrelated images have a ratio of 2."""
MAX_CHANGE_PX = 1.5  #: A change of the disparity by the refinement is always accepted up to this limit, pixels.
MAX_CHANGE_SIGMAS = 5.0  #: A larger change is accepted up to this many standard deviations of all changes of the pair.
CHANGE_STRIDE = 4  #: That standard deviation is measured on every fourth pixel of every fourth row.
MAX_SLOPE = F(0.7)
"""Slope along the row above which a pixel is on a ramp, pixels per pixel. A surface with a slope of 1 is parallel to a
ray of the right camera."""


class PixelStatus(IntEnum):
    """Status of a pixel. The reason for an invalid pixel is the first test that it fails.

    The tests are in the order of the values, with the exceptions that the docstring of the module names. If a saturated
    pixel also fails an earlier test, the earlier test is the reason. The pixel is not filled, like all saturated
    pixels. A filled pixel does not keep the reason for which it was invalid.

    The status describes one pair, and the fusion does not change the status. A valid pixel may therefore have no point
    in a fused cloud: `multiview.fixed_content` removes content that is fixed to the image, and `multiview.fusion` drops
    points that conflict with a point of another pair or duplicate it. `multiview.projection` compares points only with
    pixels whose neighbours are valid and on one surface.
    """

    MEASURED = 0  #: Valid: passed all tests.
    FILLED = 1  #: Valid: failed a test and was filled from the adjacent surface (`hole_filling`).
    UNMATCHED = 2  #: Rejected by the matcher: left-right check, uniqueness or speckle.
    CHANGED = 3  #: Changed too much by the refinement.
    OCCLUDED = 4  #: Occluded in the right image, or outside it.
    MISMATCHED = 5  #: Residual larger than the noise and similar to the image's contrast.
    RAMP = 6  #: On a ramp that joins two surfaces.
    NOT_A_SURFACE = 7  #: In a segment that is small or has no content in common with the right image.
    WRONG_SURFACE = 8  #: Beside a disparity jump, and probably with the disparity of the wrong side.
    SATURATED = 9  #: In a neighbourhood that is completely saturated.
    BEYOND_RANGE = 10  #: Beyond the maximum depth.


LAST_VALID = np.uint8(PixelStatus.FILLED)  #: Largest value of a valid status.


def is_valid(status: StatusImage) -> Mask:
    """Return the mask of the pixels `(H, W)` that are measured or filled."""
    valid: Mask = status <= LAST_VALID
    return valid


def with_reason(status: StatusImage, failed: Mask, reason: PixelStatus) -> StatusImage:
    """Return the status with `reason` at failed pixels that were valid."""
    newly_invalid = failed & is_valid(status)
    return np.maximum(status, newly_invalid * np.uint8(reason))  # each reason is larger than each valid status


def judge_pixels(
    scene: DisparityScene, refined: RefinedDisparity, left_variance: FloatImage, saturated: Mask
) -> tuple[DisparityScene, StatusImage]:
    """Return the scene whose valid pixels are measured, and the status of each pixel: measured, or why it is invalid.

    The valid pixels of the given scene are those that the semi-global matching has matched. `left_variance` is the
    local variance of the left image (`filters.local_variance`), and `saturated` the mask of the completely saturated
    neighbourhoods (`Saturation.square_saturated`).
    """
    scene, status = judge_before_wrong_surface(scene, refined, left_variance)
    scene, status = _rejected(scene, status, wrong_surface_mask(scene), PixelStatus.WRONG_SURFACE)
    # The wrong-surface test may have reduced a segment to a small one.
    scene, status = _rejected(scene, status, not_a_surface_mask(scene), PixelStatus.NOT_A_SURFACE)
    return _rejected(scene, status, saturated, PixelStatus.SATURATED)


def judge_before_wrong_surface(
    scene: DisparityScene, refined: RefinedDisparity, left_variance: FloatImage
) -> tuple[DisparityScene, StatusImage]:
    """Return the scene and the status of each pixel after the tests before WRONG_SURFACE.

    These tests are a separate function, because the network of WRONG_SURFACE is trained with the pixels that pass them.
    """
    status = ~scene.valid * np.uint8(PixelStatus.UNMATCHED)  # MEASURED is 0
    changed = _changed_mask(scene.matched, scene.disparity)
    scene, status = _rejected(scene, status, changed, PixelStatus.CHANGED)
    occluded = occlusion_mask(scene.disparity, right_surfaces(scene.disparity, scene.valid))
    scene, status = _rejected(scene, status, occluded, PixelStatus.OCCLUDED)
    scene, status = _rejected(scene, status, _mismatch_mask(refined, left_variance), PixelStatus.MISMATCHED)
    scene, status = _rejected(scene, status, _ramp_mask(scene.disparity), PixelStatus.RAMP)
    return _rejected(scene, status, not_a_surface_mask(scene), PixelStatus.NOT_A_SURFACE)


def _rejected(
    scene: DisparityScene, status: StatusImage, failed: Mask, reason: PixelStatus
) -> tuple[DisparityScene, StatusImage]:
    """Return the scene and the status with `reason` at failed pixels, which are no longer valid."""
    status = with_reason(status, failed, reason)
    return scene._replace(valid=is_valid(status)), status


def _changed_mask(matched_px: FloatImage, disparity_px: FloatImage) -> Mask:
    """Return the mask of the pixels `(H, W)` that the refinement changed too much; `matched_px` may be NaN."""
    change_px = np.abs(disparity_px - matched_px)
    sampled = change_px[::CHANGE_STRIDE, ::CHANGE_STRIDE]
    known = sampled[np.isfinite(sampled)]
    change_sigma_px = mad_sigma(known) if len(known) else 0.0
    changed: Mask = change_px > max(MAX_CHANGE_PX, MAX_CHANGE_SIGMAS * change_sigma_px)
    return changed


def _mismatch_mask(refined: RefinedDisparity, left_variance: FloatImage) -> Mask:
    """Return the mask of the pixels `(H, W)` with residuals above the noise and similar to the contrast of the image.

    Residuals are normalised by the noise of each cell. Multiplied by the median noise of the pair, they are
    approximately in grey levels: too small in bright regions and too large in dark regions, because noise grows with
    the light.
    """
    chi2_per_dof = box_mean(np.fmin(np.square(refined.normalised_residual), MAX_CHI2), CHI2_WINDOW)
    squared_residual = chi2_per_dof * F(refined.noise_grey * refined.noise_grey)
    is_suspicious = chi2_per_dof > MAX_CHI2_PER_DOF
    mismatch: Mask = is_suspicious & (squared_residual > MAX_CONTRAST_RATIO * left_variance)
    return mismatch


def _ramp_mask(disparity_px: FloatImage) -> Mask:
    """Return the mask of the pixels `(H, W)` on a ramp that joins two surfaces, or beside such a ramp along the row."""
    steep = (np.abs(slope_along_rows(disparity_px)) > MAX_SLOPE).astype(np.uint8)
    return np.asarray(cv2.dilate(steep, np.ones((1, 3), np.uint8))) > 0
