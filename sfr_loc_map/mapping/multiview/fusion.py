"""One cloud from up to three stereo pairs.

Every point is reprojected into the disparity images of the other pairs. Where both agree within their errors the point
moves along its own ray to the mean weighted by inverse variance, so that all pairs' points lie on one surface; where
another pair sees through it, the one with the lower variance stays.

Points are samples of the ground and all stay, each on the ray of its own pixel: where ground is seen at a grazing angle
the rows of one image are centimetres apart, and those of another pair lie between them. Only of two points that are
the same sample the one with the larger weight stays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask, median
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.disparity.filters import mad_sigma
from sfr_loc_map.mapping.multiview.pair_view import SHIFT_PX, PairView, ReprojectedPoints, reproject_into_view

F = np.float32

AGREE_SIGMAS = 3.0  #: Differences up to so many standard deviations are taken as noise.
COMMON_SHARE = 0.5
"""Share of a point's variance that all pairs have in common (smoothing of the same shape) and no mean removes."""
SAME_PX = F(0.02)
"""Two points that are seen nearer to each other than this are one sample: images from one position and direction."""
SAMPLE = 4  #: Agreement is measured by every fourth point.
MIN_OVERLAP = 1000  #: Fewer points in common say nothing of poses.
MEDIAN_ABSOLUTE = 0.6745  #: Median of the absolute value of a standard normal variable.
RANGE_WARNING = 1.8  #: Ratio of measured to expected differences in range beyond which two poses are doubted.
GREY_WARNING = 0.45
"""Ratio of grey level differences to those `SHIFT_PX` away beyond which poses are doubted; 0.1-0.3 for right poses."""
MIN_TEXTURE = 2.0
"""Spread of grey level differences `SHIFT_PX` away over that of noise below which grey levels say nothing of poses."""


def fuse_views(views: Sequence[PairView], rig: StereoRig) -> tuple[PointCloud, dict[str, float], tuple[str, ...]]:
    """Return one cloud in LM, figures by name, and what is suspicious; of equal weights the first view's wins."""
    statistics = {"points_in": float(sum(len(view.cloud) for view in views)), "merged": 0.0, "dropped_conflict": 0.0}
    clouds: list[PointCloud] = []
    agreements: dict[str, float] = {}
    warnings: list[str] = []
    for i, view in enumerate(views):
        own_weight = view.images.weight[view.cloud.v, view.cloud.u]
        total_weight, weighted_difference = own_weight.copy(), np.zeros_like(own_weight)
        merged, duplicate, conflict = np.zeros((3, len(view.cloud)), np.bool_)
        for j, other in enumerate(views):
            if j == i:
                continue
            seen = reproject_into_view(view.cloud, other.T_lm_left, other.images, rig)
            index, own = seen.index, own_weight[seen.index]
            sigma = np.sqrt(np.square(view.cloud.sigma[index]) + np.square(seen.deviation))
            agree = np.abs(seen.difference) / sigma <= AGREE_SIGMAS
            weight = np.where(agree, seen.weight, F(0.0))
            total_weight[index] += weight
            weighted_difference[index] += weight * seen.difference
            merged[index] |= agree
            heavier = seen.weight >= own if j < i else seen.weight > own
            duplicate[index] |= agree & heavier & (seen.offset_px < SAME_PX)
            conflict[index] |= heavier & (seen.difference > AGREE_SIGMAS * sigma)
            figures, warning = pose_agreement((i, j), (view, other), seen)
            agreements |= figures
            warnings += [warning] if warning and i < j else []  # once for two views
        kept = ~(duplicate | conflict)
        clouds.append(_moved_along_rays(view, kept, merged, total_weight, weighted_difference))
        statistics["merged"] += int(merged.sum())
        statistics["dropped_conflict"] += int(conflict.sum())
    cloud = replace(PointCloud.concatenate(clouds), fused=len(views) > 1)
    statistics |= {"points": float(len(cloud)), "pairs": float(len(views)), "fused": float(len(views) > 1)}
    return cloud, statistics | agreements, tuple(warnings)


def _moved_along_rays(
    view: PairView, kept: Mask, merged: Mask, total_weight: FloatImage, weighted_difference: FloatImage
) -> PointCloud:
    """Return the points that a view keeps; those that others agree with lie at the weighted mean."""
    cloud, rows = view.cloud.select(kept), np.flatnonzero(kept)
    moved = np.flatnonzero(merged[rows])
    rows = rows[moved]
    total, points = total_weight[rows], cloud.xyz.take(moved, axis=0)
    rays = points - view.T_lm_left.translation.astype(F)
    step = weighted_difference[rows] / total / np.sqrt(np.einsum("ij,ij->i", rays, rays))
    cloud.xyz[moved] = points + rays * step[:, None]
    variance = COMMON_SHARE * np.square(cloud.sigma[moved]) + (1.0 - COMMON_SHARE) / total
    cloud.sigma[moved] = np.sqrt(variance)
    return cloud


def pose_agreement(
    numbers: tuple[int, int], views: tuple[PairView, PairView], seen: ReprojectedPoints
) -> tuple[dict[str, float], str]:
    """Return how well the points of one view agree with another, by name, and a line if their poses are in doubt.

    Range differences are compared with what is expected of correct sigmas and poses, grey level differences with those
    `SHIFT_PX` away: a wrong yaw shows there on any texture. NaN where there is too little texture.
    """
    view, other = views
    i, j = numbers
    common = len(seen.index)
    figures = {f"overlap_{i}_{j}": common / max(len(view.cloud), 1)}
    if common == 0:
        return figures, ""
    difference = seen.difference[::SAMPLE]
    own = view.cloud.sigma[seen.index[::SAMPLE]]
    normalised = np.abs(difference) / np.sqrt(np.square(own) + np.square(seen.deviation[::SAMPLE]))
    middle = median(difference)
    grey, shifted = (_spread(item[::SAMPLE]) for item in (seen.grey_difference, seen.grey_difference_shifted))
    textured = shifted > MIN_TEXTURE * max(view.noise_grey, other.noise_grey)
    range_ratio = float(np.float32(median(normalised)) / MEDIAN_ABSOLUTE)
    grey_ratio = grey / shifted if textured else math.nan
    figures |= {
        f"difference_median_m_{i}_{j}": middle,
        f"difference_spread_m_{i}_{j}": mad_sigma(difference - np.float32(middle)),
        f"difference_over_sigma_{i}_{j}": range_ratio,
        f"grey_difference_over_beside_{i}_{j}": grey_ratio,
    }
    if common <= MIN_OVERLAP or not (range_ratio > RANGE_WARNING or grey_ratio > GREY_WARNING):
        return figures, ""
    return figures, (
        f"pairs {i} and {j} disagree where they overlap: ranges differ by {range_ratio:.1f} times what is "
        f"expected, grey levels by {grey_ratio:.2f} of what they differ {SHIFT_PX} pixels away: check the "
        "baseline and their poses, or have the poses fitted (refine_poses)"
    )


def _spread(values: FloatImage) -> float:
    known = values[np.isfinite(values)]
    return mad_sigma(known - median(known)) if len(known) else math.nan
