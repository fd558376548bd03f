"""One cloud from up to three stereo pairs.

Every point is projected into the disparity images of the other pairs. If both ranges agree within their uncertainty,
the point moves along its own ray to the inverse-variance weighted mean, so that the points of all pairs are on one
surface. If another pair with a larger weight observes a farther surface at that pixel, both pairs are in conflict, and
the point is dropped. A nearer surface of the other pair only hides the point. A conflict with one pair outweighs
agreement with a third pair, because a missing point is preferred to a wrong point. The weight of a point is
`1 / sigma^2`, reduced near the image border. If both weights are equal, the earlier pair is preferred.

The remaining points are kept, each on the ray of its own pixel. At grazing angles, the rows of one image are
centimetres apart on the ground, and the rows of another pair are between them, so keeping all points increases
the density there. If two points sample the same spot, the point with the larger weight is kept.

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
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatArray32, Mask
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.findings import Findings
from sfr_loc_map.mapping.multiview.pose_agreement import agreement_findings
from sfr_loc_map.mapping.multiview.projection import Observations, point_weights, project_into_view
from sfr_loc_map.mapping.pair_view import PairView, ViewPoints

AGREE_SIGMAS = 3.0
"""Ranges that differ by up to this many standard deviations agree. Independent errors exceed the limit in 0.3 % of the
points by chance. Because a part of the errors is common (`COMMON_VARIANCE`), the differences are smaller, and the limit
corresponds to 4.2 standard deviations if both sigmas are equal."""
COMMON_VARIANCE = 0.5
"""Fraction of a point's variance that is common to all pairs, because all pairs are smoothed in the same way. Averaging
does not reduce this fraction. Where two rendered pairs agree, their errors have a correlation of 0.49 to 0.59
(measurements/mapper_trials.md)."""
MAX_RANGE_FACTOR = F(1.25)
"""A view is ignored at a point if the range from the camera of the view exceeds this multiple of the range from the
point's own camera. In a panorama, no view is ignored. With this limit, the fusion of pairs that are 1.5 to 4 m apart
does not increase the error of near points (measurements/mapper_trials.md)."""
SAME_SAMPLE_PX = F(0.02)
"""Points closer than this in an image sample the same spot, pixels. This occurs if images have the same pose; rounding
moves points by less."""


class FusedViews(NamedTuple):
    """Result of the fusion."""

    points: ViewPoints  #: N points of all views.
    pair_index: NDArray[np.uint8]  #: `(N,)`, index of the pair of each point.
    findings: Findings


class Judgement(NamedTuple):
    """Judgement of the N points of a view by another view, `(N,)` each.

    At points that the other view does not observe, no flag is set, and weight and difference are 0.
    """

    weight: FloatArray32  #: Weight of the observed range, 1 / m^2; 0 if the ranges do not agree.
    difference: FloatArray32  #: Observed range minus the range of the point, metres; 0 if the ranges do not agree.
    agrees: Mask  #: Whether the ranges agree.
    is_duplicate: Mask  #: Whether the other view is preferred and samples the same spot.
    is_conflict: Mask  #: Whether the other view is preferred and observes a farther surface.


class Comparison(NamedTuple):
    """The N points of a view, compared with all other views."""

    rays: FloatArray32  #: `(N, 3)`, vector from the point's own camera to the point, metres, LM.
    own_range: FloatArray32  #: `(N,)`, range of the point from its own camera, metres.
    total_weight: FloatArray32  #: `(N,)`, sum of the weights of the point and of the agreeing views, 1 / m^2.
    weighted_difference: FloatArray32  #: `(N,)`, sum of weight times range difference of the agreeing views, 1 / m.
    #: `(N,)`, sum of weight^2 sigma^2 of the point and of the agreeing views, 1 / m^2: the variance of their weighted
    #: sum.
    weighted_variance: FloatArray32
    agrees: Mask  #: `(N,)`, whether another view agrees.
    is_duplicate: Mask  #: `(N,)`, whether a preferred view samples the same spot.
    is_conflict: Mask  #: `(N,)`, whether a preferred view observes a farther surface.
    agreement: Findings  #: Agreement of the poses: statistics and warnings only.


def fuse_views(views: Sequence[PairView], rig: StereoRig) -> FusedViews:
    """Return the points of all views on one surface, in LM."""
    parts = []
    agreeing_count = 0
    conflict_count = 0
    agreement = Findings()
    for index, view in enumerate(views):
        comparison = _compare_with_others(index, views, rig)
        parts.append(_fused_points(view, comparison))
        agreeing_count += int(np.count_nonzero(comparison.agrees))
        conflict_count += int(np.count_nonzero(comparison.is_conflict))
        agreement += comparison.agreement
    points = ViewPoints.concatenated(parts)
    pair_index = np.repeat(np.arange(len(views), dtype=np.uint8), [part.size for part in parts])
    statistics = {
        "points_in": float(sum(view.points.size for view in views)),
        "merged": float(agreeing_count),
        "dropped_conflict": float(conflict_count),
        "points": float(points.size),
        "pairs": float(len(views)),
        "fused": float(len(views) > 1),
    }
    warnings = () if points.size else ("the fused cloud has no points: the other warnings state the causes",)
    return FusedViews(points, pair_index, Findings(statistics, warnings) + agreement)


def _compare_with_others(index: int, views: Sequence[PairView], rig: StereoRig) -> Comparison:
    """Compare the points of a view with all other views."""
    view = views[index]
    own_sigma = view.points.fusion_sigma
    own_weight = point_weights(view)
    rays = view.points.xyz - view.T_lm_left.translation.astype(F)
    own_range = np.sqrt(np.einsum("ij,ij->i", rays, rays))
    total_weight = own_weight.copy()
    weighted_difference = np.zeros_like(own_weight)
    weighted_variance = np.square(own_weight * own_sigma)
    agrees = np.zeros(len(own_weight), np.bool_)
    is_duplicate = np.zeros(len(own_weight), np.bool_)
    is_conflict = np.zeros(len(own_weight), np.bool_)
    agreement = Findings()
    for other_index, other in enumerate(views):
        if other_index == index:
            continue
        observed = project_into_view(view.points.xyz, other.T_lm_left, other.images, rig)
        judgement = _judge(observed, own_weight, own_range, own_sigma, is_earlier=other_index < index)
        total_weight += judgement.weight
        weighted_difference += judgement.weight * judgement.difference
        weighted_variance += np.square(judgement.weight * observed.fusion_sigma)
        agrees |= judgement.agrees
        is_duplicate |= judgement.is_duplicate
        is_conflict |= judgement.is_conflict
        agreement += agreement_findings(index, other_index, views, observed)
    return Comparison(
        rays=rays,
        own_range=own_range,
        total_weight=total_weight,
        weighted_difference=weighted_difference,
        weighted_variance=weighted_variance,
        agrees=agrees,
        is_duplicate=is_duplicate,
        is_conflict=is_conflict,
        agreement=agreement,
    )


def _judge(
    observed: Observations,
    own_weight: FloatArray32,
    own_range: FloatArray32,
    own_sigma: FloatArray32,
    *,
    is_earlier: bool,
) -> Judgement:
    """Judge the points of a view, with weight, range and sigma `(N,)`, by the observations of another view.

    The other view is preferred at a point if its weight there is larger, or if both weights are equal and the other
    view is the earlier view. The other view is ignored at points that it observes from too far away
    (`MAX_RANGE_FACTOR`).

    To add a test of points across pairs, add a flag to `Judgement`, combine the flag over the other views in
    `_compare_with_others`, and apply the flag in `_fused_points`.
    """
    is_preferred = observed.weight >= own_weight if is_earlier else observed.weight > own_weight
    is_used = observed.point_range <= MAX_RANGE_FACTOR * own_range
    sigma = observed.difference_sigma(own_sigma)
    agrees = is_used & (np.abs(observed.difference) / sigma <= AGREE_SIGMAS)  # false if the difference is NaN
    is_farther = is_used & (observed.difference > AGREE_SIGMAS * sigma)
    return Judgement(
        weight=np.where(agrees, observed.weight, F(0.0)),
        difference=np.where(agrees, observed.difference, F(0.0)),
        agrees=agrees,
        is_duplicate=agrees & is_preferred & (observed.sample_distance_px < SAME_SAMPLE_PX),
        is_conflict=is_farther & is_preferred,
    )


def _fused_points(view: PairView, comparison: Comparison) -> ViewPoints:
    """Return the kept points of a view, moved along their rays to the weighted mean with the agreeing views.

    The point and the agreeing views have the ranges r_i, their standard deviations s_i and the weights w_i. The new
    range is `sum w_i r_i / sum w_i`. Its variance is `c sigma^2 + (1 - c) sum w_i^2 s_i^2 / (sum w_i)^2`, where sigma
    is the standard deviation of the point and c the fraction of the variance that is common to all pairs. Away from the
    image border the weights are `1 / s_i^2`, and the last term is `(1 - c) / sum w_i`.
    """
    points = view.points
    total_weight = comparison.total_weight
    relative_step = comparison.weighted_difference / total_weight / comparison.own_range
    variance_of_mean = comparison.weighted_variance / np.square(total_weight)  # if all errors were independent
    variance = COMMON_VARIANCE * np.square(points.fusion_sigma) + (1.0 - COMMON_VARIANCE) * variance_of_mean
    fused = points._replace(
        xyz=points.xyz + comparison.rays * relative_step[:, None],
        fusion_sigma=np.where(comparison.agrees, np.sqrt(variance), points.fusion_sigma),
    )
    return fused.select(~(comparison.is_duplicate | comparison.is_conflict))
