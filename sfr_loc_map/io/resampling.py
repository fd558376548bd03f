"""Bilinear resampling of an image at fixed places: the pixels that `cv2.remap` gives, in half its time.

OpenCV looks four weights up for each pixel and checks whether it lies within the image. Here the weights are computed
in whole numbers and a rim of zeros stands for what lies outside.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.jit import jit

RIM = 2
"""Pixels of zeros around an image: all that lies outside has its four neighbours in a corner of it."""
BITS = 5
"""A pixel has 32 parts, as in OpenCV's fixed-point maps."""


class Resampler:
    """Resamples images of one size at the same places; one call at a time."""

    def __init__(self, whole: NDArray[np.int16], parts: NDArray[np.uint16], size: tuple[int, int]) -> None:
        """Compute indices and weights.

        Args:
            whole: `(H, W, 2)` column and row, of the upper left of the four neighbours (OpenCV's first map, CV_16SC2).
            parts: `(H, W)` the rest of row and column, 1/32 pixel, 5 bits each (OpenCV's second map).
            size: Width and height of the images, pixels.
        """
        width, height = size
        self._shape = whole.shape[:2]
        self._rimmed = np.zeros((height + 2 * RIM, width + 2 * RIM), np.uint8)
        column = np.clip(whole[..., 0].astype(np.int32), -RIM, width) + RIM
        row = np.clip(whole[..., 1].astype(np.int32), -RIM, height) + RIM
        self._index = (row * (width + 2 * RIM) + column).reshape(-1).astype(np.uint32)
        mask = (1 << BITS) - 1
        self._right, self._below = ((part & mask).reshape(-1).astype(np.uint8) for part in (parts, parts >> BITS))

    def __call__(self, image: GreyImage) -> GreyImage:
        """Return the resampled image, a new array."""
        out = np.empty(self._shape, np.uint8)
        self._rimmed[RIM:-RIM, RIM:-RIM] = image
        stride = np.uint32(self._rimmed.shape[1])
        _bilinear(self._rimmed.reshape(-1), self._index, self._right, self._below, stride, out.reshape(-1))
        return out


def warm_up() -> None:
    """Load the kernel, or compile it."""
    Resampler(np.zeros((1, 1, 2), np.int16), np.zeros((1, 1), np.uint16), (1, 1))(np.zeros((1, 1), np.uint8))


@jit
def _bilinear(
    image: GreyImage,
    index: NDArray[np.uint32],
    right: NDArray[np.uint8],
    below: NDArray[np.uint8],
    stride: np.uint32,
    out: GreyImage,
) -> None:
    """Write the weighted mean of four neighbours.

    Args:
        image: `(S,)` rows of the image with its rim.
        index: `(N,)` upper left neighbour.
        right: `(N,)` weight of the neighbours to the right, 1/32.
        below: `(N,)` weight of the neighbours below, 1/32.
        stride: Pixels of a row.
        out: `(N,)` written.
    """
    one = np.uint32(1)
    for i in range(out.shape[0]):
        at = index[i]
        x, y = np.int32(right[i]), np.int32(below[i])
        a, b = np.int32(image[at]), np.int32(image[at + one])
        c, d = np.int32(image[at + stride]), np.int32(image[at + stride + one])
        upper = (a << BITS) + (b - a) * x
        lower = (c << BITS) + (d - c) * x
        out[i] = np.uint8(((upper << BITS) + (lower - upper) * y + (1 << (2 * BITS - 1))) >> (2 * BITS))
