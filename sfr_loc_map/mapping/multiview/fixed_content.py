"""Content that stays at the same pixels while the camera moves: the rover's own body, or rows of another pair.

Such content is not ground, and each pair would map it to a different position. A region is fixed if two pairs have the
same grey levels and the same disparities at the same pixels, although ground there would have moved in the image. An
image contains rows of another pair if it was only partially transferred or if rows were repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage, Mask
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.disparity.match_check import TEXTURE_SIGMAS
from sfr_loc_map.mapping.disparity.surfaces import SURFACE_JUMP_PX
from sfr_loc_map.mapping.filters import dilated, square_element
from sfr_loc_map.mapping.findings import Findings
from sfr_loc_map.mapping.pair_view import PairView, ViewImages

STRIDE = 3
"""Every third pixel of every third row is compared. These pixels are called samples; images of samples are `(h, w)`."""
WINDOW_SAMPLES = 9  #: Side of the window over which grey levels are compared, samples.
MIN_SIMILARITY = F(0.8)
"""Minimum similarity of the grey levels of fixed content: 1 for equal windows, and 0.8 if the noise has half the
standard deviation of the content."""
MIN_WINDOW_FRACTION = F(0.6)  #: Minimum fraction of the window with points of both pairs.
MIN_MOTION_PX = 8.0  #: Minimum motion of ground in the image, pixels. With less motion, ground is similar to itself.
REGION_SAMPLES = 5  #: Side of the smallest region, samples. Smaller regions are not removed.
MIN_REGION_FRACTION = 0.003  #: Minimum fraction of the image that is removed.


def without_fixed_content(views: Sequence[PairView], rig: StereoRig) -> tuple[list[PairView], Findings]:
    """Return the views without content that is fixed to the image, and the removed fraction of each image.

    A region that is fixed in two pairs is removed from both.
    """
    greys = [view.images.grey[::STRIDE, ::STRIDE] for view in views]
    regions: dict[int, Mask] = {}
    warnings = []
    for i, j in combinations(range(len(views)), 2):
        noise = F(max(views[i].noise_grey, views[j].noise_grey))
        region = _fixed_region(_has_fixed_disparity(views[i], views[j], rig), greys[i], greys[j], noise)
        fraction = float(region.mean())
        if fraction < MIN_REGION_FRACTION:
            continue
        warnings.append(
            f"{100 * fraction:.0f} % of the image is the same in pairs {i} and {j} although the camera has moved: "
            "these pixels show the rover's own body, or rows of another pair after a partial transfer of an image; "
            "their points are removed; check the camera driver if the body is not in view"
        )
        for index in (i, j):
            regions[index] = region | regions.get(index, np.zeros_like(region))
    statistics = {f"fixed_share_{index}": float(region.mean()) for index, region in regions.items()}
    kept = [_without(view, regions[index]) if index in regions else view for index, view in enumerate(views)]
    return kept, Findings(statistics, tuple(warnings))


def _fixed_region(
    has_fixed_disparity: Mask, first_grey: FloatImage, second_grey: FloatImage, noise: np.float32
) -> Mask:
    """Return the mask of the samples `(h, w)` with content that is fixed to the image."""
    if has_fixed_disparity.mean() < MIN_REGION_FRACTION:
        return np.zeros(has_fixed_disparity.shape, np.bool_)
    is_fixed = has_fixed_disparity & (_similarity(first_grey, second_grey, noise) > MIN_SIMILARITY)
    smallest = square_element(REGION_SAMPLES)
    # Closing joins samples, and opening removes regions smaller than the square. The remaining regions are dilated,
    # because windows at their borders include other content and are less similar.
    closed = cv2.morphologyEx(is_fixed.astype(np.uint8), cv2.MORPH_CLOSE, smallest)
    opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, smallest)
    return dilated(np.asarray(opened).astype(np.bool_), REGION_SAMPLES // 2)


def _has_fixed_disparity(first: PairView, second: PairView, rig: StereoRig) -> Mask:
    """Return the mask of the samples `(h, w)` with the same disparity in both images where ground would have moved."""
    disparity = first.images.disparity[::STRIDE, ::STRIDE]
    same_disparity: Mask = np.abs(disparity - second.images.disparity[::STRIDE, ::STRIDE]) < SURFACE_JUMP_PX
    row, column = np.nonzero(same_disparity)
    x, y = rig.camera.normalised(np.column_stack((column, row)).astype(np.float64) * STRIDE).T
    inverse_depth = disparity[row, column].astype(np.float64) / (rig.fx * rig.baseline_m)
    T_second_first = second.T_lm_left.inverse() @ first.T_lm_left
    rays = np.stack((x, y, np.ones(len(x))))
    moved = T_second_first.rotation @ rays + T_second_first.translation[:, None] * inverse_depth
    with np.errstate(divide="ignore", invalid="ignore"):
        motion_px = np.hypot(rig.fx * (moved[0] / moved[2] - x), rig.fy * (moved[1] / moved[2] - y))
    is_behind = ~(moved[2] > 0.0)
    is_fixed = np.zeros_like(same_disparity)
    is_fixed[row, column] = is_behind | (motion_px > MIN_MOTION_PX)
    return is_fixed


def _similarity(a: FloatImage, b: FloatImage, noise: np.float32) -> FloatImage:
    """Return `1 - mean (a - b)^2 / (var a + var b)` in windows; 0 with too few known samples or too little texture."""
    known = np.isfinite(a) & np.isfinite(b)
    known_fraction = _window_mean(known.astype(F))
    coverage = np.maximum(known_fraction, MIN_WINDOW_FRACTION)  # below this fraction, the similarity is set to 0
    a = np.where(known, a, F(0.0))
    b = np.where(known, b, F(0.0))
    difference = _window_mean(np.square(a - b)) / coverage
    variance_a = _window_mean(a * a) / coverage - np.square(_window_mean(a) / coverage)
    variance_b = _window_mean(b * b) / coverage - np.square(_window_mean(b) / coverage)
    is_textured = np.minimum(variance_a, variance_b) > np.square(F(TEXTURE_SIGMAS) * noise)
    with np.errstate(divide="ignore", invalid="ignore"):
        similarity = F(1.0) - difference / (variance_a + variance_b)
    return np.asarray(np.where(is_textured & (known_fraction > MIN_WINDOW_FRACTION), similarity, F(0.0)), F)


def _window_mean(image: FloatImage) -> FloatImage:
    """Return the mean over the window; samples outside the image are 0."""
    return np.asarray(cv2.blur(image, (WINDOW_SAMPLES, WINDOW_SAMPLES), borderType=cv2.BORDER_CONSTANT), F)


def _without(view: PairView, region: Mask) -> PairView:
    """Return the view without the points of a region of samples `(h, w)`."""
    kept = ~region[view.points.v // STRIDE, view.points.u // STRIDE]
    rows, columns = view.images.disparity.shape
    removed = region.repeat(STRIDE, axis=0).repeat(STRIDE, axis=1)[:rows, :columns]
    images = ViewImages(
        disparity=np.where(removed, F(np.nan), view.images.disparity),
        fusion_sigma=np.where(removed, F(np.inf), view.images.fusion_sigma),
        grey=np.where(removed, F(np.nan), view.images.grey),
    )
    return replace(view, points=view.points.select(kept), images=images)
