"""Measurement and correction of the exposure and the vertical disparity of the right image.

In a rectified pair both images have the same exposure, and corresponding points have the same row. Real pairs deviate:
automatic exposure differs between the cameras, and the rig deforms after its calibration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatArray, FloatImage
from sfr_loc_map.mapping.disparity.exposure import Exposure, exposure_by_disparity
from sfr_loc_map.mapping.disparity.interpolation import shift_rows
from sfr_loc_map.mapping.disparity.vertical_disparity import fit_vertical_disparity

MAX_VERTICAL_STEPS = 3
"""Maximum number of Gauss-Newton steps of the vertical disparity. Each step is limited to `MAX_VERTICAL_STEP_PX`, so
that offset, tilt and stretch are corrected up to the product of both limits."""
MIN_VERTICAL_COUNT = 1000
"""Minimum number of pixels for measuring the vertical disparity. With residuals of 3 grey levels and slopes of 5 grey
levels per pixel, its standard deviation is then 0.02 pixels, equal to `MIN_VERTICAL_PX`."""
MIN_VERTICAL_PX = 0.02  #: Minimum vertical disparity that is corrected, pixels, because resampling blurs the image.
MAX_VERTICAL_STEP_PX = 0.5
"""Maximum change of a coefficient in one step, pixels: half of the range in which the linearisation is valid."""


class VerticalDisparity(NamedTuple):
    """A vertical disparity that is linear over the image.

    Content of the right image is `offset + tilt x + stretch y` pixels lower than in the left image. x and y are -1 at
    the first column and row of the right image and 1 at the last ones (`edge_x` and `edge_y` in the code).
    """

    offset_px: float  #: Mean over the image, pixels.
    tilt_px: float  #: Change from the middle to the right edge, pixels: a roll of the right camera.
    stretch_px: float  #: Change from the middle to the lower edge, pixels.

    def at(self, edge_x: FloatArray, edge_y: FloatArray) -> FloatArray:
        """Return the vertical disparity at points of the right image, pixels."""
        return self.offset_px + self.tilt_px * edge_x + self.stretch_px * edge_y

    @property
    def max_px(self) -> float:
        """Largest vertical disparity within the image, pixels."""
        return sum(abs(value) for value in self)


@dataclass(frozen=True, slots=True)
class RightImageCorrection:
    """Deviation of the right image from a rectified image of equal exposure: exposure and vertical disparity."""

    exposure: Exposure  #: Grey levels of the right image relative to the left image.
    vertical: VerticalDisparity  #: Vertical disparity of the right image; 0 if it is too small to be corrected.


class CorrectedImage(NamedTuple):
    """The right image after its correction."""

    image: FloatImage  #: `(H, W)`, grey levels.
    correction: RightImageCorrection  #: The deviations that were removed.


def correct_right_image(left: FloatImage, right: FloatImage, disparity_px: FloatImage) -> CorrectedImage:
    """Measure gain, offset and vertical disparity of the right image `(H, W)`, and return the image without them.

    A vertical disparity below `MIN_VERTICAL_PX` stays in the image and is not part of the correction. The disparity
    must be defined at every pixel and correct to about one pixel.
    """
    exposure = exposure_by_disparity(left, right, disparity_px)
    equalised = (right - F(exposure.offset_grey)) * F(1.0 / exposure.gain)
    corrected = equalised
    removed_px = np.zeros(3)
    for _ in range(MAX_VERTICAL_STEPS):
        step_px = _vertical_step(left, corrected, disparity_px)
        vertical_px = removed_px + step_px
        if np.abs(vertical_px).sum() < MIN_VERTICAL_PX:
            corrected = equalised
            removed_px = np.zeros(3)
            break
        corrected = _without_vertical_disparity(equalised, VerticalDisparity(*vertical_px.tolist()))
        removed_px = vertical_px
        if np.abs(step_px).sum() < MIN_VERTICAL_PX:
            break
    vertical = VerticalDisparity(*removed_px.tolist())
    return CorrectedImage(corrected, RightImageCorrection(exposure, vertical))


def _vertical_step(left: FloatImage, right: FloatImage, disparity_px: FloatImage) -> FloatArray:
    """Return the change `(3,)` of offset, tilt and stretch by one step, pixels; 0 if it cannot be measured."""
    rows, columns = left.shape

    def shapes(column: FloatArray, row: FloatArray) -> tuple[FloatArray, ...]:
        """Return the shapes of offset, tilt and stretch."""
        return np.ones(len(column)), 2.0 * column / (columns - 1) - 1.0, 2.0 * row / (rows - 1) - 1.0

    fit = fit_vertical_disparity(left, right, disparity_px, shapes, MIN_VERTICAL_COUNT)
    if fit is None:
        return np.zeros(3)
    return np.asarray(np.clip(fit.coefficients_px, -MAX_VERTICAL_STEP_PX, MAX_VERTICAL_STEP_PX))


def _without_vertical_disparity(image: FloatImage, vertical: VerticalDisparity) -> FloatImage:
    """Return the right image with its rows shifted up by the vertical disparity."""
    height, width = image.shape
    edge_x = np.linspace(-1.0, 1.0, width)[None]
    edge_y = np.linspace(-1.0, 1.0, height)[:, None]
    return shift_rows(image, vertical.at(edge_x, edge_y).astype(F))
