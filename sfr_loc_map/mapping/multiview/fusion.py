"""One cloud from up to three stereo pairs.

Every point is projected into the disparity images of the other pairs. If both ranges agree within their uncertainty,
the point moves along its own ray to the inverse-variance weighted mean, so that the points of all pairs are on one
surface. If another pair with a larger weight observes a farther surface at that pixel, both pairs are in conflict, and
the point is dropped. A nearer surface of the other pair only hides the point. A conflict with one pair outweighs
agreement with a third pair, because a missing point is preferred to a wrong point. The weight of a point is
`1 / sigma^2`, reduced near the image border. If both weights are equal, the earlier pair is preferred.

The remaining points are kept, each on the ray of its own pixel. At grazing angles, the rows of one image are
centimetres apart on the ground, and the rows of another pair are between them, so keeping all points increases
the density there. If two points agree and are at the same position in an image (`SAME_POSITION_PX`), the point with the
larger weight is kept. Beside holes and disparity jumps, where a pair is not compared (`projection`), both are kept: the
same map given three times has 2 % more points than once.

A pair that observes a point from much farther away than the point's own pair (`MAX_RANGE_FACTOR`) is ignored at that
point. The surface of the distant pair is smoothed over a larger part of the ground, for example over the edges of
rocks, and the sigma of this surface is too small there.

Two ranges are compared along the ray of the other camera, and their difference is applied along the point's own ray.
This approximation assumes that the cameras are at nearly the same position, as in a panorama. With cameras that are
metres apart, converting the difference reduces the error by at most 5 % (measurements/mapper_trials.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatArray32, Mask
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.findings import Findings
from sfr_loc_map.mapping.multiview.pose_agreement import Overlap, overlap_of
from sfr_loc_map.mapping.multiview.projection import Observations, point_weights, project_into_view
from sfr_loc_map.mapping.pair_view import PairView, ViewPoints

AGREE_SIGMAS = 3.0  #: Ranges that differ by up to this many standard deviations agree.
COMMON_VARIANCE = 0.5
"""Fraction of a point's variance that is common to all pairs, because all pairs are smoothed in the same way. Averaging
does not reduce this fraction."""
MAX_RANGE_FACTOR = F(1.25)
"""A view is ignored at a point if the range from the camera of the view exceeds this multiple of the range from the
point's own camera."""
SAME_POSITION_PX = F(0.02)  #: Points closer than this in an image are at the same position, pixels.


class FusedViews(NamedTuple):
    """Result of the fusion."""

    points: ViewPoints  #: N points of all views.
    pair_index: NDArray[np.uint8]  #: `(N,)`, index of the pair of each point.
    findings: Findings  #: Numbers of points before and after the fusion.
    #: Overlap of view i with view j by (i, j), for the comparison of the poses (`pose_agreement`).
    overlaps: Mapping[tuple[int, int], Overlap]


class ComparedPoints(NamedTuple):
    """The points of one view after their comparison with all other views."""

    kept: ViewPoints  #: The kept points, at the weighted means of their ranges.
    agreeing_count: int  #: Number of points with which another view agrees, including dropped points.
    conflict_count: int  #: Number of points that are dropped because of a conflict.
    overlaps: Mapping[int, Overlap]  #: Overlap with each other view, by its index.


class PointRanges(NamedTuple):
    """The N points of a view as their own camera observes them."""

    rays: FloatArray32  #: `(N, 3)`, vector from the camera to the point, metres, LM.
    ranges: FloatArray32  #: `(N,)`, length of this vector, metres.
    sigma: FloatArray32  #: `(N,)`, standard deviation of the range, metres (`ViewPoints.fusion_sigma`).
    weight: FloatArray32  #: `(N,)`, weight of the range, 1 / m^2.


class Judgement(NamedTuple):
    """Judgement of the N points of a view by another view, `(N,)` each.

    At points that the other view does not observe, no flag is set, and all numbers are 0.
    """

    weight: FloatArray32  #: Weight of the observed range, 1 / m^2; 0 if the ranges do not agree.
    difference: FloatArray32  #: Observed range minus the range of the point, metres; 0 if the ranges do not agree.
    sigma: FloatArray32  #: Standard deviation of the observed range, metres.
    agrees: Mask  #: Whether the ranges agree.
    is_duplicate: Mask  #: Whether the other view is preferred and has a point at the same position in its image.
    is_conflict: Mask  #: Whether the other view is preferred and observes a farther surface.


def fuse_views(views: Sequence[PairView], rig: StereoRig) -> FusedViews:
    """Return the points of all views in LM without duplicates and conflicts.

    Each point is moved along its ray to the weighted mean of the views that agree.
    """
    parts = [_compare_points(index, views, rig) for index in range(len(views))]
    points = ViewPoints.concatenated([part.kept for part in parts])
    statistics = {
        "points_in": float(sum(view.points.size for view in views)),
        "merged": float(sum(part.agreeing_count for part in parts)),
        "dropped_conflict": float(sum(part.conflict_count for part in parts)),
        "points": float(points.size),
        "pairs": float(len(views)),
        "fused": float(len(views) > 1),
    }
    warnings = () if points.size else ("the fused cloud has no points: the other warnings state the causes",)
    return FusedViews(
        points=points,
        pair_index=np.repeat(np.arange(len(views), dtype=np.uint8), [part.kept.size for part in parts]),
        findings=Findings(statistics, warnings),
        overlaps={(i, j): overlap for i, part in enumerate(parts) for j, overlap in part.overlaps.items()},
    )


def _compare_points(index: int, views: Sequence[PairView], rig: StereoRig) -> ComparedPoints:
    """Return the points of a view that are kept, fused with the observations of all other views.

    To add a test of points across pairs, add a flag to `Judgement`, set the flag in `_judge`, and drop the points here.
    """
    points = views[index].points
    own = _ranges_of_points(views[index])
    judgements = []
    overlaps = {}
    agrees = np.zeros(points.size, np.bool_)
    is_duplicate = np.zeros(points.size, np.bool_)
    is_conflict = np.zeros(points.size, np.bool_)
    for other_index, other in enumerate(views):
        if other_index == index:
            continue
        observed = project_into_view(points.xyz, other.T_lm_left, other.images, rig)
        overlaps[other_index] = overlap_of(points, observed)
        judgement = _judge(observed, own, is_earlier=other_index < index)
        judgements.append(judgement)
        agrees |= judgement.agrees
        is_duplicate |= judgement.is_duplicate
        is_conflict |= judgement.is_conflict
    fused = _at_weighted_mean(points, own, judgements, agrees)
    return ComparedPoints(
        kept=fused.select(~(is_duplicate | is_conflict)),
        agreeing_count=int(np.count_nonzero(agrees)),
        conflict_count=int(np.count_nonzero(is_conflict)),
        overlaps=overlaps,
    )


def _ranges_of_points(view: PairView) -> PointRanges:
    """Return the ranges of the points of a view from their own camera."""
    rays = view.points.xyz - view.T_lm_left.translation.astype(F)
    return PointRanges(
        rays=rays,
        ranges=np.sqrt(np.einsum("ij,ij->i", rays, rays)),
        sigma=view.points.fusion_sigma,
        weight=point_weights(view),
    )


def _judge(observed: Observations, own: PointRanges, *, is_earlier: bool) -> Judgement:
    """Judge the points of a view by the observations of another view.

    The other view is preferred at a point if its weight there is larger, or if both weights are equal and the other
    view is the earlier view. The other view is ignored at points that it observes from too far away
    (`MAX_RANGE_FACTOR`).
    """
    is_preferred = observed.weight >= own.weight if is_earlier else observed.weight > own.weight
    is_used = observed.point_range <= MAX_RANGE_FACTOR * own.ranges
    sigma = observed.difference_sigma(own.sigma)
    agrees = is_used & (np.abs(observed.difference) / sigma <= AGREE_SIGMAS)  # false if the difference is NaN
    is_farther = is_used & (observed.difference > AGREE_SIGMAS * sigma)
    return Judgement(
        weight=np.where(agrees, observed.weight, F(0.0)),
        difference=np.where(agrees, observed.difference, F(0.0)),
        sigma=observed.fusion_sigma,
        agrees=agrees,
        is_duplicate=agrees & is_preferred & (observed.sample_distance_px < SAME_POSITION_PX),
        is_conflict=is_farther & is_preferred,
    )


def _at_weighted_mean(
    points: ViewPoints, own: PointRanges, judgements: Sequence[Judgement], agrees: Mask
) -> ViewPoints:
    """Return the points of a view, moved along their rays to the weighted mean of their range and the agreeing ranges.

    The point and the agreeing views have the ranges r_i, their standard deviations s_i and the weights w_i. The new
    range is `sum w_i r_i / sum w_i`. Its variance is `c sigma^2 + (1 - c) sum w_i^2 s_i^2 / (sum w_i)^2`, where sigma
    is the standard deviation of the point and c the fraction of the variance that is common to all pairs. Away from the
    image border the weights are `1 / s_i^2`, and the last term is `(1 - c) / sum w_i`.

    `agrees` `(N,)` is the mask of the points with which at least one view agrees. The sigma of other points is kept.
    """
    total_weight = own.weight.copy()
    weighted_difference = np.zeros_like(own.weight)
    weighted_variance = np.square(own.weight * own.sigma)
    for judgement in judgements:
        total_weight += judgement.weight
        weighted_difference += judgement.weight * judgement.difference
        weighted_variance += np.square(judgement.weight * judgement.sigma)
    relative_step = weighted_difference / total_weight / own.ranges
    variance_of_mean = weighted_variance / np.square(total_weight)  # if all errors were independent
    variance = COMMON_VARIANCE * np.square(own.sigma) + (1.0 - COMMON_VARIANCE) * variance_of_mean
    return points._replace(
        xyz=points.xyz + own.rays * relative_step[:, None], fusion_sigma=np.where(agrees, np.sqrt(variance), own.sigma)
    )
