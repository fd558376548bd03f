"""Content that stays at its pixels while the camera moves: the rover's own body, or rows of another pair.

Its points are those of no ground: each pair puts them elsewhere. A region counts as such if two pairs show the same
grey levels and the same disparities at the same pixels, although ground there would have moved in the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.multiview.pair_view import PairView

F = np.float32

STEP = 3  #: Every third pixel of every third row is compared.
WINDOW = 9  #: Samples along each side of the window that grey levels are compared over.
MIN_LIKENESS = F(0.8)
MIN_KNOWN = F(0.6)  #: Share of the window in which both pairs must have points: more than at the border of the image.
SAME_DISPARITY_PX = 1.0
MIN_MOTION_PX = 8.0
"""Ground must move by so much in the image from one pair to the other: less leaves it like itself."""
MIN_SPREAD = F(2.0)  #: Spread of grey levels in the window over that of the noise below which they say nothing.
OPENING = 5  #: Samples along each side of the smallest region.
MIN_SHARE = 0.003  #: Share of the image below which nothing is taken out.


def without_fixed_content(
    views: Sequence[PairView], rig: StereoRig
) -> tuple[Sequence[PairView], dict[str, float], tuple[str, ...]]:
    """Return views without content fixed to the image (both of two pairs lose it), its share by name, and a line."""
    fixed: dict[int, Mask] = {}
    warnings = []
    for i, j in combinations(range(len(views)), 2):
        region = _fixed_region(views[i], views[j], rig)
        share = float(region.mean())
        if share < MIN_SHARE:
            continue
        warnings.append(
            f"{100 * share:.0f} % of the image is the same in pairs {i} and {j} although the camera has moved: the "
            "rover's own body, or images of another pair; its points are left out"
        )
        for number in (i, j):
            fixed[number] = region | fixed.get(number, np.zeros_like(region))
    statistics = {f"fixed_share_{number}": float(region.mean()) for number, region in fixed.items()}
    moving = [_without(view, fixed[number]) if number in fixed else view for number, view in enumerate(views)]
    return moving, statistics, tuple(warnings)


def _fixed_region(first: PairView, second: PairView, rig: StereoRig) -> Mask:
    """Return which samples `(H/3, W/3)` belong to content that is fixed to the image."""
    still = _still(first, second, rig)
    if still.mean() < MIN_SHARE:
        return np.zeros(still.shape, np.bool_)
    noise = F(max(first.noise_grey, second.noise_grey))
    likeness = _likeness(first.images.grey[::STEP, ::STEP], second.images.grey[::STEP, ::STEP], noise)
    alike = still & (likeness > MIN_LIKENESS)
    square = np.ones((OPENING, OPENING), np.uint8)
    core = cv2.morphologyEx(alike.astype(np.uint8), cv2.MORPH_CLOSE, square)
    core = cv2.morphologyEx(core, cv2.MORPH_OPEN, square)
    return np.asarray(cv2.dilate(core, square)).astype(np.bool_)


def _still(first: PairView, second: PairView, rig: StereoRig) -> Mask:
    """Tell which samples `(H/3, W/3)` have the same disparity in both images although ground there has moved."""
    disparity = first.disparity_px[::STEP, ::STEP]
    still: Mask = np.abs(disparity - second.disparity_px[::STEP, ::STEP]) < SAME_DISPARITY_PX
    i, j = np.nonzero(still)
    x, y = (j * STEP - rig.cx) / rig.fx, (i * STEP - rig.cy) / rig.fy
    nearness = disparity[i, j].astype(np.float64) / (rig.fx * rig.baseline_m)  # inverse depth
    motion = second.T_lm_left.inverse() @ first.T_lm_left
    moved = motion.rotation @ np.stack((x, y, np.ones(len(x)))) + motion.translation[:, None] * nearness
    with np.errstate(divide="ignore", invalid="ignore"):
        shift_px = rig.fx * np.hypot(moved[0] / moved[2] - x, moved[1] / moved[2] - y)
    still[i, j] = ~(moved[2] > 0.0) | (shift_px > MIN_MOTION_PX)
    return still


def _likeness(a: FloatImage, b: FloatImage, noise: np.float32) -> FloatImage:
    """Return `1 - mean (a - b)^2 / (var a + var b)` around samples; 0 for too few known ones or no texture."""
    known = np.isfinite(a) & np.isfinite(b)
    share = _window_mean(known.astype(F))
    a, b = np.where(known, a, F(0.0)), np.where(known, b, F(0.0))
    count = np.maximum(share, F(1e-3))
    difference = _window_mean(np.square(a - b)) / count
    variances = [_window_mean(image * image) / count - np.square(_window_mean(image) / count) for image in (a, b)]
    textured = np.minimum(*variances) > np.square(MIN_SPREAD * noise)
    with np.errstate(divide="ignore", invalid="ignore"):
        likeness = F(1.0) - difference / (variances[0] + variances[1])
    return np.asarray(np.where(textured & (share > MIN_KNOWN), likeness, F(0.0)), F)


def _window_mean(image: FloatImage) -> FloatImage:
    return np.asarray(cv2.blur(image, (WINDOW, WINDOW), borderType=cv2.BORDER_CONSTANT), F)


def _without(view: PairView, region: Mask) -> PairView:
    kept = ~region[view.cloud.v // STEP, view.cloud.u // STEP]
    disparity = view.disparity_px.copy()
    rows, columns = disparity.shape
    disparity[region.repeat(STEP, axis=0).repeat(STEP, axis=1)[:rows, :columns]] = np.nan
    return replace(view, cloud=view.cloud.select(kept), disparity_px=disparity)
