"""The rotation of the right camera relative to its calibration, from the vertical disparity of a pair.

A camera that is rotated by the small angles `w` about its axes (x right, y down, z forward) observes the point
`(x, y)`, in normalised coordinates, to first order at

    x' = x - wy (1 + x^2) + wz y + wx x y
    y' = y + wx (1 + y^2) - wz x - wy x y

The change of x is a disparity error, which cannot be distinguished from depth. The change of y is vertical disparity,
which is measured. A yaw (wy) causes the saddle `x y`, a roll (wz) causes a tilt, and a pitch (wx) causes an offset. An
offset of the principal point changes y like a pitch, but does not change x. Residual lens distortion can have any of
these shapes, and its effect on x is about as large as its effect on y.

A large yaw is measured twice. The first fit ignores that the disparities have already explained a part of the vertical
disparity, and returns 60 to 80 % of a large yaw. If the vertical disparity that neither offset nor roll explains is at
least `MIN_ROTATION_PX`, `fit_jointly_with_disparity` therefore repeats the measurement in `REPEATED_STEPS` steps. On
the development panorama and the sample, with the right camera rotated by 0.3 to 1 deg, the repeated measurement returns
95 to 106 % of the yaw.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.disparity.right_camera.vertical_disparity import (
    ALL_TERMS,
    VerticalFit,
    VerticalPolynomial,
    fit_jointly_with_disparity,
    fit_vertical_disparity,
    without_vertical_disparity,
)
from sfr_loc_map.mapping.disparity.surfaces import DisparityScene

MIN_ROTATION_COUNT = 5000  #: Minimum number of valid samples for measuring the rotation.
MIN_ROTATION_PX = 0.05
"""Minimum vertical disparity that counts as a rotation, pixels. The threshold applies to the standard deviation over
the image for a yaw, to the shift of the rows at the image edge for a roll, and to the offset for a pitch
(`calibration_sigma`)."""
REPEATED_STEPS = 3  #: Gauss-Newton steps of the repeated measurement.
YAW_BIAS_FRACTION = 0.05
"""Standard deviation of the bias that remains in a repeated measurement of the yaw, as a fraction of the yaw."""
GRID_POINTS = 16  #: Rows and columns of the grid over which the vertical disparity is averaged.


@dataclass(frozen=True, slots=True)
class CameraRotation:
    """Rotation of the right camera relative to its calibration, and the underlying vertical disparity.

    The angles are the components of the rotation `w` of the camera about its axes. `FaultKind` compares their signs
    with the signs of injected faults.
    """

    yaw_rad: float  #: About y; a positive yaw turns the camera to the right. 0 if too few pixels are valid.
    #: Standard deviation of the yaw from image noise and, in a repeated measurement, from the remaining bias
    #: (`YAW_BIAS_FRACTION`). Residual distortion is not included. None if too few pixels are valid: the rotation is
    #: then not measured, and only the vertical disparity that was removed is known.
    yaw_sigma_rad: float | None
    roll_rad: float  #: About z; a positive roll turns the camera clockwise.
    pitch_rad: float  #: About x; a positive pitch turns the camera up. Equivalent to the vertical offset.
    vertical_rms_px: float  #: Root mean square of the vertical disparity over the image.
    #: Standard deviation over the image of the part of the vertical disparity that neither offset nor roll explains.
    distortion_rms_px: float


def measure_right_rotation(scene: DisparityScene, removed: VerticalPolynomial, rig: StereoRig) -> CameraRotation:
    """Return the rotation that explains the vertical disparity of a pair.

    The vertical disparity is the sum of `removed`, which the correction has removed from the right image, and of the
    part that remains, which is fitted at valid pixels. The valid pixels must be measured, not filled.
    """
    fit = fit_vertical_disparity(
        scene.left,
        scene.right,
        scene.disparity,
        rig.camera,
        term_count=ALL_TERMS,
        min_count=MIN_ROTATION_COUNT,
        used=scene.valid,
    )
    if fit is None:
        return _rotation_of(removed, None, rig)
    rotation = _rotation_of(removed.plus(fit.polynomial), fit.sigmas.saddle / rig.fy, rig)
    if rotation.distortion_rms_px < MIN_ROTATION_PX:
        return rotation
    repeated = _repeated_fit(scene, rig)
    if repeated is None:
        return rotation
    vertical = removed.plus(repeated.polynomial)
    yaw_bias_rad = YAW_BIAS_FRACTION * _yaw_rad(vertical, rig)
    return _rotation_of(vertical, math.hypot(repeated.sigmas.saddle / rig.fy, yaw_bias_rad), rig)


def _repeated_fit(scene: DisparityScene, rig: StereoRig) -> VerticalFit | None:
    """Return the remaining vertical disparity of a pair, fitted jointly with its disparities; None if a step fails."""
    remaining = VerticalPolynomial()
    sigmas = VerticalPolynomial()
    for _ in range(REPEATED_STEPS):
        right = without_vertical_disparity(scene.right, remaining, rig.camera)
        step = fit_jointly_with_disparity(
            scene.left, right, scene.disparity, rig.camera, scene.valid, min_count=MIN_ROTATION_COUNT
        )
        if step is None:
            return None
        remaining = remaining.plus(step.polynomial)
        sigmas = step.sigmas
    return VerticalFit(remaining, sigmas)


def _yaw_rad(vertical: VerticalPolynomial, rig: StereoRig) -> float:
    """Return the yaw that explains the saddle of a vertical disparity."""
    return -vertical.saddle / rig.fy


def _rotation_of(vertical: VerticalPolynomial, yaw_sigma_rad: float | None, rig: StereoRig) -> CameraRotation:
    """Return the rotation that explains a vertical disparity."""
    without_offset_and_roll = vertical._replace(constant=0.0, along_x=0.0)
    columns = np.linspace(0.0, rig.width - 1.0, GRID_POINTS)[None]
    rows = np.linspace(0.0, rig.height - 1.0, GRID_POINTS)[:, None]
    vertical_px = vertical.at_pixels(columns, rows, rig.camera)
    distortion_px = without_offset_and_roll.at_pixels(columns, rows, rig.camera)
    return CameraRotation(
        yaw_rad=_yaw_rad(vertical, rig),
        yaw_sigma_rad=yaw_sigma_rad,
        roll_rad=-vertical.along_x / rig.fy,
        pitch_rad=vertical.constant / rig.fy,
        vertical_rms_px=float(np.sqrt(np.mean(np.square(vertical_px)))),
        distortion_rms_px=float(np.std(distortion_px)),  # the terms in y^2 and x y have a mean, too
    )


def roll_error_px(rotation: CameraRotation, rig: StereoRig) -> FloatImage:
    """Return the error `-roll fx y` that a roll of the right camera causes in the disparities of each row `(H, 1)`.

    A roll that shifts the rows by less than `MIN_ROTATION_PX` at the image edge counts as 0. After this error is
    subtracted, the disparities are correct for depths but no longer fit the right image.
    """
    rows_below_centre = (np.arange(rig.height, dtype=np.float64) - rig.cy).astype(F)[:, None]
    if abs(rotation.roll_rad) * 0.5 * rig.width * (rig.fy / rig.fx) < MIN_ROTATION_PX:
        return np.zeros_like(rows_below_centre)
    px_per_row = F(rotation.roll_rad * (rig.fx / rig.fy))
    return -px_per_row * rows_below_centre
