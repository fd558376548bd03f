"""Measurement and correction of the exposure and the vertical disparity of the right image.

In a rectified pair both images have the same exposure, and corresponding points have the same row. Real pairs deviate:
automatic exposure differs between the cameras, and the rig deforms after its calibration. `correct_right_image`
measures and removes both, given the disparities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.mapping.disparity.exposure import Exposure, exposure_by_disparity
from sfr_loc_map.mapping.disparity.right_camera.vertical_disparity import (
    LINEAR_TERMS,
    VerticalPolynomial,
    fit_vertical_disparity,
    without_vertical_disparity,
)

MAX_VERTICAL_STEPS = 3  #: Maximum number of Gauss-Newton steps of the vertical disparity.
MIN_VERTICAL_COUNT = 1000  #: Minimum number of pixels for measuring the vertical disparity.
MIN_VERTICAL_PX = 0.02  #: Minimum vertical disparity that is corrected, pixels, because resampling blurs the image.
MAX_VERTICAL_STEP_PX = 1.0  #: Maximum change of the vertical disparity within the image in one step, pixels.


@dataclass(frozen=True, slots=True)
class RightImageCorrection:
    """Deviation of the right image from a rectified image of equal exposure: exposure and vertical disparity."""

    exposure: Exposure  #: Grey levels of the right image relative to the left image.
    vertical: VerticalPolynomial  #: Linear vertical disparity of the right image; 0 if it is too small to be corrected.
    vertical_largest_px: float  #: Largest vertical disparity within the image, pixels.


def correct_right_image(
    left: FloatImage, right: FloatImage, disparity_px: FloatImage, camera: StereoCamera
) -> tuple[FloatImage, RightImageCorrection]:
    """Return the right image `(H, W)` as a rectified camera with the exposure of the left camera would observe it.

    The correction contains the exposure and the vertical disparity that were removed. A vertical disparity below
    `MIN_VERTICAL_PX` stays in the image and is not part of the correction. The disparity must be defined at every pixel
    and correct to about one pixel.
    """
    exposure = exposure_by_disparity(left, right, disparity_px)
    equalised = (right - F(exposure.offset_grey)) * F(1.0 / exposure.gain)
    corrected = equalised
    vertical = VerticalPolynomial()
    for _ in range(MAX_VERTICAL_STEPS):
        step = _vertical_step(left, corrected, disparity_px, camera)
        vertical = vertical.plus(step)
        if _largest_px(vertical, left.shape, camera) < MIN_VERTICAL_PX:
            corrected = equalised
            vertical = VerticalPolynomial()
            break
        corrected = without_vertical_disparity(equalised, vertical, camera)
        if _largest_px(step, left.shape, camera) < MIN_VERTICAL_PX:
            break
    largest_px = _largest_px(vertical, left.shape, camera)
    return corrected, RightImageCorrection(exposure, vertical, largest_px)


def _vertical_step(
    left: FloatImage, right: FloatImage, disparity_px: FloatImage, camera: StereoCamera
) -> VerticalPolynomial:
    """Return the change of the linear vertical disparity by one step; 0 if it cannot be measured."""
    fit = fit_vertical_disparity(
        left, right, disparity_px, camera, term_count=LINEAR_TERMS, min_count=MIN_VERTICAL_COUNT
    )
    if fit is None:
        return VerticalPolynomial()
    largest_px = _largest_px(fit.polynomial, left.shape, camera)
    reduction = MAX_VERTICAL_STEP_PX / max(largest_px, MAX_VERTICAL_STEP_PX)
    return VerticalPolynomial(*(reduction * value for value in fit.polynomial))


def _largest_px(vertical: VerticalPolynomial, shape: tuple[int, ...], camera: StereoCamera) -> float:
    """Return the largest absolute value of a linear vertical disparity within the image, which is at a corner."""
    height, width = shape
    columns = np.array([[0.0, width - 1.0]])
    rows = np.array([[0.0], [height - 1.0]])
    return float(np.abs(vertical.at_pixels(columns, rows, camera)).max())
