"""One cloud from up to three stereo pairs.

Every point is reprojected into the disparity images of the other pairs. Where both agree within their errors the point
moves along its own ray to the mean weighted by inverse variance, so that all pairs' points lie on one surface; where
another pair sees through it, the one with the lower variance stays.

Points are samples of the ground and all stay, each on the ray of its own pixel: where ground is seen at a grazing angle
the rows of one image are centimetres apart, and those of another pair lie between them. Only of two points that are
the same sample the one with the larger weight stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.multiview.pose_agreement import PoseAgreement
from sfr_loc_map.mapping.multiview.view import View
from sfr_loc_map.mapping.multiview.view_reprojection import ReprojectedPoints, ViewImages, reproject_into_view

F = np.float32

AGREE_SIGMAS = 3.0
"""Differences up to so many standard deviations are taken as noise."""
COMMON_SHARE = 0.5
"""Share of a point's variance that all pairs have in common (smoothing of the same shape) and no mean removes."""
SAME_PX = F(0.02)
"""Two points that are seen nearer to each other than this are one sample: images from one position and direction."""


@dataclass(frozen=True, slots=True, eq=False)
class Fusion:
    """A fused cloud and how well its parts agreed.

    Attributes:
        cloud: Points in LM; of one view they are its own, not fused.
        statistics: Figures by name.
        warnings: What is suspicious, one line each.
    """

    cloud: PointCloud
    statistics: dict[str, float]
    warnings: tuple[str, ...]


def fuse_views(views: Sequence[View], rig: StereoRig) -> Fusion:
    """Return one cloud of all pairs.

    Args:
        views: One per pair, in the order of their points' `pair`.
        rig: Rig of all pairs.
    """
    images = [ViewImages(view.disparity_px, view.weight_image(), view.grey_image()) for view in views]
    clouds: list[PointCloud] = []
    agreements: list[PoseAgreement] = []
    statistics = {"points_in": float(sum(len(view.cloud) for view in views)), "merged": 0.0, "dropped_conflict": 0.0}
    for i, view in enumerate(views):
        accumulator = FusionAccumulator(view, images[i].weight)
        for j, other in enumerate(views):
            if j != i:
                points = reproject_into_view(view.cloud, other.T_lm_left, images[j], rig)
                accumulator.add(points, before=j < i)
                agreements.append(PoseAgreement.measure((i, j), (view, other), points))
        clouds.append(accumulator.cloud())
        statistics["merged"] += accumulator.merged
        statistics["dropped_conflict"] += accumulator.conflicts
    cloud = replace(PointCloud.concatenate(clouds), fused=len(views) > 1)
    statistics |= {"points": float(len(cloud)), "pairs": float(len(views)), "fused": float(len(views) > 1)}
    for agreement in agreements:
        statistics |= agreement.statistics()
    return Fusion(cloud, statistics, tuple(line for agreement in agreements for line in agreement.warnings()))


class FusionAccumulator:
    """Points of one view and the weighted sum of what the others say of them."""

    def __init__(self, view: View, weight: FloatImage) -> None:
        """Begin with the view's own points; `weight` `(H, W)` is its weight image."""
        self._view = view
        count = len(view.cloud)
        self._own_weight = weight[view.cloud.v, view.cloud.u]
        self._weight = self._own_weight.copy()
        self._weighted_difference = np.zeros_like(self._own_weight)
        self._partners = np.zeros(count, np.uint8)
        self._conflict = np.zeros(count, np.bool_)
        self._duplicate = np.zeros(count, np.bool_)

    @property
    def merged(self) -> int:
        """Number of points that another view agrees with."""
        return int((self._partners > 0).sum())

    @property
    def conflicts(self) -> int:
        """Number of points that another view with the lower variance sees through."""
        return int(self._conflict.sum())

    def add(self, points: ReprojectedPoints, *, before: bool) -> None:
        """Take in what another view says; `before` tells whether it precedes this one: it then wins at equal weight."""
        index, own = points.index, self._own_weight[points.index]
        sigma = np.sqrt(np.square(self._view.cloud.sigma[index]) + np.square(points.deviation))
        agree = np.abs(points.difference) / sigma <= AGREE_SIGMAS
        weight = np.where(agree, points.weight, F(0.0))
        self._weight[index] += weight
        self._weighted_difference[index] += weight * points.difference
        self._partners[index] += agree
        heavier = (points.weight > own) | ((points.weight == own) & before)
        self._duplicate[index] |= agree & heavier & (points.offset_px < SAME_PX)
        self._conflict[index] |= heavier & (points.difference > AGREE_SIGMAS * sigma)

    def cloud(self) -> PointCloud:
        """Return the points that this view keeps, moved along their rays."""
        kept = ~(self._duplicate | self._conflict)
        cloud = self._view.cloud.select(kept)
        rows = np.flatnonzero(kept)
        merged = np.flatnonzero(self._partners[rows])
        rows = rows[merged]
        total, points = self._weight[rows], cloud.xyz.take(merged, axis=0)
        rays = points - self._view.T_lm_left.translation.astype(F)
        step = self._weighted_difference[rows] / total / np.sqrt(np.einsum("ij,ij->i", rays, rays))
        cloud.xyz[merged] = points + rays * step[:, None]
        variance = COMMON_SHARE * np.square(cloud.sigma[merged]) + (1.0 - COMMON_SHARE) / total
        cloud.sigma[merged] = np.sqrt(variance)
        return cloud
