"""How the right camera differs from its calibration: exposure and rows, which are corrected, and its rotation.

A camera that is rotated by the small angles `w` about its axes (x right, y down, z forward) sees the point `(x, y)`,
normalised, at `x - wy (1 + x^2) + wz y + wx x y`, `y + wx (1 + y^2) - wz x - wy x y` (first order). Along rows that is
an error of the disparity, which no pair can tell from depth. Across rows it is vertical disparity, which can be
measured: yaw as a saddle, roll as a tilt, pitch as an offset. An offset may as well be that of the principal point,
which leaves rows alone. What is left of a lens's distortion has any of these shapes as well. It errs along rows by
about as much as across them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.disparity.filters import mad_sigma
from sfr_loc_map.mapping.disparity.photometric_residual import photometric_residual, shift_rows

F = np.float32

STRIDE = 3  #: Every third pixel of every third row is used: a hundred thousand are plenty.
ITERATIONS = 3
MIN_GREY, MAX_GREY = 2.0, 253.0
"""Grey levels beyond which a pixel may be saturated and does not count for the exposure."""
MIN_SPREAD = 8.0  #: Grey levels that an image must span for its contrast to be compared.
MIN_EXPOSURE_PIXELS, MIN_ROW_PIXELS, MIN_ROTATION_PIXELS = 100, 1000, 5000
MIN_OFFSET_PX = 0.02
"""Rows are resampled only for more than this: resampling blurs, a hundredth of a pixel does not matter."""
MAX_STEP_PX = 0.5
TAIL = 2.0  #: Residuals of so many standard deviations have half their weight.
DIFFERENCE, SMOOTHING = np.array([[-1.0, 0.0, 1.0]], F), np.array([[0.125, 0.25, 0.125]], F)
"""Taps of the Sobel operator, which gives grey levels per pixel."""
MIN_ROLL_PX = 0.05
"""Vertical disparity at the edge of the image from which on a roll is compensated; less is within the measurement."""


@dataclass(frozen=True, slots=True)
class RectificationCorrection:
    """How the right image differs from a rectified, equally exposed one."""

    gain: float  #: Its contrast over that of the left image.
    offset: float  #: Its brightness where the left image's is 0, grey levels.
    #: Vertical disparity: its content lies lower than the left's by `vertical_px[0] + vertical_px[1] x +
    #: vertical_px[2] y` pixels, x and y from -1 to 1 over the left image.
    vertical_px: tuple[float, float, float]

    @property
    def max_vertical_px(self) -> float:
        """Largest vertical disparity within the image, pixels."""
        return sum(abs(value) for value in self.vertical_px)


def correct_rectification(
    left: FloatImage, right: FloatImage, disparity_px: FloatImage
) -> tuple[RectificationCorrection, FloatImage]:
    """Measure gain, offset and vertical disparity; return them with the corrected right image."""
    gain, offset = _exposure(left, right, disparity_px)
    equalised = (right - F(offset)) * F(1.0 / gain)
    corrected, vertical = equalised, np.zeros(3)
    for _ in range(ITERATIONS):
        step = _vertical_step(left, corrected, disparity_px)
        vertical += step
        if np.abs(vertical).sum() < MIN_OFFSET_PX:
            break
        corrected = _shifted_up(equalised, vertical)
        if np.abs(step).sum() < MIN_OFFSET_PX:
            break
    constant, tilt_x, tilt_y = (float(value) for value in vertical)
    return RectificationCorrection(gain, offset, (constant, tilt_x, tilt_y)), corrected


def _exposure(left: FloatImage, right: FloatImage, disparity: FloatImage) -> tuple[float, float]:
    """Return gain and offset of the right image against the left, from the spread of their common grey levels."""
    rows = [np.ascontiguousarray(image[::4]) for image in (left, right, disparity)]
    a = left[::4, ::4]
    b = photometric_residual(*rows)[:, ::4] + a
    usable = (a > MIN_GREY) & (a < MAX_GREY) & (b > MIN_GREY) & (b < MAX_GREY)
    if usable.sum() < MIN_EXPOSURE_PIXELS:
        return 1.0, 0.0
    low_a, middle_a, high_a = np.quantile(a[usable], (0.1, 0.5, 0.9))
    low_b, middle_b, high_b = np.quantile(b[usable], (0.1, 0.5, 0.9))
    if high_a - low_a < MIN_SPREAD:
        return 1.0, float(middle_b - middle_a)
    gain = float(np.clip((high_b - low_b) / (high_a - low_a), 0.25, 4.0))
    return gain, float(middle_b - gain * middle_a)


def _vertical_step(left: FloatImage, right: FloatImage, disparity: FloatImage) -> FloatArray:
    """Return the change of the vertical disparity by one weighted least squares step over the whole image.

    Shifting the right image's content up by s changes the residual by `s` times the slope along columns. The step is 0
    where there is too little to measure it by.
    """
    residual, mean = _residual_and_mean(left, right, disparity)
    residual, slope = residual[::STRIDE, ::STRIDE], cv2.Sobel(mean, -1, 0, 1, scale=0.125)[::STRIDE, ::STRIDE]
    usable = np.isfinite(residual)
    y, x = np.nonzero(usable)
    if len(y) < MIN_ROW_PIXELS:
        return np.zeros(3)
    r, g = residual[usable].astype(np.float64), slope[usable].astype(np.float64)
    weight = 1.0 / (1.0 + (r / (TAIL * (mad_sigma(r) + 1e-3))) ** 2)
    design = np.column_stack((np.ones(len(y)), 2.0 * x / residual.shape[1] - 1.0, 2.0 * y / residual.shape[0] - 1.0))
    design *= g[:, None]
    weighted = design * weight[:, None]
    normal = weighted.T @ design
    if not normal.any():  # no slope anywhere
        return np.zeros(3)
    step = np.linalg.solve(normal + 1e-6 * np.trace(normal) * np.eye(3), -(weighted.T @ r))
    return np.asarray(np.clip(step, -MAX_STEP_PX, MAX_STEP_PX))


def _residual_and_mean(left: FloatImage, right: FloatImage, disparity: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Return the residual `(H, W)`, and the mean of each left pixel and its partner: the left one without a partner."""
    residual = photometric_residual(left, right, disparity)
    known = cv2.patchNaNs(residual.copy(), 0.0)
    return residual, np.asarray(cv2.scaleAdd(known, 0.5, left), F)


def _shifted_up(image: FloatImage, vertical: FloatArray) -> FloatImage:
    height, width = image.shape
    y, x = np.linspace(-1.0, 1.0, height)[:, None], np.linspace(-1.0, 1.0, width)[None]
    return shift_rows(image, (vertical[0] + vertical[1] * x + vertical[2] * y).astype(F))


@dataclass(frozen=True, slots=True)
class CameraRotation:
    """Rotation of the right camera against its calibration."""

    yaw_rad: float  #: About y; positive turns it to the right.
    yaw_sigma_rad: float  #: Standard deviation of the yaw.
    roll_rad: float  #: About z; positive turns it clockwise.
    pitch_rad: float  #: About x; positive turns it up. It is the rotation that the vertical offset amounts to.
    vertical_px: float  #: Root mean square of the vertical disparity over the image.
    bent_px: float  #: That of what is neither an offset nor a roll.


def camera_rotation(
    left: FloatImage,
    right: FloatImage,
    disparity_px: FloatImage,
    valid: Mask,
    vertical_px: tuple[float, float, float],
    rig: StereoRig,
) -> CameraRotation:
    """Return the rotation that the vertical disparity of a pair shows; of too few pixels a yaw of 0, sigma infinite.

    The correction of the right image has taken out an offset and tilts, `vertical_px`; what is left, the coefficients
    of 1, x, y, x y, y^2, is fitted with them and the saddle of a yaw.
    """
    fit, deviation = np.zeros(5), np.full(5, np.inf)
    residual, mean = _residual_and_mean(left, right, disparity_px)
    slope = cv2.filter2D(cv2.filter2D(mean, -1, DIFFERENCE.T)[::STRIDE], -1, SMOOTHING)[:, ::STRIDE]
    residual = residual[::STRIDE, ::STRIDE]
    usable = np.isfinite(residual) & valid[::STRIDE, ::STRIDE]
    v, u = np.nonzero(usable)
    if len(v) >= MIN_ROTATION_PIXELS:
        r, g = residual[usable].astype(np.float64), slope[usable].astype(np.float64)
        disparity = disparity_px[::STRIDE, ::STRIDE][usable]
        x, y = (u * STRIDE - disparity - rig.cx) / rig.fx, (v * STRIDE - rig.cy) / rig.fy
        sigma = mad_sigma(r) + 1e-3
        weight = 1.0 / (1.0 + np.square(r / (TAIL * sigma)))
        design = np.column_stack((np.ones(len(x)), x, y, x * y, y * y)) * g[:, None]
        weighted = design * weight[:, None]
        normal = weighted.T @ design
        normal += 1e-12 * (np.trace(normal) + 1.0) * np.eye(5)
        inverse = np.linalg.inv(normal)
        fit, deviation = -(inverse @ (weighted.T @ r)), sigma * np.sqrt(np.diag(inverse))
    offset_px, tilt_px, stretch_px = vertical_px
    v, u = np.mgrid[-1.0:1.0:16j, -1.0:1.0:16j]
    x, y = 0.5 * rig.width * u / rig.fx, 0.5 * rig.height * v / rig.fy
    bent = fit[2] * y + fit[3] * x * y + fit[4] * y * y + stretch_px * v
    field = fit[0] + fit[1] * x + offset_px + tilt_px * u + bent
    return CameraRotation(
        yaw_rad=-float(fit[3]) / rig.fy,
        yaw_sigma_rad=float(deviation[3]) / rig.fy,
        roll_rad=-2.0 * tilt_px / rig.width - float(fit[1]) / rig.fy,
        pitch_rad=(offset_px + float(fit[0])) / rig.fy,
        vertical_px=float(np.sqrt(np.mean(np.square(field)))),
        bent_px=float(np.std(bent)),
    )


def without_roll(disparity_px: FloatImage, rotation: CameraRotation, rig: StereoRig) -> FloatImage:
    """Return disparities `(H, W)` without what a roll of the right camera adds to them, `-roll fy y`.

    Less roll than shifts rows by `MIN_ROLL_PX` at the edges is left as it is.
    """
    if abs(rotation.roll_rad) * 0.5 * rig.width < MIN_ROLL_PX:
        return disparity_px
    rows = np.arange(rig.height, dtype=np.float64) - rig.cy
    return np.asarray(disparity_px + F(rotation.roll_rad) * rows.astype(F)[:, None], F)
