"""From light to grey levels: lens, exposure, noise, converter, rectification."""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import Task
from sfr_loc_map.simulation.config import SensorConfig

_LENS, _HOT, _EXPOSURE, _NOISE = 6, 7, 8, 9
TASK_SEEDS = {Task.LOCALISATION: 0, Task.MAPPING: 1}  #: Number of a task in the seeds of what is random.


class Sensor:
    """Imaging chain of a stereo rig: the same (seed, frame, camera) gives the same bytes."""

    def __init__(self, seed: int, task: Task, config: SensorConfig, rig: StereoRig) -> None:
        self._seed, self._task, self._config, self._rig = seed, TASK_SEEDS[task], config, rig
        size = (rig.height, rig.width)
        # the cosine to the fourth power of the angle off the axis, weakened to a share
        x, y = (np.arange(rig.width) - rig.cx) / rig.fx, (np.arange(rig.height) - rig.cy) / rig.fy
        cosine4 = 1.0 / np.square(1.0 + x[None, :] ** 2 + y[:, None] ** 2)
        self._fall_off = np.maximum(1.0 + config.vignetting * (cosine4 - 1.0), 0.0).astype(np.float32)
        hot = (np.random.default_rng([seed, _HOT, self._task, camera]).random(size) for camera in (0, 1))
        self._hot = [draws < config.hot_pixels for draws in hot]
        self._maps = None
        if any(config.distortion):
            coefficients = np.array(config.distortion)
            self._maps = cv2.initUndistortRectifyMap(
                rig.camera_matrix, coefficients, None, rig.camera_matrix, (rig.width, rig.height), cv2.CV_32FC1
            )

    def raw_to_rectified(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the rectified coordinates of raw pixels `(N,)` (the same without distortion)."""
        if self._maps is None:
            return u, v
        points = np.column_stack((u, v))[:, None]
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
        flat = cv2.undistortPointsIter(
            points,
            self._rig.camera_matrix,
            np.array(self._config.distortion),
            np.eye(3),
            self._rig.camera_matrix,
            criteria,
        )[:, 0]
        return flat[:, 0].astype(np.float64), flat[:, 1].astype(np.float64)

    def image(self, bright: FloatImage, frame: int, camera: int) -> GreyImage:
        """Return the rectified image `(H, W)` of a raw brightness `(H, W)`, a share of the full range."""
        config = self._config
        image = bright.astype(np.float32)
        if config.blur_px > 0:
            image = np.asarray(
                cv2.GaussianBlur(image, (0, 0), config.blur_px, borderType=cv2.BORDER_REFLECT_101), np.float32
            )
        both = np.random.default_rng([self._seed, _EXPOSURE, self._task, frame]).normal() * config.gain_step
        one = np.random.default_rng([self._seed, _LENS, self._task]).normal() * config.gain_mismatch
        image = image * self._fall_off * np.float32(np.exp(both + (one if camera else 0.0)))
        noise = np.random.default_rng([self._seed, _NOISE, self._task, frame, camera])
        if config.full_well > 0:
            electrons = np.clip(image, 0.0, 4.0) * config.full_well
            image = image + np.sqrt(electrons) * noise.standard_normal(image.shape, np.float32) / config.full_well
        if config.read_noise_grey > 0:
            image = image + (config.read_noise_grey / 255.0) * noise.standard_normal(image.shape, np.float32)
        image = np.where(self._hot[camera], np.float32(1.0), image)
        top = 2**config.adc_bits - 1
        counts = np.clip(np.rint(image * top), 0, top).astype(np.float32)
        if self._maps is not None:
            counts = cv2.remap(counts, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        return np.asarray(np.rint(counts * (255.0 / top)), dtype=np.uint8)
