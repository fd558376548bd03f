"""Matching: the disparities that are searched, and their estimation by semi-global matching (Hirschmueller 2008)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import F, FloatImage, GreyImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.exposure import with_exposure_of_left

MAX_DISPARITY_FRACTION = 0.5
"""Maximum disparity of the search as a fraction of the image width. Most of a nearer surface is visible to only one
camera."""
DISPARITY_STEP = 16  #: OpenCV's matcher requires a multiple of this number of disparities.
WIDE_COLUMNS = 800  #: Images of at least this width, pixels, are matched at half their width, in a quarter of the time.
SUBPIXELS = 16  #: Number of disparity steps per pixel of OpenCV's matcher.
SMALL_JUMP_PENALTY = 8
"""P1 of Hirschmueller (2008): cost of a change of disparity by one pixel. OpenCV recommends 8 per channel."""
LARGE_JUMP_PENALTY = 32  #: P2 of Hirschmueller (2008): cost of a larger change. OpenCV recommends 32 per channel.
MAX_LEFT_RIGHT_PX = 1  #: Maximum difference in the left-right check, pixels of the matched images.
MAX_DERIVATIVE = 31  #: Derivatives of the images are clipped to this, grey levels.
MIN_UNIQUENESS_PERCENT = 2  #: Minimum margin between the best and the second best cost, percent.
MAX_SPECKLE_PIXELS = 60  #: Maximum size of a segment that is removed, pixels of the matched images.
MAX_SPECKLE_STEP = SUBPIXELS
"""Maximum difference of neighbours within a segment, steps of the matcher: one pixel of the matched images."""
MATCHER_UNMATCHED = -SUBPIXELS  #: The matcher's value of an unmatched pixel: `minDisparity - 1`, in steps.


@dataclass(frozen=True, slots=True)
class SearchRange:
    """Disparities that are searched and kept, pixels."""

    min_disparity_px: float  #: Disparity at `max_range_m`; smaller disparities are searched but not kept.
    #: Limit that the search must reach: the smaller of the disparity at `min_range_m` and half the image width. Larger
    #: disparities that are found are kept. In ROS, `stereo_msgs/DisparityImage` states this limit.
    max_disparity_px: float
    #: Number of searched integer disparities from 0 on: the smallest multiple of `DISPARITY_STEP` that includes the
    #: limit. Wide images are matched at half their width (`semi_global_matching`). The matcher then searches only even
    #: disparities and may miss the limit by up to one pixel.
    count: int


def search_range_of(rig: StereoRig, config: MappingConfig) -> SearchRange:
    """Return the disparities between the maximum and the minimum depth, `d = fx baseline / Z`.

    Surfaces at `min_range_m` may not be found if their disparity exceeds `MAX_DISPARITY_FRACTION` of the image width.
    Raises ConfigError if the range of disparities is empty.
    """
    if config.min_range_m >= config.max_range_m:
        raise ConfigError(
            f"min_range_m is {config.min_range_m}: a number below max_range_m, {config.max_range_m}, is required"
        )
    scale = rig.fx * rig.baseline_m
    max_disparity_px = min(scale / config.min_range_m, MAX_DISPARITY_FRACTION * rig.width)
    min_disparity_px = scale / config.max_range_m
    if min_disparity_px >= max_disparity_px:
        raise ConfigError(
            f"at max_range_m {config.max_range_m} the disparity is {min_disparity_px:.4g} px, but the search ends at "
            f"half the image width, {max_disparity_px:.4g} px: nothing can be matched; correct the ranges or the "
            "baseline"
        )
    count = DISPARITY_STEP * math.ceil((max_disparity_px + 1.0) / DISPARITY_STEP)
    return SearchRange(min_disparity_px, max_disparity_px, count)


def semi_global_matching(left: GreyImage, right: GreyImage, count: int) -> FloatImage:
    """Return the disparity of the left image `(H, W)`, pixels, NaN where rejected.

    A disparity is rejected if it fails the left-right check, is not unique, or belongs to a small segment.

    Semi-global matching (Hirschmueller 2008, OpenCV's three paths) has steps of 1/16 pixel. In wide images pairs of
    columns are averaged first, and the steps are 1/8 pixel. If the exposures differ, the right image is equalised. The
    search range is at least 0 to `count - 1`, or `count - 2` in wide images (`SearchRange.count`). Both images are
    padded on the left, so that columns are matched even if a part of the search range is outside the right image.
    """
    reduction = 2 if left.shape[1] >= WIDE_COLUMNS else 1
    searched = DISPARITY_STEP * math.ceil(count / (DISPARITY_STEP * reduction))
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=searched,
        blockSize=1,  # larger blocks fatten the edges of rocks
        P1=SMALL_JUMP_PENALTY,
        P2=LARGE_JUMP_PENALTY,
        disp12MaxDiff=MAX_LEFT_RIGHT_PX,
        preFilterCap=MAX_DERIVATIVE,
        uniquenessRatio=MIN_UNIQUENESS_PERCENT,
        speckleWindowSize=0,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    padded_left = _padded_on_the_left(_averaged_columns(left, reduction), searched)
    padded_right = _padded_on_the_left(_averaged_columns(with_exposure_of_left(left, right), reduction), searched)
    steps = matcher.compute(padded_left, padded_right)[:, searched:]
    # In place: pixels of small segments become unmatched.
    cv2.filterSpeckles(steps, MATCHER_UNMATCHED, MAX_SPECKLE_PIXELS, MAX_SPECKLE_STEP)
    matched = steps.astype(F) * F(reduction / SUBPIXELS)
    disparity = np.where(steps < 0, F(np.nan), matched)  # `MATCHER_UNMATCHED` is the only negative value
    return np.ascontiguousarray(np.repeat(disparity, reduction, axis=1)[:, : left.shape[1]])


def _padded_on_the_left(image: GreyImage, columns: int) -> GreyImage:
    """Return the image with its first column repeated on the left."""
    return np.asarray(cv2.copyMakeBorder(image, 0, 0, columns, 0, cv2.BORDER_REPLICATE), np.uint8)


def _averaged_columns(image: GreyImage, reduction: int) -> GreyImage:
    """Return the means of groups of `reduction` columns `(H, ceil(W / reduction))`; the last column is repeated."""
    rows, cols = image.shape
    complete = cv2.copyMakeBorder(image, 0, 0, 0, -cols % reduction, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(complete, (-(-cols // reduction), rows), interpolation=cv2.INTER_AREA), np.uint8)
