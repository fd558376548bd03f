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

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatArray32, Mask
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.filters import with_value
from sfr_loc_map.mapping.findings import Findings
from sfr_loc_map.mapping.multiview.pose_agreement import agreement_of_poses
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


class Comparison(NamedTuple):
    """The N points of a view compared with the observations of another view, `(N,)` each.

    At points that the other view does not observe, no flag is set, and all numbers are 0.
    """

    weight: FloatArray32  #: Weight of the observed range, 1 / m^2; 0 if the ranges do not agree.
    difference: FloatArray32  #: Observed range minus the range of the point, metres; 0 if the ranges do not agree.
    sigma: FloatArray32  #: Standard deviation of the observed range, metres.
    agrees: Mask  #: Whether the ranges agree.
    is_duplicate: Mask  #: Whether the other view is preferred and has a point at the same position in its image.
    is_conflict: Mask  #: Whether the other view is preferred and observes a farther surface.


class FusedPoints(NamedTuple):
    """The points of one view after the fusion with all other views."""

    points: ViewPoints  #: The kept points, at the weighted means of their ranges.
    agreeing_count: int  #: Number of points with which another view agrees, including dropped points.
    conflict_count: int  #: Number of points that are dropped because of a conflict.
    findings: Findings  #: Agreement of the pose with the pose of each other view (`pose_agreement`).


def fuse_views(views: Sequence[PairView], rig: StereoRig) -> tuple[list[ViewPoints], Findings]:
    """Return the points of each view in LM without duplicates and conflicts, and findings about the views.

    Each point is moved along its ray to the weighted mean of the views that agree. The findings are the numbers of
    points before and after the fusion, and the agreement of the poses.
    """
    fused = [_fuse_points(index, views, rig) for index in range(len(views))]
    point_count = sum(part.points.size for part in fused)
    statistics = {
        "points_in": float(sum(view.points.size for view in views)),
        "merged": float(sum(part.agreeing_count for part in fused)),
        "dropped_conflict": float(sum(part.conflict_count for part in fused)),
        "points": float(point_count),
        "pairs": float(len(views)),
        "fused": float(len(views) > 1),
    }
    warnings = () if point_count else ("the fused cloud has no points: the other warnings state the causes",)
    findings = Findings(statistics, warnings)
    for part in fused:
        findings += part.findings
    return [part.points for part in fused], findings


def _fuse_points(index: int, views: Sequence[PairView], rig: StereoRig) -> FusedPoints:
    """Return the points of a view that are kept, fused with the observations of all other views.

    The point and the agreeing views have the ranges r_i, their standard deviations s_i and the weights w_i. The new
    range is `sum w_i r_i / sum w_i`. Its variance is `c sigma^2 + (1 - c) sum w_i^2 s_i^2 / (sum w_i)^2`, where sigma
    is the standard deviation of the point and c the fraction of the variance that is common to all pairs. Away from the
    image border the weights are `1 / s_i^2`, and the last term is `(1 - c) / sum w_i`. The sigma of a point is kept if
    no view agrees.

    To add a test of points across pairs, add a flag to `Comparison`, set the flag in `_compare`, and drop the points
    here.
    """
    points = views[index].points
    sigma = points.fusion_sigma
    rays = points.xyz - views[index].T_lm_left.translation.astype(F)
    ranges = np.sqrt(np.einsum("ij,ij->i", rays, rays))
    weight = point_weights(views[index])

    total_weight = weight.copy()
    weighted_difference = np.zeros_like(weight)
    weighted_variance = np.square(weight * sigma)
    agrees = np.zeros(points.size, np.bool_)
    is_duplicate = np.zeros(points.size, np.bool_)
    is_conflict = np.zeros(points.size, np.bool_)
    findings = Findings()
    for other_index in range(len(views)):
        if other_index == index:
            continue
        compared, agreement = _compare_views(views, index, other_index, ranges, weight, rig)
        findings += agreement
        total_weight += compared.weight
        weighted_difference += compared.weight * compared.difference
        weighted_variance += np.square(compared.weight * compared.sigma)
        agrees |= compared.agrees
        is_duplicate |= compared.is_duplicate
        is_conflict |= compared.is_conflict
        del compared  # its memory is used again by the next comparison

    relative_step = weighted_difference / total_weight / ranges
    variance_of_mean = weighted_variance / np.square(total_weight)  # if all errors were independent
    variance = COMMON_VARIANCE * np.square(sigma) + (1.0 - COMMON_VARIANCE) * variance_of_mean
    fused = points._replace(
        xyz=points.xyz + rays * relative_step[:, None], fusion_sigma=np.where(agrees, np.sqrt(variance), sigma)
    )
    return FusedPoints(
        points=fused.select(~(is_duplicate | is_conflict)),
        agreeing_count=int(np.count_nonzero(agrees)),
        conflict_count=int(np.count_nonzero(is_conflict)),
        findings=findings,
    )


def _compare_views(
    views: Sequence[PairView], index: int, other_index: int, ranges: FloatArray32, weight: FloatArray32, rig: StereoRig
) -> tuple[Comparison, Findings]:
    """Compare the points of a view with another view, given the ranges and weights of the points `(N,)`.

    The findings are the agreement of the poses of both views.
    """
    points = views[index].points
    other = views[other_index]
    observed = project_into_view(points.xyz, other.T_lm_left, other.images, rig)
    compared = _compare(observed, ranges, points.fusion_sigma, weight, is_earlier=other_index < index)
    return compared, agreement_of_poses(views, index, other_index, observed)


def _compare(
    observed: Observations, ranges: FloatArray32, sigma: FloatArray32, weight: FloatArray32, *, is_earlier: bool
) -> Comparison:
    """Compare points, given the ranges from their own camera, their sigma and weights, with another view.

    The other view is preferred at a point if its weight there is larger, or if both weights are equal and the other
    view is the earlier view. The other view is ignored at points that it observes from too far away
    (`MAX_RANGE_FACTOR`).
    """
    is_preferred = observed.weight >= weight if is_earlier else observed.weight > weight
    is_used = observed.point_range <= MAX_RANGE_FACTOR * ranges
    difference_sigma = observed.difference_sigma(sigma)
    agrees = is_used & (np.abs(observed.difference) / difference_sigma <= AGREE_SIGMAS)  # false for a NaN difference
    is_farther = is_used & (observed.difference > AGREE_SIGMAS * difference_sigma)
    return Comparison(
        weight=observed.weight * agrees,
        difference=with_value(F(0.0), ~agrees, observed.difference),
        sigma=observed.fusion_sigma,
        agrees=agrees,
        is_duplicate=agrees & is_preferred & (observed.sample_distance_px < SAME_POSITION_PX),
        is_conflict=is_farther & is_preferred,
    )
