"""From light to grey levels: lens, exposure, noise, converter, rectification."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.simulation.config import SensorConfig

_LENS, _HOT, _EXPOSURE, _NOISE = 6, 7, 8, 9


class Sensor:
    """One camera's chain from brightness to picture; the same (seed, frame, camera) gives the same bytes."""

    def __init__(self, seed: int, task: int, config: SensorConfig, rig: StereoRig) -> None:
        """Prepare what does not change from frame to frame.

        Args:
            seed: Seed of the data set.
            task: 0 for localisation, 1 for mapping cameras.
            config: Settings.
            rig: The rectified cameras.
        """
        self._seed, self._task, self._config, self._rig = seed, task, config, rig
        size = (rig.height, rig.width)
        self._fall_off = _fall_off(rig, config.vignetting)
        self._hot = [np.random.default_rng([seed, _HOT, task, c]).random(size) < config.hot_pixels for c in (0, 1)]
        self._maps = None
        if any(config.distortion):
            coefficients = np.array(config.distortion)
            self._maps = cv2.initUndistortRectifyMap(
                rig.camera_matrix, coefficients, None, rig.camera_matrix, (rig.width, rig.height), cv2.CV_32FC1
            )

    def raw_to_rectified(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where raw pixel places `(N,)` lie in the rectified picture (the same without distortion)."""
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

    def picture(self, bright: FloatImage, frame: int, camera: int) -> NDArray[np.uint8]:
        """Return the picture of a raw image of brightness `(H, W)`, as a share of the full range."""
        config = self._config
        image = bright.astype(np.float32)
        if config.blur_px > 0:
            image = np.asarray(
                cv2.GaussianBlur(image, (0, 0), config.blur_px, borderType=cv2.BORDER_REFLECT_101), np.float32
            )
        image = image * self._fall_off * np.float32(self._exposure(frame, camera))
        noise = np.random.default_rng([self._seed, _NOISE, self._task, frame, camera])
        if config.full_well > 0:
            electrons = np.clip(image, 0.0, 4.0) * config.full_well
            image = image + np.sqrt(electrons) * noise.standard_normal(image.shape, np.float32) / config.full_well
        if config.read_noise_grey > 0:
            image = image + (config.read_noise_grey / 255.0) * noise.standard_normal(image.shape, np.float32)
        image = np.where(self._hot[camera], np.float32(1.0), image)
        return self._convert(image)

    def _convert(self, image: FloatImage) -> NDArray[np.uint8]:
        top = 2**self._config.adc_bits - 1
        counts = np.clip(np.rint(image * top), 0, top).astype(np.float32)
        if self._maps is not None:
            counts = cv2.remap(counts, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        return np.asarray(np.rint(counts * (255.0 / top)), dtype=np.uint8)

    def _exposure(self, frame: int, camera: int) -> float:
        both = np.random.default_rng([self._seed, _EXPOSURE, self._task, frame]).normal() * self._config.gain_step
        one = np.random.default_rng([self._seed, _LENS, self._task]).normal() * self._config.gain_mismatch
        return float(np.exp(both + (one if camera else 0.0)))


def _fall_off(rig: StereoRig, strength: float) -> FloatImage:
    """Return the cosine to the fourth power of the angle off the axis, weakened to a share."""
    x = (np.arange(rig.width) - rig.cx) / rig.fx
    y = (np.arange(rig.height) - rig.cy) / rig.fy
    cosine4 = 1.0 / np.square(1.0 + x[None, :] ** 2 + y[:, None] ** 2)
    return np.maximum(1.0 + strength * (cosine4 - 1.0), 0.0).astype(np.float32)
