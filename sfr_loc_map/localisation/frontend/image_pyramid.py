"""Image pyramids for tracking."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage

SMOOTHING = cv2.getGaussianKernel(3, 0.5, cv2.CV_32F)
"""Along rows and columns: against the errors of bilinear interpolation."""
LEVELS = 4
"""Levels of the pyramid; level l is 2^l times smaller, its pixel centres at `u_l = (u + 0.5) / 2^l - 0.5`."""


class ImageLevel(NamedTuple):
    """One level of a pyramid as a struct for kernels.

    Attributes:
        image: `(H, W)` float32.
        scale: Pixels of full size per pixel, `2^l`.
    """

    image: FloatImage
    scale: float


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """A smoothed image and its smaller copies.

    Attributes:
        levels: float32 images; level 0 smoothed lightly against interpolation errors, each next one the mean of
            2 x 2 pixels of the one before.
    """

    levels: tuple[FloatImage, ...]

    def level(self, number: int) -> ImageLevel:
        """Return one level with its scale."""
        return ImageLevel(self.levels[number], 2.0**number)


def build_pyramid(image: GreyImage) -> Pyramid:
    """Return the pyramid of an image `(H, W)` uint8."""
    smooth = cv2.sepFilter2D(image, cv2.CV_32F, SMOOTHING, SMOOTHING)
    levels = [smooth]
    for _ in range(LEVELS - 1):
        height, width = levels[-1].shape
        even = levels[-1][: height // 2 * 2, : width // 2 * 2]
        levels.append(cv2.resize(even, (width // 2, height // 2), interpolation=cv2.INTER_AREA))
    return Pyramid(tuple(np.ascontiguousarray(level) for level in levels))
