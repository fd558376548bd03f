"""Filters of float32 images, and robust statistics of what they show."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, Mask, median

F = np.float32

MAD_TO_SIGMA = 1.4826  #: Standard deviation of a normal law over its median absolute deviation.
VARIANCE_SIDE = 7  #: Side of the square of a local variance.
MIN_DISPARITY_PX = F(0.3)  #: Smallest disparity whose depth is compared with another one.


def mad_sigma(deviations: NDArray[np.floating[Any]]) -> float:
    """Return the robust standard deviation of deviations from the centre, `1.4826 median |e|`."""
    return MAD_TO_SIGMA * median(np.abs(deviations))


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


def second_differences(image: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Return the second differences along rows and along columns; the border is repeated."""
    kernel = np.array([[1.0, -2.0, 1.0]], np.float32)
    along_x, along_y = (cv2.filter2D(image, -1, taps, borderType=cv2.BORDER_REPLICATE) for taps in (kernel, kernel.T))
    return np.asarray(along_x, np.float32), np.asarray(along_y, np.float32)


def local_variance(image: FloatImage) -> FloatImage:
    """Return the variance around each pixel `(H, W)`, border mirrored; sums of grey levels are exact in float32."""
    mean = box_mean(image, VARIANCE_SIDE)
    variance = box_mean(image * image, VARIANCE_SIDE)
    variance -= mean * mean
    return variance


def depth_ratio(disparity: FloatImage, reach: int) -> FloatImage:
    """Return the depth `(H, W)` of each pixel over that of the nearest surface within so many rows and columns."""
    least = np.maximum(disparity, MIN_DISPARITY_PX)
    return np.asarray(cv2.dilate(least, np.ones((2 * reach + 1,) * 2, np.uint8)) / least, F)


def within(pixels: Mask, reach: int) -> Mask:
    """Tell which pixels are within so many rows and columns of one that is set."""
    square = np.ones((2 * reach + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(pixels.astype(np.uint8), square)).astype(np.bool_)
