"""Filters of float32 images and masks, and replacement of pixels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatImage, GreyImage, Mask, T

VARIANCE_SIDE = 7  #: Side of the window of a local variance, pixels. Its 49 samples give the variance to 20 %.


def box_mean(image: FloatImage, side: int) -> FloatImage:
    """Return the mean over a window of `side` x `side` pixels; the border is mirrored."""
    return np.asarray(cv2.blur(image, (side, side)), F)


def downsample_mean(image: FloatImage, factor: int) -> FloatImage:
    """Return the means of blocks of `factor` x `factor`; rows and columns must be multiples of `factor`."""
    rows, cols = image.shape
    return np.asarray(cv2.resize(image, (cols // factor, rows // factor), interpolation=cv2.INTER_AREA), F)


def upsample_bilinear(image: FloatImage, shape: tuple[int, ...]) -> FloatImage:
    """Return the image resized to `shape` by bilinear interpolation between the centres of its elements."""
    rows, cols = shape
    return np.asarray(cv2.resize(image, (cols, rows), interpolation=cv2.INTER_LINEAR), F)


def upsample_nearest(image: FloatImage, factor: int) -> FloatImage:
    """Return the image with each element repeated in a block of `factor` x `factor`."""
    return image.repeat(factor, axis=0).repeat(factor, axis=1)


def second_differences(image: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Return the second differences along rows and along columns; the border is repeated."""
    taps = np.array([[1.0, -2.0, 1.0]], F)
    along_x = cv2.filter2D(image, -1, taps, borderType=cv2.BORDER_REPLICATE)
    along_y = cv2.filter2D(image, -1, taps.T, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(along_x, F), np.asarray(along_y, F)


def local_variance(image: FloatImage) -> FloatImage:
    """Return the variance around each pixel `(H, W)`; the border is mirrored."""
    mean = box_mean(image, VARIANCE_SIDE)
    return np.asarray(box_mean(image * image, VARIANCE_SIDE) - mean * mean, F)


def dilated(pixels: Mask, reach: int) -> Mask:
    """Return the mask of all pixels within `reach` rows and columns of a set pixel."""
    return np.asarray(cv2.dilate(pixels.astype(np.uint8), square_element(2 * reach + 1))).astype(np.bool_)


def with_pixels_of(other: FloatImage, mask: Mask, image: FloatImage) -> FloatImage:
    """Return an image with the pixels of another image where a mask is set: a `numpy.where` that uses vector units."""
    return np.asarray(cv2.copyTo(other, mask.view(np.uint8), image.copy()), F)


def with_value(value: T, mask: Mask, image: NDArray[T]) -> NDArray[T]:
    """Return an image with a value where a mask is set, faster than `numpy.where` if most set pixels are adjacent."""
    replaced = image.copy()
    replaced[mask] = value
    return replaced


def square_element(side: int) -> GreyImage:
    """Return the structuring element of a square `(side, side)`."""
    return np.ones((side, side), np.uint8)
