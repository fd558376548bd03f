"""Images of half the size, with rig and disparities to match."""

from __future__ import annotations

import warnings
from dataclasses import replace

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

JUMP_PX = 1.0
"""Four true disparities that differ by more lie on an edge: the half-size pixel has no ground truth."""


def half_rig(rig: StereoRig) -> StereoRig:
    """Return the rig of images of half the size; an odd last row or column is left out.

    A pixel's centre lies between four of the larger image: `u = 2 u' + 1/2`.
    """
    return replace(
        rig,
        width=rig.width // 2,
        height=rig.height // 2,
        fx=rig.fx / 2,
        fy=rig.fy / 2,
        cx=(rig.cx - 0.5) / 2,
        cy=(rig.cy - 0.5) / 2,
    )


def half_pair(pair: StereoPair) -> StereoPair:
    """Return the pair at half the size: means of two by two pixels."""
    return replace(pair, left=_half(pair.left), right=_half(pair.right))


def _half(image: GreyImage) -> GreyImage:
    height, width = image.shape[0] // 2, image.shape[1] // 2
    return np.asarray(cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA))


def half_disparity(disparity_px: FloatArray) -> FloatArray:
    """Return true disparities `(H, W)` at half the size, in its pixels; NaN at edges and where one of four has none."""
    height, width = disparity_px.shape[0] // 2, disparity_px.shape[1] // 2
    blocks = disparity_px[: 2 * height, : 2 * width].reshape(height, 2, width, 2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        spread = blocks.max(axis=(1, 3)) - blocks.min(axis=(1, 3))
    half = blocks.mean(axis=(1, 3)) / 2
    return np.where(spread <= JUMP_PX, half, np.nan)
