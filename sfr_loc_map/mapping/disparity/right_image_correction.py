"""Exposure and vertical disparity of the right image, which are measured and corrected.

In a rectified pair both images have the same exposure, and corresponding points have the same row. Real pairs deviate:
automatic exposure differs between the cameras, and the rig deforms after its calibration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatArray, FloatImage
from sfr_loc_map.mapping.disparity.exposure import exposure_by_disparity
from sfr_loc_map.mapping.disparity.interpolation import shift_rows
from sfr_loc_map.mapping.disparity.photometric_residual import photometric_residual
from sfr_loc_map.mapping.robust_statistics import cauchy_weight, mad_sigma

SAMPLING_STRIDE = 3  #: Every third pixel of every third row is used; 100 000 samples suffice.
ROBUST_SIGMAS = 2.0
"""Residuals of this many standard deviations have half the weight. Under normal noise 2.385 has an efficiency of 95 %
(Holland and Welsch 1977); a smaller value gives less weight to outliers, such as wrong disparities."""
MIN_RESIDUAL_SIGMA = 1e-3  #: Added to the standard deviation of residuals, grey levels: it must not be 0.
MAX_ITERATIONS = 3
"""Gauss-Newton steps of the vertical disparity. Each step is limited to `MAX_STEP_PX`, so that at most 1.5 pixels of
offset, tilt or stretch are corrected."""
MIN_ROW_PIXELS = 1000
"""Pixels that a measurement of the vertical disparity requires: with residuals of 3 grey levels and slopes of 5 grey
levels per pixel its standard deviation is then 0.02 pixels, as `MIN_VERTICAL_PX`."""
MIN_VERTICAL_PX = 0.02  #: Smaller vertical disparities are not corrected, because resampling blurs the image, pixels.
MAX_STEP_PX = 0.5  #: Largest change of a coefficient in one step: the image is linear over about half a pixel.
DAMPING = 1e-6  #: Added to the diagonal of the normal equations, as a fraction of their trace: they may be singular.


class VerticalDisparity(NamedTuple):
    """A vertical disparity that is linear over the image.

    Content of the right image is `offset + tilt x + stretch y` pixels lower than in the left image, with x and y from
    -1 to 1 over the columns and the rows (`edge_x` and `edge_y` in the code).
    """

    offset_px: float  #: Mean over the image, pixels.
    tilt_px: float  #: Change from the middle to the right edge, pixels: a roll of the right camera.
    stretch_px: float  #: Change from the middle to the lower edge, pixels.

    @property
    def max_px(self) -> float:
        """Largest vertical disparity within the image, pixels."""
        return sum(abs(value) for value in self)


@dataclass(frozen=True, slots=True)
class RightImageCorrection:
    """Deviation of the right image from a rectified image of equal exposure: exposure and vertical disparity."""

    gain: float  #: Contrast of the right image over that of the left image.
    offset_grey: float  #: Grey level of the right image where that of the left image is 0.
    vertical: VerticalDisparity  #: Vertical disparity of the right image.


class CorrectedImage(NamedTuple):
    """The right image after its correction."""

    image: FloatImage  #: `(H, W)`, grey levels.
    correction: RightImageCorrection  #: The deviations that were removed.


class ResidualAndMean(NamedTuple):
    """Photometric residual and mean of a pair of images, `(H, W)` each, grey levels."""

    residual: FloatImage  #: Warped right image minus left image; NaN outside the right image.
    mean: FloatImage  #: Mean of both images; the left image outside the right one.


def correct_right_image(left: FloatImage, right: FloatImage, disparity_px: FloatImage) -> CorrectedImage:
    """Measure gain, offset and vertical disparity of the right image `(H, W)`, and return the image without them.

    The disparity without holes is correct to about a pixel.
    """
    exposure = exposure_by_disparity(left, right, disparity_px)
    equalised = (right - F(exposure.offset_grey)) * F(1.0 / exposure.gain)
    corrected = equalised
    coefficients_px = np.zeros(3)
    for _ in range(MAX_ITERATIONS):
        step_px = _vertical_step(left, corrected, disparity_px)
        coefficients_px = coefficients_px + step_px
        if np.abs(coefficients_px).sum() < MIN_VERTICAL_PX:
            break
        corrected = _without_vertical_disparity(equalised, VerticalDisparity(*coefficients_px.tolist()))
        if np.abs(step_px).sum() < MIN_VERTICAL_PX:
            break
    vertical = VerticalDisparity(*coefficients_px.tolist())
    return CorrectedImage(corrected, RightImageCorrection(exposure.gain, exposure.offset_grey, vertical))


def residual_and_mean(left: FloatImage, right: FloatImage, disparity_px: FloatImage) -> ResidualAndMean:
    """Return the photometric residual of a pair, and the mean of each left pixel and its corresponding right pixel."""
    residual = photometric_residual(left, right, disparity_px)
    known = cv2.patchNaNs(residual.copy(), 0.0)
    return ResidualAndMean(residual, np.asarray(cv2.scaleAdd(known, 0.5, left), F))


def _vertical_step(left: FloatImage, right: FloatImage, disparity_px: FloatImage) -> FloatArray:
    """Return the change `(3,)` of offset, tilt and stretch by one robust Gauss-Newton step, pixels.

    A shift of the right image's rows upwards by s changes the residual by s times the slope along the column. The step
    is 0 if too few pixels or no slopes are available.
    """
    compared = residual_and_mean(left, right, disparity_px)
    residual = compared.residual[::SAMPLING_STRIDE, ::SAMPLING_STRIDE]
    slope = cv2.Sobel(compared.mean, -1, 0, 1, scale=0.125)[::SAMPLING_STRIDE, ::SAMPLING_STRIDE]
    usable = np.isfinite(residual)
    row, column = np.nonzero(usable)
    if len(row) < MIN_ROW_PIXELS:
        return np.zeros(3)
    r = residual[usable].astype(np.float64)
    g = slope[usable].astype(np.float64)
    rows, columns = residual.shape
    weight = cauchy_weight(r, ROBUST_SIGMAS * (mad_sigma(r) + MIN_RESIDUAL_SIGMA))
    design = np.column_stack((np.ones(len(row)), 2.0 * column / columns - 1.0, 2.0 * row / rows - 1.0)) * g[:, None]
    weighted = design * weight[:, None]
    normal = weighted.T @ design
    if not normal.any():
        return np.zeros(3)
    damped = normal + DAMPING * np.trace(normal) * np.eye(3)
    step = np.linalg.solve(damped, -(weighted.T @ r))
    return np.asarray(np.clip(step, -MAX_STEP_PX, MAX_STEP_PX))


def _without_vertical_disparity(image: FloatImage, vertical: VerticalDisparity) -> FloatImage:
    """Return the right image with its rows shifted up by the vertical disparity."""
    height, width = image.shape
    edge_x = np.linspace(-1.0, 1.0, width)[None]
    edge_y = np.linspace(-1.0, 1.0, height)[:, None]
    shift = vertical.offset_px + vertical.tilt_px * edge_x + vertical.stretch_px * edge_y
    return shift_rows(image, shift.astype(F))
