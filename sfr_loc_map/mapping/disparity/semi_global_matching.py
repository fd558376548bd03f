"""Initial disparity by semi-global matching (Hirschmueller 2008), to a fraction of a pixel."""

from __future__ import annotations

import math

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage, GreyImage
from sfr_loc_map.mapping.disparity.right_image_correction import with_exposure_of_left

DISPARITY_STEP = 16  #: OpenCV's matcher requires a multiple of this number of disparities.
WIDE_COLUMNS = 800
"""Images of at least this width, pixels, are matched at half their width. This takes a quarter of the time, gives less
noise, and loses little, because the refinement uses cells of two pixels. Narrower images are matched at full width,
because edges are sharper (measurements/mapper_trials.md)."""
SUBPIXELS = 16  #: Number of disparity steps per pixel of OpenCV's matcher.
SMALL_JUMP_PENALTY = 8
"""P1 of Hirschmueller (2008): cost of a change of disparity by one pixel. OpenCV recommends 8 per channel."""
LARGE_JUMP_PENALTY = 32  #: P2 of Hirschmueller (2008): cost of a larger change. OpenCV recommends 32 per channel.
MAX_LEFT_RIGHT_PX = 1  #: Maximum difference in the left-right check, pixels of the matched images; the usual value.
MAX_DERIVATIVE = 31  #: Derivatives of the images are clipped to this, grey levels (measurements/mapper_trials.md).
MIN_UNIQUENESS_PERCENT = 2
"""Minimum margin between the best and the second best cost, percent. OpenCV recommends 5 to 15. A smaller margin
suffices, because wrong matches are rejected after the refinement."""
MAX_SPECKLE_PIXELS = 60
"""Maximum size of a segment that is removed, pixels of the matched images. OpenCV recommends 50 to 200. In wide images
a matched pixel is two pixels wide."""
MAX_SPECKLE_STEP = SUBPIXELS
"""Maximum difference of neighbours within a segment, steps of the matcher: one pixel of the matched images."""
MATCHER_UNMATCHED = -SUBPIXELS  #: The matcher's value of an unmatched pixel: `minDisparity - 1`, in steps.


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
