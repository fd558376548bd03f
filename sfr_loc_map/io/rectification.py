"""Rectification of raw images by the D, K, R and P of their camera_info.

The formulae are those of sensor_msgs/CameraInfo, which are OpenCV's. Maps are made once for each calibration; a pixel
is the bilinear mean of four, with weights of 1/32 pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.resampling import Resampler, warm_up

COEFFICIENTS: dict[str, tuple[int, ...]] = {
    "plumb_bob": (4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
    "fisheye": (4,),
}
"""Models of distortion that are known, and how many coefficients they may have."""
FISHEYE = ("equidistant", "fisheye")


@dataclass(frozen=True, slots=True)
class RawCamera:
    """The calibration of a camera whose images are not rectified.

    Attributes:
        size: Width and height, pixels.
        model: One of `COEFFICIENTS`.
        d: Coefficients of distortion.
        k: `(9,)` camera matrix of the raw image, row-major.
        r: `(9,)` rotation from the camera to the rectified camera, row-major.
        p: `(12,)` projection matrix of the rectified image, row-major.
    """

    size: tuple[int, int]
    model: str
    d: tuple[float, ...]
    k: tuple[float, ...]
    r: tuple[float, ...]
    p: tuple[float, ...]

    @classmethod
    def of(cls, name: str, info: Any) -> RawCamera:  # noqa: ANN401 - a CameraInfo of any library
        """Return the calibration that a sensor_msgs/CameraInfo gives.

        Args:
            name: What it belongs to, for messages (`loc/left`).
            info: The message.

        Raises:
            InputError: If a model is not known, numbers are missing or not finite, or only a part of the image is sent.
        """
        lists = (np.asarray(values, np.float64).reshape(-1).tolist() for values in (info.d, info.k, info.r, info.p))
        d, k, r, p = (tuple(values) for values in lists)
        model, d = _distortion(name, str(info.distortion_model), d)
        if _is_cropped(info):
            raise InputError(
                f"{name}/camera_info has binning or a region of interest: send whole images to be rectified"
            )
        r = r if any(r) else tuple(np.eye(3).reshape(-1).tolist())
        camera = cls((int(info.width), int(info.height)), model, d, k, r, p)
        camera._check(name)
        return camera

    def _check(self, name: str) -> None:
        """Raise an `InputError` where the numbers are not those of a calibrated camera."""
        finite = np.isfinite([*self.d, *self.k, *self.r, *self.p]).all()
        if not finite or self.k[0] <= 0.0 or self.k[4] <= 0.0 or self.p[0] <= 0.0:
            raise InputError(f"{name}/camera_info has no k or p, or numbers that are not finite: calibrate the camera")
        rotation = np.reshape(self.r, (3, 3))
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
            raise InputError(f"{name}/camera_info: r is not a rotation: calibrate the pair")

    def maps(self) -> tuple[NDArray[np.int16], NDArray[np.uint16]]:
        """Return OpenCV's fixed-point maps from the pixels of the rectified image to the raw one."""
        k, r, p = np.reshape(self.k, (3, 3)), np.reshape(self.r, (3, 3)), np.reshape(self.p, (3, 4))[:, :3]
        d = np.array(self.d)
        if self.model in FISHEYE:
            first, second = cv2.fisheye.initUndistortRectifyMap(k, d, r, p, self.size, cv2.CV_16SC2)
        else:
            first, second = cv2.initUndistortRectifyMap(k, d, r, p, self.size, cv2.CV_16SC2)
        return np.asarray(first, np.int16), np.asarray(second, np.uint16)


class StereoRectifier:
    """Rectifies the pairs of two cameras; the right image in a thread of its own.

    Attributes:
        cameras: Calibrations of the left and the right camera.
    """

    def __init__(self, cameras: tuple[RawCamera, RawCamera]) -> None:
        """Make the maps, load the kernel: no pair waits for it."""
        self.cameras = cameras
        self._left, self._right = (Resampler(*camera.maps(), camera.size) for camera in cameras)
        self._thread = ThreadPoolExecutor(1, "rectify")
        self._lock = Lock()
        warm_up()

    def rectify(self, left: GreyImage, right: GreyImage) -> tuple[GreyImage, GreyImage]:
        """Return the rectified images; what no raw pixel shows is 0."""
        with self._lock:
            other = self._thread.submit(self._right, right)
            return self._left(left), other.result()


def rectified_rig(
    infos: Sequence[Any], name: str, before: StereoRectifier | None = None, T_rb_sb: Transform | None = None
) -> tuple[StereoRig, StereoRectifier]:
    """Return the rig that two raw cameras have after rectification, and what rectifies their images.

    Args:
        infos: sensor_msgs/CameraInfo of the left and the right camera.
        name: What they belong to, for messages (`loc`, `nav`).
        before: A rectifier, which is returned if it is of these cameras: maps are made once.
        T_rb_sb: Pose of SB in RB, where known.

    Raises:
        InputError: If a camera cannot be rectified, or the projections are not those of a rectified pair.
    """
    left, right = (RawCamera.of(f"{name}/{side}", info) for side, info in zip(("left", "right"), infos, strict=True))
    rig = rig_from_camera_info(_after(left), _after(right), name, T_rb_sb)
    known = before is not None and before.cameras == (left, right)
    return rig, before if known and before is not None else StereoRectifier((left, right))


def _distortion(name: str, model: str, d: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    """Return model and coefficients; none at all are those of a lens without distortion.

    Raises:
        InputError: If the model is not known, or has another number of coefficients.
    """
    if not model and not any(d):
        model = "plumb_bob"
    if model not in COEFFICIENTS:
        known = ", ".join(COEFFICIENTS)
        raise InputError(f"{name}/camera_info has distortion model '{model[:40]}': one of {known} can be rectified")
    d = d or (0.0,) * COEFFICIENTS[model][0]
    if len(d) not in COEFFICIENTS[model]:
        wanted = " or ".join(map(str, COEFFICIENTS[model]))
        raise InputError(f"{name}/camera_info has {len(d)} coefficients d: model {model} needs {wanted}")
    return model, d


def _after(camera: RawCamera) -> SimpleNamespace:
    """Return the camera_info of the rectified images."""
    width, height = camera.size
    k = np.reshape(camera.p, (3, 4))[:, :3].reshape(-1)
    return SimpleNamespace(width=width, height=height, d=(0.0,) * 5, k=k, r=np.eye(3).reshape(-1), p=camera.p)


def _is_cropped(info: Any) -> bool:  # noqa: ANN401 - a CameraInfo of any library
    roi = info.roi
    whole = (roi.width, roi.height) in ((0, 0), (info.width, info.height)) and not (roi.x_offset or roi.y_offset)
    return not whole or info.binning_x > 1 or info.binning_y > 1
