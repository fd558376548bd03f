"""Rectification of raw images as sensor_msgs/CameraInfo (D, K, R, P) and OpenCV have it; maps are made once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import SIDES, refusing
from sfr_loc_map.io.camera_info import baseline_from_projection, rig_from_camera_info

Rectify = Callable[[GreyImage, GreyImage], tuple[GreyImage, GreyImage]]
COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,), "fisheye": (4,)}
"""Models of distortion that are known, and how many coefficients they may have."""
FISHEYE = ("equidistant", "fisheye")
RECTIFIED_TOLERANCE = 1e-9
"""Calibrated cameras that differ from a rectified pair by no more, in radians and metres, are one."""


@dataclass(frozen=True, slots=True)
class RawCamera:
    """The calibration of a camera whose images are not rectified: distortion, K, R and P of sensor_msgs/CameraInfo."""

    size: tuple[int, int]
    """Width and height, pixels."""
    model: str
    d: tuple[float, ...]
    k: tuple[float, ...]
    r: tuple[float, ...]
    p: tuple[float, ...]

    @classmethod
    def of(cls, name: str, info: Any) -> RawCamera:  # noqa: ANN401 - a CameraInfo of any library
        """Return the calibration that a sensor_msgs/CameraInfo gives; `name` says whose (`loc/left`)."""
        lists = (np.asarray(values, np.float64).reshape(-1).tolist() for values in (info.d, info.k, info.r, info.p))
        d, k, r, p = (tuple(values) for values in lists)
        model = str(info.distortion_model)
        if not model and not any(d):
            model = "plumb_bob"
        if model not in COEFFICIENTS:
            known = ", ".join(COEFFICIENTS)
            raise InputError(f"{name}/camera_info has distortion model '{model[:40]}': one of {known} can be rectified")
        d = d or (0.0,) * COEFFICIENTS[model][0]  # none at all are those of a lens without distortion
        if len(d) not in COEFFICIENTS[model]:
            wanted = " or ".join(map(str, COEFFICIENTS[model]))
            raise InputError(f"{name}/camera_info has {len(d)} coefficients d: model {model} needs {wanted}")
        roi = info.roi
        whole = (roi.width, roi.height) in ((0, 0), (info.width, info.height)) and not (roi.x_offset or roi.y_offset)
        if not whole or info.binning_x > 1 or info.binning_y > 1:
            raise InputError(
                f"{name}/camera_info has binning or a region of interest: send whole images to be rectified"
            )
        if not np.isfinite([*d, *k, *r, *p]).all() or k[0] <= 0.0 or k[4] <= 0.0 or p[0] <= 0.0:
            raise InputError(f"{name}/camera_info has no k or p, or numbers that are not finite: calibrate the camera")
        r = r if any(r) else tuple(np.eye(3).reshape(-1).tolist())
        rotation = np.reshape(r, (3, 3))
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
            raise InputError(f"{name}/camera_info: r is not a rotation: calibrate the pair")
        return cls((int(info.width), int(info.height)), model, d, k, r, p)

    def maps(self) -> Sequence[Any]:
        """Return OpenCV's fixed-point maps, of 1/32 pixel, from the pixels of the rectified image to the raw one."""
        k, r, p = np.reshape(self.k, (3, 3)), np.reshape(self.r, (3, 3)), np.reshape(self.p, (3, 4))[:, :3]
        make = cv2.fisheye.initUndistortRectifyMap if self.model in FISHEYE else cv2.initUndistortRectifyMap
        return make(k, np.array(self.d), r, p, self.size, cv2.CV_16SC2)

    @property
    def rectified_info(self) -> SimpleNamespace:
        """What the camera_info of the rectified images says."""
        width, height = self.size
        return SimpleNamespace(width=width, height=height, d=(), k=np.zeros(9), r=np.zeros(9), p=self.p)


class StereoRectifier:
    """Rectifies the pairs of two cameras, left and right."""

    def __init__(self, cameras: tuple[RawCamera, RawCamera]) -> None:
        self.cameras = cameras
        self._maps = tuple(camera.maps() for camera in cameras)

    def rectify(self, left: GreyImage, right: GreyImage) -> tuple[GreyImage, GreyImage]:
        """Return the rectified images; what no raw pixel shows is 0."""
        return _remapped(left, self._maps[0]), _remapped(right, self._maps[1])


def rectified_rig(
    infos: Sequence[Any], name: str, before: StereoRectifier | None = None, T_rb_sb: Transform | None = None
) -> tuple[StereoRig, StereoRectifier]:
    """Return the rig of two raw CameraInfo (`loc` or `nav`) and its rectifier, `before` if it is of these cameras."""
    left, right = (RawCamera.of(f"{name}/{side}", info) for side, info in zip(SIDES, infos, strict=True))
    rig = rig_from_camera_info(left.rectified_info, right.rectified_info, name, T_rb_sb)
    if before is not None and before.cameras == (left, right):
        return rig, before
    return rig, StereoRectifier((left, right))


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedCamera:
    """A camera of a data set, before rectification."""

    size: tuple[int, int]
    """Width and height of its images, pixels."""
    k: FloatArray
    """`(3, 3)` camera matrix, pixel centres at whole numbers."""
    distortion: FloatArray
    """Radial-tangential coefficients k1 k2 p1 p2 (k3) of OpenCV."""
    T_body_cam: Transform


def rectified_pair(name: str, left: CalibratedCamera, right: CalibratedCamera) -> tuple[StereoRig, Rectify | None]:
    """Return the rectified rig and what rectifies images (Bouguet, no black rim), None where nothing need be done."""
    if left.size != right.size:
        raise InputError(f"{name}: the left camera is {left.size}, the right {right.size}: both need one size")
    T_left_right = left.T_body_cam.inverse() @ right.T_body_cam
    across = T_left_right.translation
    off = max(float(np.abs(T_left_right.rotation - np.eye(3)).max()), float(np.abs(across[1:]).max()))
    plain = not left.distortion.any() and not right.distortion.any() and np.array_equal(left.k, right.k)
    if plain and off <= RECTIFIED_TOLERANCE and across[0] > 0.0:
        baseline = round(float(across[0]), 12)  # without what the product of poses adds
        return _rig_in_body(name, left, left.k, baseline, left.T_body_cam), None
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
    T_body_left = Transform(left.T_body_cam.rotation @ r_left.T, left.T_body_cam.translation)
    baseline = baseline_from_projection(float(p_left[0, 0]), float(p_right[0, 3]))
    rig = _rig_in_body(name, left, p_left, baseline, T_body_left)
    maps = [
        cv2.initUndistortRectifyMap(camera.k, camera.distortion, rotation, p[:, :3], camera.size, cv2.CV_32FC1)
        for camera, rotation, p in ((left, r_left, p_left), (right, r_right, p_right))
    ]
    return rig, lambda one, other: (_remapped(one, maps[0]), _remapped(other, maps[1]))


def _rig_in_body(
    name: str, camera: CalibratedCamera, k: FloatArray, baseline_m: float, T_body_left: Transform
) -> StereoRig:
    with refusing(f"{name}: the cameras cannot be rectified", "correct the calibration"):
        fx, fy, cx, cy = (float(k[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        rig = StereoRig(*camera.size, fx, fy, cx, cy, baseline_m)
        T_rb_sb = T_body_left @ rig.T_sb_left.inverse()
        return replace(rig, T_rb_sb=Transform.from_quat(T_rb_sb.translation, T_rb_sb.quat_xyzw))


def _remapped(image: GreyImage, maps: Sequence[Any]) -> GreyImage:
    return np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR), np.uint8)
