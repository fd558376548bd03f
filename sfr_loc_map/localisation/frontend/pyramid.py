"""Image pyramids: a smoothed image at several scales."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage

SMOOTHING = cv2.getGaussianKernel(3, 0.5, cv2.CV_32F)
"""Gaussian kernel with a standard deviation of 0.5 px, which reduces the errors of bilinear interpolation. Other widths
were tried: measurements/localiser_trials.md, "What limits it, and what was tried"."""
LEVELS = 4
"""Number of levels. Level l is 2^l times smaller; its pixels are `u_l = (u + 0.5) / 2^l - 0.5`. A patch of 7 x 7 px of
the last level covers 56 x 56 px of the image. With fewer levels, prediction errors of about ten pixels are not
corrected. With more levels, patches do not fit into the last level of a small image."""


class ImageLevel(NamedTuple):
    """One level of a pyramid."""

    image: FloatImage  #: `(H, W)` float32.
    scale: float  #: Pixels of full size per pixel, `2^l`.


Pyramid = tuple[ImageLevel, ...]
"""Level 0 is the smoothed image. A pixel of each further level is the mean of 2 x 2 pixels of the previous level."""


def build_pyramid(image: GreyImage) -> Pyramid:
    """Return the pyramid of an image `(H, W)` uint8."""
    levels = [cv2.sepFilter2D(image, cv2.CV_32F, SMOOTHING, SMOOTHING)]
    for _ in range(LEVELS - 1):
        height, width = levels[-1].shape
        even = levels[-1][: height // 2 * 2, : width // 2 * 2]
        levels.append(cv2.resize(even, (width // 2, height // 2), interpolation=cv2.INTER_AREA))
    return tuple(ImageLevel(np.ascontiguousarray(level), 2.0**number) for number, level in enumerate(levels))
