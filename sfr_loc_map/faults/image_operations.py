"""Operations on images that the faults share.

Functions that require OpenCV import it, so that `kinds.parse_fault` does not load it.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage

READ_NOISE = 1.0  #: Noise of a camera without light, grey levels.


def as_grey(values: FloatArray | FloatImage) -> GreyImage:
    """Return rounded and clipped grey levels."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def with_noise(grey: FloatImage, sigma: float, rng: np.random.Generator) -> GreyImage:
    """Return grey levels `(H, W)` with Gaussian noise, rounded and clipped."""
    return as_grey(grey + sigma * rng.standard_normal(grey.shape, np.float32))


def moved(image: FloatImage, columns: float) -> FloatImage:
    """Return an image shifted to the right by a number of columns, which may be fractional; edges are mirrored."""
    return warped(image, np.array([[1.0, 0.0, columns], [0.0, 1.0, 0.0]]))


def warped(image: FloatImage, transform: FloatArray) -> FloatImage:
    """Return an image after an affine transform `(2, 3)`; edges are mirrored."""
    import cv2

    flags, border = cv2.INTER_CUBIC, cv2.BORDER_REFLECT
    return np.asarray(cv2.warpAffine(image, transform, image.shape[::-1], flags=flags, borderMode=border), np.float32)


def smoothed(image: FloatImage, sigma_px: float) -> FloatImage:
    """Return an image after a Gaussian filter."""
    import cv2

    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)
