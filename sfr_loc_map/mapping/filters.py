"""Box means and changes of size, as float32."""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage


def box_mean(image: FloatImage, side: int) -> FloatImage:
    """Return the mean over `side` x `side` neighbours; the border is mirrored."""
    return np.asarray(cv2.blur(image, (side, side)), np.float32)


def reduced(image: FloatImage, factor: int) -> FloatImage:
    """Return the means of blocks of `factor` x `factor`; the size must be a multiple of it."""
    rows, cols = image.shape
    return np.asarray(cv2.resize(image, (cols // factor, rows // factor), interpolation=cv2.INTER_AREA), np.float32)


def enlarged(image: FloatImage, shape: tuple[int, ...]) -> FloatImage:
    """Return the picture at another size, bilinear between the centres of its elements."""
    return np.asarray(cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32)


def repeated(image: FloatImage) -> FloatImage:
    """Return every element twice along both axes."""
    rows, cols = image.shape
    return np.asarray(cv2.resize(image, (2 * cols, 2 * rows), interpolation=cv2.INTER_NEAREST), np.float32)
