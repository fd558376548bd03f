"""The rotation of the right camera relative to its calibration, from the vertical disparity of a pair.

A camera that is rotated by the small angles `w` about its axes (x right, y down, z forward) observes the point
`(x, y)`, in normalised coordinates, to first order at

    x' = x - wy (1 + x^2) + wz y + wx x y
    y' = y + wx (1 + y^2) - wz x - wy x y

The change of x is a disparity error, which cannot be distinguished from depth. The change of y is vertical disparity,
which is measured. A yaw (wy) causes the saddle `x y`, a roll (wz) causes a tilt, and a pitch (wx) causes an offset. An
offset of the principal point changes y like a pitch, but does not change x. Residual lens distortion can have any of
these shapes, and its effect on x is about as large as its effect on y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.disparity.disparity_map import DisparityMap
from sfr_loc_map.mapping.disparity.vertical_disparity import fit_vertical_disparity

MIN_ROTATION_COUNT = 5000
"""Minimum number of valid samples for measuring the rotation: five times that of the correction, because there are five
coefficients, of which the saddle is the least observable."""
MIN_ROTATION_PX = 0.05
"""Minimum vertical disparity at the image edge that counts as a rotation, pixels. Smaller values are measurement noise
(about 0.02 pixels) or residual distortion."""
GRID_POINTS = 16  #: Rows and columns of the grid over which the quadratic vertical disparity is averaged.


@dataclass(frozen=True, slots=True)
class CameraRotation:
    """Rotation of the right camera relative to its calibration, and the underlying vertical disparity."""

    yaw_rad: float  #: About y; a positive yaw turns the camera to the right. 0 if too few pixels are valid.
    yaw_sigma_rad: float  #: Standard deviation of the yaw; infinite if too few pixels are valid.
    roll_rad: float  #: About z; a positive roll turns the camera clockwise.
    pitch_rad: float  #: About x; a positive pitch turns the camera up. Equivalent to the vertical offset.
    vertical_rms_px: float  #: Root mean square of the vertical disparity over the image.
    distortion_rms_px: float  #: Root mean square of the vertical disparity without its offset and roll.

    @property
    def is_measured(self) -> bool:
        """Whether enough pixels were valid; otherwise only the vertical disparity that was removed is known."""
        return math.isfinite(self.yaw_sigma_rad)


class VerticalPolynomial(NamedTuple):
    """A vertical disparity `constant + along_x x + along_y y + saddle x y + square y^2`, pixels.

    x and y are normalised coordinates in the right image.
    """

    constant: float
    along_x: float
    along_y: float
    saddle: float
    square: float

    def at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the vertical disparity at points of the right image, pixels."""
        return self.constant + self.along_x * x + self.along_y * y + self.saddle * x * y + self.square * y * y


class RemainingDisparity(NamedTuple):
    """The vertical disparity that remains after the correction of the right image."""

    polynomial: VerticalPolynomial  #: Fitted polynomial; 0 if too few pixels are valid.
    saddle_sigma_px: float  #: Standard deviation of the saddle; infinite if too few pixels are valid.


def measure_right_rotation(disparity_map: DisparityMap, rig: StereoRig) -> CameraRotation:
    """Return the rotation that explains the vertical disparity of a pair.

    The vertical disparity is the sum of two parts. The part that the correction has removed is linear over the image
    (-1 to 1 along both axes, `edge_x` and `edge_y`). The part that remains is a polynomial of normalised coordinates
    (x, y).
    """
    removed = disparity_map.correction.vertical
    remaining, saddle_sigma_px = _remaining_disparity(disparity_map, rig)
    from_edge_to_edge = np.linspace(-1.0, 1.0, GRID_POINTS)
    edge_x, edge_y = np.meshgrid(from_edge_to_edge, from_edge_to_edge)
    column = 0.5 * (edge_x + 1.0) * (rig.width - 1)
    row = 0.5 * (edge_y + 1.0) * (rig.height - 1)
    x, y = np.moveaxis(rig.camera.normalised(np.stack((column, row), axis=-1)), -1, 0)
    vertical = remaining.at(x, y) + removed.at(edge_x, edge_y)
    stretch = removed._replace(offset_px=0.0, tilt_px=0.0)
    shape = remaining._replace(constant=0.0, along_x=0.0)
    distortion = shape.at(x, y) + stretch.at(edge_x, edge_y)  # vertical disparity without its offset and roll
    return CameraRotation(
        yaw_rad=-remaining.saddle / rig.fy,
        yaw_sigma_rad=saddle_sigma_px / rig.fy,
        roll_rad=-2.0 * removed.tilt_px / (rig.width - 1) * (rig.fx / rig.fy) - remaining.along_x / rig.fy,
        pitch_rad=(removed.offset_px + remaining.constant) / rig.fy,
        vertical_rms_px=float(np.sqrt(np.mean(np.square(vertical)))),
        distortion_rms_px=float(np.std(distortion)),
    )


def _remaining_disparity(disparity_map: DisparityMap, rig: StereoRig) -> RemainingDisparity:
    """Return the vertical disparity of the corrected images, measured at valid pixels."""

    def shapes(column: FloatArray, row: FloatArray) -> tuple[FloatArray, ...]:
        """Return the terms of a `VerticalPolynomial`."""
        x, y = rig.camera.normalised(np.column_stack((column, row))).T
        return np.ones(len(x)), x, y, x * y, y * y

    fit = fit_vertical_disparity(
        disparity_map.left, disparity_map.right, disparity_map.px, shapes, MIN_ROTATION_COUNT, disparity_map.valid
    )
    if fit is None:
        return RemainingDisparity(VerticalPolynomial(0.0, 0.0, 0.0, 0.0, 0.0), math.inf)
    sigmas = VerticalPolynomial(*fit.sigmas_px.tolist())
    return RemainingDisparity(VerticalPolynomial(*fit.coefficients_px.tolist()), sigmas.saddle)


def without_roll(disparity_map: DisparityMap, rotation: CameraRotation, rig: StereoRig) -> DisparityMap:
    """Return the map without the error `-roll fx y` that a roll of the right camera causes in the disparities.

    The result has the disparities of a right camera without roll, which no longer fit the right image. A roll that
    shifts the rows by less than `MIN_ROTATION_PX` at the image edge is not compensated.
    """
    if abs(rotation.roll_rad) * 0.5 * rig.width * (rig.fy / rig.fx) < MIN_ROTATION_PX:
        return disparity_map
    rows_below_centre = (np.arange(rig.height, dtype=np.float64) - rig.cy).astype(F)
    px_per_row = F(rotation.roll_rad * (rig.fx / rig.fy))
    error_px = -px_per_row * rows_below_centre[:, None]
    return replace(disparity_map, px=np.asarray(disparity_map.px - error_px, F))
