"""Initial disparity by semi-global matching, to a fraction of a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatImage, GreyImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.config import MappingConfig

WIDE = 800
"""Images of so many columns are matched at half their width: a quarter of the cost, less noise, and the refinement has
cells of two pixels anyway. Small images are matched as they are: edges come out sharper, and the cost is small."""
SPREAD_PERCENTILES, SPREAD_STRIDE = (10.0, 50.0, 90.0), 4
ALIKE_GREY = 8.0
"""Percentiles of a pair of one exposure differ by less, as the two images do not show quite the same."""
SPECKLE_PIXELS, SPECKLE_STEP = 60, 16
"""Islands of fewer pixels are removed; within one, neighbours differ by at most so many sixteenths of a pixel."""


@dataclass(frozen=True, slots=True)
class SearchRange:
    """Disparities that are searched, pixels."""

    min_disparity_px: float  # the smallest of a point that is kept
    count: int  # whole disparities searched from 0 on, a multiple of 16


def search_range(rig: StereoRig, config: MappingConfig) -> SearchRange:
    """Return the disparities between the farthest and the nearest depth, `d = fx baseline / Z`.

    At most half of the image's width: nearer surfaces are visible to one camera only over most of the image.
    """
    scale = rig.fx * rig.baseline_m
    if config.min_range_m >= config.max_range_m:
        raise ConfigError(
            f"min_range_m {config.min_range_m} must be less than max_range_m {config.max_range_m}: correct them"
        )
    nearest = min(scale / config.min_range_m, 0.5 * rig.width)
    count, least = 16 * math.ceil((nearest + 1.0) / 16.0), scale / config.max_range_m
    if least >= nearest:
        raise ConfigError(
            f"at max_range_m {config.max_range_m} the disparity is {least:.4g} px, half the image has {nearest:.4g}: "
            "nothing can be matched; correct the ranges or the baseline"
        )
    return SearchRange(least, count)


def semi_global_matching(left: GreyImage, right: GreyImage, count: int) -> FloatImage:
    """Return the disparity of the left image `(H, W)`, pixels, NaN where the left-right check fails.

    Semi-global matching (Hirschmueller 2008, OpenCV's three paths) in steps of 1/16 pixel, of 1/8 in wide images, whose
    columns are averaged in pairs. A right image of another exposure is equalised. Both images are padded on the left,
    so that columns are matched even where a part of the search range, 0 to `count - 1`, lies outside the right image.
    """
    columns = 2 if left.shape[1] >= WIDE else 1
    searched = 16 * math.ceil(count / (16 * columns))
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=searched,
        blockSize=1,  # larger blocks fatten the edges of rocks
        P1=8,
        P2=32,
        disp12MaxDiff=1,
        preFilterCap=31,
        uniquenessRatio=2,
        speckleWindowSize=0,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    matched = [_averaged_columns(image, columns) for image in (left, _equalised(left, right))]
    padded = [cv2.copyMakeBorder(image, 0, 0, searched, 0, cv2.BORDER_REPLICATE) for image in matched]
    fixed = matcher.compute(padded[0], padded[1])[:, searched:]
    cv2.filterSpeckles(fixed, -16, SPECKLE_PIXELS, SPECKLE_STEP)
    disparity: FloatImage = fixed.astype(np.float32)
    disparity *= np.float32(columns / 16.0)
    disparity[fixed < 0] = np.nan
    return np.ascontiguousarray(np.repeat(disparity, columns, axis=1)[:, : left.shape[1]])


def _equalised(left: GreyImage, right: GreyImage) -> GreyImage:
    """Return the right image with gain and offset such that its grey levels are spread as those of the left."""
    low_l, middle_l, high_l = np.percentile(left[::SPREAD_STRIDE, ::SPREAD_STRIDE], SPREAD_PERCENTILES)
    low_r, middle_r, high_r = np.percentile(right[::SPREAD_STRIDE, ::SPREAD_STRIDE], SPREAD_PERCENTILES)
    changes = (low_l - low_r, middle_l - middle_r, high_l - high_r)
    if max(abs(change) for change in changes) <= ALIKE_GREY or high_r - low_r < 1.0:
        return right
    gain = (high_l - low_l) / (high_r - low_r)
    levels = np.rint(gain * (np.arange(256.0) - middle_r) + middle_l)
    return np.asarray(cv2.LUT(right, np.clip(levels, 0, 255).astype(np.uint8)))


def _averaged_columns(image: GreyImage, columns: int) -> GreyImage:
    """Return the image with means of so many columns `(H, ceil(W / columns))`; the last column is repeated."""
    rows, cols = image.shape
    whole = cv2.copyMakeBorder(image, 0, 0, 0, -cols % columns, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(whole, (-(-cols // columns), rows), interpolation=cv2.INTER_AREA), np.uint8)
