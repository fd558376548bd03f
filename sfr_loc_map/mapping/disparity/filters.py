"""Box means and changes of resolution, as float32."""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage


def box_mean(image: FloatImage, side: int) -> FloatImage:
    """Return the mean over `side` x `side` neighbours; the border is mirrored."""
    return np.asarray(cv2.blur(image, (side, side)), np.float32)


def downsample_mean(image: FloatImage, factor: int) -> FloatImage:
    """Return the means of blocks of `factor` x `factor`; the size must be a multiple of it."""
    rows, cols = image.shape
    return np.asarray(cv2.resize(image, (cols // factor, rows // factor), interpolation=cv2.INTER_AREA), np.float32)


def upsample_bilinear(image: FloatImage, shape: tuple[int, ...]) -> FloatImage:
    """Return the image at another size, bilinear between the centres of its elements."""
    return np.asarray(cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32)


def upsample_nearest(image: FloatImage) -> FloatImage:
    """Return every element twice along both axes."""
    rows, cols = image.shape
    return np.asarray(cv2.resize(image, (2 * cols, 2 * rows), interpolation=cv2.INTER_NEAREST), np.float32)


def second_differences(image: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Return the second differences along rows and along columns; the border is repeated."""
    kernel = np.array([[1.0, -2.0, 1.0]], np.float32)
    along_x, along_y = (cv2.filter2D(image, -1, taps, borderType=cv2.BORDER_REPLICATE) for taps in (kernel, kernel.T))
    return np.asarray(along_x, np.float32), np.asarray(along_y, np.float32)
