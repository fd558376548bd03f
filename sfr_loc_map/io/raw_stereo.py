"""Two calibrated cameras whose images are not rectified: the rig that they become, and what rectifies their images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.camera_info import baseline_from_projection

Maps = tuple[NDArray[np.float32], NDArray[np.float32]]
Rectify = Callable[[GreyImage, GreyImage], tuple[GreyImage, GreyImage]]
RECTIFIED_TOLERANCE = 1e-9
"""Cameras that differ from a rectified pair by no more, in radians and metres, are one."""


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedCamera:
    """A camera.

    Attributes:
        size: Width and height of its images, pixels.
        k: `(3, 3)` camera matrix, pixel centres at whole numbers.
        distortion: Radial-tangential coefficients k1 k2 p1 p2 (k3) of OpenCV.
        T_body_cam: Takes points in its optical frame to the body.
    """

    size: tuple[int, int]
    k: FloatArray
    distortion: FloatArray
    T_body_cam: Transform


def rectified_pair(name: str, left: CalibratedCamera, right: CalibratedCamera) -> tuple[StereoRig, Rectify]:
    """Return the rectified rig, with the pose of the bench in the body, and what rectifies images.

    Images of cameras that are a rectified pair already are left as they are.

    Raises:
        InputError: If the cameras differ in size, or cannot be rectified side by side.
    """
    if left.size != right.size:
        raise InputError(f"{name}: the left camera is {left.size}, the right {right.size}: both need one size")
    rig = _rectified_rig(name, left, right)
    if rig is not None:
        return rig, lambda one, other: (one, other)
    rig, maps = _rectification(name, left, right)

    def rectify(one: GreyImage, other: GreyImage) -> tuple[GreyImage, GreyImage]:
        images = [
            cv2.remap(image, column, row, cv2.INTER_LINEAR)
            for image, (column, row) in zip((one, other), maps, strict=True)
        ]
        return np.asarray(images[0], np.uint8), np.asarray(images[1], np.uint8)

    return rig, rectify


def _rectified_rig(name: str, left: CalibratedCamera, right: CalibratedCamera) -> StereoRig | None:
    """Return the rig of images that are rectified already, None where they are not."""
    T_left_right = left.T_body_cam.inverse() @ right.T_body_cam
    across = T_left_right.translation
    off = max(float(np.abs(T_left_right.rotation - np.eye(3)).max()), float(np.abs(across[1:]).max()))
    plain = not left.distortion.any() and not right.distortion.any() and np.array_equal(left.k, right.k)
    if not plain or off > RECTIFIED_TOLERANCE or not across[0] > 0.0:
        return None
    fx, cx, fy, cy = (float(left.k[i]) for i in ((0, 0), (0, 2), (1, 1), (1, 2)))
    try:
        rig = StereoRig(*left.size, fx, fy, cx, cy, round(float(across[0]), 12))  # what the product of poses adds
    except GeometryError as error:
        raise InputError(f"{name}: {error}; correct its calibration") from error
    return _with_body(name, rig, left.T_body_cam)


def _rectification(name: str, left: CalibratedCamera, right: CalibratedCamera) -> tuple[StereoRig, list[Maps]]:
    """Return the rectified rig and, for left and right, the maps for `cv2.remap` (Bouguet's method, no black rim)."""
    T_right_left = right.T_body_cam.inverse() @ left.T_body_cam
    rotations_and_projections = cv2.stereoRectify(
        *(left.k, left.distortion, right.k, right.distortion, left.size),
        *(T_right_left.rotation, T_right_left.translation),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0,
    )
    r_left, r_right, p_left, p_right = (np.asarray(m, np.float64) for m in rotations_and_projections[:4])
    if not p_right[0, 3] < 0 or p_right[1, 3] != 0:
        raise InputError(f"{name}: cam1 is not to the right of cam0; are the cameras swapped or one above the other?")
    fx, fy, cx, cy = (float(p_left[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    baseline = baseline_from_projection(fx, float(p_right[0, 3]))
    try:
        rig = StereoRig(*left.size, fx, fy, cx, cy, baseline)
    except GeometryError as error:
        raise InputError(f"{name}: the cameras cannot be rectified: {error}") from error
    T_body_left = Transform(left.T_body_cam.rotation @ r_left.T, left.T_body_cam.translation)
    cameras = ((left, r_left, p_left), (right, r_right, p_right))
    return _with_body(name, rig, T_body_left), [_maps(*camera) for camera in cameras]


def _with_body(name: str, rig: StereoRig, T_body_left: Transform) -> StereoRig:
    T_rb_sb = T_body_left @ rig.T_sb_left.inverse()
    try:
        return replace(rig, T_rb_sb=Transform.from_quat(T_rb_sb.translation, T_rb_sb.quat_xyzw))
    except GeometryError as error:
        raise InputError(f"{name}: the cameras cannot be rectified: {error}") from error


def _maps(camera: CalibratedCamera, rotation: FloatArray, projection: FloatArray) -> Maps:
    """Return the column and row, in the image as taken, of each pixel of the rectified one."""
    args = (camera.k, camera.distortion, rotation, projection[:, :3], camera.size, cv2.CV_32FC1)
    columns, rows = cv2.initUndistortRectifyMap(*args)
    return np.asarray(columns, np.float32), np.asarray(rows, np.float32)
