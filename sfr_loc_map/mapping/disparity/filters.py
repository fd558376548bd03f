"""Box means and changes of resolution, as float32."""

from __future__ import annotations

import cv2
import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline

F = np.float32

REACH = 3
"""Half side of the square of a local variance."""
MIN_DISPARITY_PX = F(0.3)
"""Smallest disparity whose depth is compared with another one."""
BLOCK_ROWS = 16


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


@jit_rows_inline
def _mirror_ends(row: FloatImage) -> None:
    """Fill the first and last `REACH` elements with those beyond the first and last inner one."""
    last = len(row) - REACH - 1
    for k in range(1, REACH + 1):
        row[REACH - k], row[last + k] = row[REACH + k], row[last - k]


@jit_rows
def local_variance(image: FloatImage) -> FloatImage:
    """Return the variance of 7 x 7 neighbours `(H, W)`; the border is mirrored.

    Sums of whole grey levels and of their squares are exact in float32.
    """
    rows, cols = image.shape
    out, share = np.empty((rows, cols), F), 1.0 / (2 * REACH + 1) ** 2
    for block in prange((rows + BLOCK_ROWS - 1) // BLOCK_ROWS):
        sums, squares, means = np.empty(cols + 2 * REACH, F), np.empty(cols + 2 * REACH, F), np.empty(cols, F)
        for y in range(BLOCK_ROWS * block, min(BLOCK_ROWS * (block + 1), rows)):
            for x in range(cols + 2 * REACH):
                sums[x] = squares[x] = F(0.0)
            inner_sums, inner_squares = sums[REACH:], squares[REACH:]
            for dy in range(-REACH, REACH + 1):
                v = abs(y + dy) if y + dy < rows else 2 * (rows - 1) - y - dy
                row = image[v]
                for x in range(cols):
                    inner_sums[x] += row[x]
                for x in range(cols):
                    inner_squares[x] += row[x] * row[x]
            _mirror_ends(sums)
            _mirror_ends(squares)
            for x in range(cols):
                total, of_squares = F(0.0), F(0.0)
                for k in range(2 * REACH + 1):
                    total += sums[x + k]
                    of_squares += squares[x + k]
                mean = F(np.float64(total) * share)
                out[y, x], means[x] = mean * mean, F(np.float64(of_squares) * share)
            for x in range(cols):  # a loop of its own: no product is contracted with the difference
                out[y, x] = means[x] - out[y, x]
    return out


def depth_ratio(disparity: FloatImage, reach: int) -> FloatImage:
    """Return the depth `(H, W)` of each pixel over that of the nearest surface within so many rows and columns.

    Args:
        disparity: `(H, W)`, pixels; at least `MIN_DISPARITY_PX` is taken.
        reach: Pixels.
    """
    least = np.maximum(disparity, MIN_DISPARITY_PX)
    return np.asarray(cv2.dilate(least, np.ones((2 * reach + 1,) * 2, np.uint8)) / least, F)
