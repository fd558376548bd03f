"""Content that stays at its pixels while the camera moves: the rover's own body, or rows of another pair.

Its points are those of no ground: each pair puts them elsewhere. A region counts as such if two pairs show the same
grey levels and the same disparities at the same pixels, although ground there would have moved in the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.jit import jit
from sfr_loc_map.mapping.multiview.view import View

F = np.float32

STEP = 3
"""Every third pixel of every third row is compared."""
WINDOW = 9
"""Samples along each side of the window that grey levels are compared over."""
MIN_LIKENESS = F(0.8)
MIN_KNOWN = F(0.6)
"""Share of the window in which both pairs must have points: more than at the border of the image."""
SAME_DISPARITY_PX = 1.0
MIN_MOTION_PX = 8.0
"""Ground must move by so much in the image from one pair to the other: less leaves it like itself."""
MIN_SPREAD = F(2.0)
"""Spread of grey levels in the window over that of the noise below which they say nothing."""
OPENING = 5
"""Samples along each side of the smallest region."""
MIN_SHARE = 0.003
"""Share of the image below which nothing is taken out."""


@dataclass(frozen=True, slots=True, eq=False)
class MovingViews:
    """Views without the points that do not move with the ground.

    Attributes:
        views: The views.
        statistics: `fixed_share_i`, the share of the image of each pair that was taken out, if any.
        warnings: What was taken out, one line each.
    """

    views: Sequence[View]
    statistics: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def without_fixed_content(views: Sequence[View], rig: StereoRig) -> MovingViews:
    """Return views without points of content that is fixed to the image; which of two pairs is right stays open."""
    fixed: dict[int, Mask] = {}
    warnings = []
    greys = [_grey_samples(view) for view in views] if len(views) > 1 else []
    for i, j in combinations(range(len(views)), 2):
        region = _fixed_region((views[i], views[j]), (greys[i], greys[j]), rig)
        share = float(region.mean())
        if share < MIN_SHARE:
            continue
        warnings.append(
            f"{100 * share:.0f} % of the image is the same in pairs {i} and {j} although the camera has moved: the "
            "rover's own body, or images of another pair; its points are left out"
        )
        for number in (i, j):
            fixed[number] = region | fixed.get(number, np.zeros_like(region))
    if not fixed:
        return MovingViews(views)
    statistics = {f"fixed_share_{number}": float(region.mean()) for number, region in fixed.items()}
    moving = [_without(view, fixed[number]) if number in fixed else view for number, view in enumerate(views)]
    return MovingViews(moving, statistics, tuple(warnings))


def _grey_samples(view: View) -> FloatImage:
    """Return the grey level of each sample `(H/3, W/3)` that has a point, NaN elsewhere."""
    grey = np.full(view.disparity_px[::STEP, ::STEP].shape, np.nan, F)
    _fill_samples(view.cloud.v, view.cloud.u, view.cloud.intensity, grey)
    return grey


@jit
def _fill_samples(
    v: NDArray[np.uint16], u: NDArray[np.uint16], values: NDArray[np.float32], samples: FloatImage
) -> None:
    for n in range(len(v)):
        if v[n] % STEP == 0 and u[n] % STEP == 0:
            samples[v[n] // STEP, u[n] // STEP] = values[n]


def _fixed_region(views: tuple[View, View], greys: tuple[FloatImage, FloatImage], rig: StereoRig) -> Mask:
    """Return which samples `(H/3, W/3)` belong to content that is fixed to the image."""
    motion = Pose.of(views[1].T_lm_left.inverse() @ views[0].T_lm_left)
    still = _still(views[0].disparity_px, views[1].disparity_px, motion, rig.camera)
    if still.mean() < MIN_SHARE:
        return np.zeros(still.shape, np.bool_)
    noise = F(max(view.noise_grey for view in views))
    alike = still & (_likeness(*greys, noise) > MIN_LIKENESS)
    square = np.ones((OPENING, OPENING), np.uint8)
    core = cv2.morphologyEx(alike.astype(np.uint8), cv2.MORPH_CLOSE, square)
    core = cv2.morphologyEx(core, cv2.MORPH_OPEN, square)
    return np.asarray(cv2.dilate(core, square)).astype(np.bool_)


@jit
def _still(first: FloatImage, second: FloatImage, motion: Pose, camera: StereoCamera) -> Mask:
    """Tell which samples `(H/3, W/3)` have the same disparity in both images although ground there has moved.

    Args:
        first: `(H, W)`, pixels, NaN where unknown.
        second: The same of the other view.
        motion: Takes points in the first left camera to the second.
        camera: Camera of both.
    """
    height, width = first.shape
    rows, columns = (height + STEP - 1) // STEP, (width + STEP - 1) // STEP
    out = np.zeros((rows, columns), np.bool_)
    r, t = motion.rotation, motion.position
    for i in range(rows):
        y = (i * STEP - camera.cy) / camera.fy
        for j in range(columns):
            disparity = first[i * STEP, j * STEP]
            if not abs(disparity - second[i * STEP, j * STEP]) < SAME_DISPARITY_PX:
                continue
            x = (j * STEP - camera.cx) / camera.fx
            nearness = disparity / (camera.fx * camera.baseline_m)  # inverse depth, by which the motion is scaled
            z = r[2, 0] * x + r[2, 1] * y + r[2, 2] + t[2] * nearness
            if z > 0.0:
                du = (r[0, 0] * x + r[0, 1] * y + r[0, 2] + t[0] * nearness) / z - x
                dv = (r[1, 0] * x + r[1, 1] * y + r[1, 2] + t[1] * nearness) / z - y
                out[i, j] = camera.fx * np.hypot(du, dv) > MIN_MOTION_PX
            else:
                out[i, j] = True
    return out


def _likeness(a: FloatImage, b: FloatImage, noise: np.float32) -> FloatImage:
    """Return `1 - mean (a - b)^2 / (var a + var b)` around each sample: 1 for equal images, 0 for unrelated ones.

    It is 0 where too few samples are known or there is no texture.
    """
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
    """Return the mean over the window around each sample; beyond the border there is nothing."""
    return np.asarray(cv2.blur(image, (WINDOW, WINDOW), borderType=cv2.BORDER_CONSTANT), F)


def _without(view: View, region: Mask) -> View:
    """Return a view without the points of a region of samples."""
    kept = ~region[view.cloud.v // STEP, view.cloud.u // STEP]
    disparity = view.disparity_px.copy()
    rows, columns = disparity.shape
    disparity[region.repeat(STEP, axis=0).repeat(STEP, axis=1)[:rows, :columns]] = np.nan
    return replace(view, cloud=view.cloud.select(kept), disparity_px=disparity)
