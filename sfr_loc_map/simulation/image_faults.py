"""Faults of single images: brightness, focus, noise, glare, and a rotated camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.simulation.faults import FaultKind

READ_NOISE = 1.0
"""Noise of a camera that is left when no light comes in, grey levels."""
ROTATION_AXES = {FaultKind.ROLL: 2, FaultKind.PITCH: 0, FaultKind.YAW: 1, FaultKind.DRIFT: 1}
"""Axis of the optical frame about which the right camera is rotated."""


class Moment(NamedTuple):
    """One affected pair.

    Attributes:
        progress: How much of its burst is over, 0 .. 1.
        spot: `(2,)` random point, as shares of width and height.
        rng: Generator of this pair.
    """

    progress: float
    spot: FloatArray
    rng: np.random.Generator


def with_noise(grey: FloatImage, sigma: float, rng: np.random.Generator) -> GreyImage:
    """Return grey levels `(H, W)` with Gaussian noise, rounded and clipped."""
    noisy = grey + sigma * rng.standard_normal(grey.shape, np.float32)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def _black(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    return np.zeros_like(image)


def _blurred(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), max(amount, 1e-3)), np.uint8)


def _exposed(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    return with_noise(amount * image.astype(np.float32), 0.0, moment.rng)


def _noisy(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    return with_noise(image.astype(np.float32), amount, moment.rng)


def _faded(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    """Darker with progress to the middle of the burst, where it is black, and brighter again."""
    return with_noise(abs(2.0 * moment.progress - 1.0) * image.astype(np.float32), READ_NOISE, moment.rng)


def _saturated(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    """Brighten until the brightest share of the image is clipped."""
    white = max(float(np.quantile(image, 1.0 - amount)), 1.0)
    return with_noise(255.0 / white * image.astype(np.float32), READ_NOISE, moment.rng)


def _blinded(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    height, width = image.shape
    y, x = np.mgrid[:height, :width]
    r = np.hypot(x - moment.spot[0] * width, y - moment.spot[1] * height) / max(0.5 * amount * width, 1e-6)
    glare = (255.0 * np.minimum(1.2, 1.2 / np.maximum(r, 1e-3) ** 3)).astype(np.float32)
    return with_noise(image.astype(np.float32) + glare, 0.0, moment.rng)


IMAGE_FAULTS: dict[FaultKind, Callable[[GreyImage, float, Moment], GreyImage]] = {
    FaultKind.BLACK: _black,
    FaultKind.START: _black,
    FaultKind.FADE: _faded,
    FaultKind.BLURRED: _blurred,
    FaultKind.EXPOSURE: _exposed,
    FaultKind.NOISY: _noisy,
    FaultKind.SATURATION: _saturated,
    FaultKind.BLINDED: _blinded,
}
"""Each takes an image `(H, W)`, the amount of the fault and the moment, and returns the faulty image."""


def rotated(image: GreyImage, kind: FaultKind, angle_deg: float, rig: StereoRig) -> GreyImage:
    """Return the image of a camera that is rotated against its calibration (the homography `K R K^-1`)."""
    vector = np.zeros(3)
    sign = 1.0 if kind is FaultKind.ROLL else -1.0
    vector[ROTATION_AXES[kind]] = sign * np.radians(angle_deg)
    K = rig.camera_matrix
    homography = K @ matrix_from_rotvec(vector).T @ np.linalg.inv(K)
    size = (rig.width, rig.height)
    return np.asarray(cv2.warpPerspective(image, homography, size, flags=cv2.INTER_CUBIC), np.uint8)
