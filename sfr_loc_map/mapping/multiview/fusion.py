"""One cloud from up to three stereo pairs.

Every point is projected into the disparity images of the other pairs. If both ranges agree within their uncertainty,
the point moves along its own ray to the inverse-variance weighted mean, so that the points of all pairs are on one
surface. If another pair with a larger weight observes a farther surface at that pixel, both pairs are in conflict, and
the point is dropped. A nearer surface of the other pair only hides the point. A conflict with one pair outweighs
agreement with a third pair, because a missing point is preferred to a wrong point. The weight of a point is
`1 / sigma^2`, reduced near the image border. If both weights are equal, the earlier pair is preferred.

The remaining points are kept, each on the ray of its own pixel. At grazing angles, the rows of one image are
centimetres apart on the ground, and the rows of another pair are between them. If two points sample the same spot, the
point with the larger weight is kept.

Two ranges are compared along the ray of the other camera, and their difference is applied along the point's own ray.
This approximation assumes that the cameras are at nearly the same position, as in a panorama. Pairs that are metres
apart should not be fused, because fusion increases the error of their near points (measurements/mapper_trials.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatArray32, Mask, median
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.disparity.texture import TEXTURE_SIGMAS
from sfr_loc_map.mapping.findings import Findings
from sfr_loc_map.mapping.multiview.projection import (
    MIN_OVERLAP,
    SHIFT_PX,
    ObservedPoints,
    point_weights,
    project_into_view,
)
from sfr_loc_map.mapping.pair_view import PairView, ViewPoints
from sfr_loc_map.mapping.robust_statistics import mad_sigma, spread

AGREE_SIGMAS = 3.0  #: Ranges that differ by up to this many standard deviations agree; 0.3 % exceed it by chance.
COMMON_VARIANCE = 0.5
"""Fraction of a point's variance that is common to all pairs, because all are smoothed in the same way. Averaging does
not reduce this fraction. Where two rendered pairs agree, their errors have a correlation of 0.49 to 0.59
(measurements/mapper_trials.md)."""
SAME_SAMPLE_PX = F(0.02)
"""Points closer than this in an image sample the same spot, pixels. This occurs if images have the same pose; rounding
moves points by less."""
AGREEMENT_STRIDE = 4  #: The agreement of poses is measured on every fourth point, which is enough for medians.
MAX_RANGE_RATIO = 1.8
"""Poses disagree if the ratio of measured to expected range differences exceeds this. Correct poses have a ratio of 1
or less (docs/mapping.md)."""
MAX_GREY_RATIO = 0.45
"""Poses disagree if the ratio of grey level differences to those at an offset of `SHIFT_PX` exceeds this. Correct poses
have a ratio of 0.1 to 0.3, and poses with an error of 0.3 deg have 0.45 (docs/mapping.md)."""


class FusedViews(NamedTuple):
    """Result of the fusion."""

    points: ViewPoints  #: N points of all views.
    pair: NDArray[np.uint8]  #: `(N,)`, index of the view of each point.
    findings: Findings


class Comparison(NamedTuple):
    """How the other views observe the N points of a view."""

    total_weight: FloatArray32  #: `(N,)`, sum of the weights of the point and of the agreeing views, 1 / m^2.
    weighted_difference: FloatArray32  #: `(N,)`, sum of weight times range difference of the agreeing views, 1 / m.
    #: `(N,)`, sum of weight^2 sigma^2 of the point and of the agreeing views, 1 / m^2: the variance of their weighted
    #: sum.
    weighted_variance: FloatArray32
    agrees: Mask  #: `(N,)`, whether another view agrees.
    is_duplicate: Mask  #: `(N,)`, whether a preferred view samples the same spot.
    is_conflict: Mask  #: `(N,)`, whether a preferred view observes a farther surface.
    findings: Findings  #: Agreement of the poses.


class PoseAgreement(NamedTuple):
    """How well two views agree where they overlap."""

    difference_median_m: float  #: Median of the range differences.
    difference_spread_m: float  #: Robust standard deviation of the range differences.
    range_ratio: float  #: Robust ratio of range differences to those expected for correct sigmas and poses.
    #: Robust ratio of grey level differences to those at an offset of `SHIFT_PX`; NaN if there is too little texture.
    grey_ratio: float


def fuse_views(views: Sequence[PairView], rig: StereoRig) -> FusedViews:
    """Return the points of all views on one surface, in LM."""
    parts: list[ViewPoints] = []
    agreeing_count = 0
    conflict_count = 0
    agreement = Findings()
    for index, view in enumerate(views):
        comparison = _compare(index, views, rig)
        parts.append(_fused_points(view, comparison))
        agreeing_count += int(comparison.agrees.sum())
        conflict_count += int(comparison.is_conflict.sum())
        agreement += comparison.findings
    points = ViewPoints.concatenated(parts)
    statistics = {
        "points_in": float(sum(view.points.size for view in views)),
        "merged": float(agreeing_count),
        "dropped_conflict": float(conflict_count),
        "points": float(points.size),
        "pairs": float(len(views)),
        "fused": float(len(views) > 1),
    }
    pair = np.repeat(np.arange(len(views), dtype=np.uint8), [part.size for part in parts])
    return FusedViews(points, pair, Findings(statistics) + agreement)


def _compare(index: int, views: Sequence[PairView], rig: StereoRig) -> Comparison:
    """Return how the other views observe the points of view `index`.

    Of two views, the view with the larger weight at a point is preferred, or the earlier view if both weights are
    equal. A point is in conflict only if the other view is preferred and observes a farther surface.
    """
    view = views[index]
    own_sigma = view.points.fusion_sigma
    own_weight = point_weights(view)
    total_weight = own_weight.copy()
    weighted_difference = np.zeros_like(own_weight)
    weighted_variance = np.square(own_weight * own_sigma)
    agrees = np.zeros(view.points.size, np.bool_)
    is_duplicate = np.zeros_like(agrees)
    is_conflict = np.zeros_like(agrees)
    findings = Findings()
    for other_index, other in enumerate(views):
        if other_index == index:
            continue
        observed = project_into_view(view.points.xyz, other.T_lm_left, other.images, rig)
        indices, by_other = observed
        weight_of_points = own_weight[indices]
        is_other_preferred = by_other.weight > weight_of_points
        if other_index < index:
            is_other_preferred |= by_other.weight == weight_of_points
        sigma = observed.difference_sigma(own_sigma)
        is_agreeing = np.abs(by_other.difference) / sigma <= AGREE_SIGMAS
        weight = np.where(is_agreeing, by_other.weight, F(0.0))
        total_weight[indices] += weight
        weighted_difference[indices] += weight * by_other.difference
        weighted_variance[indices] += np.square(weight * by_other.sigma)
        agrees[indices] |= is_agreeing
        is_duplicate[indices] |= is_agreeing & is_other_preferred & (by_other.sample_distance_px < SAME_SAMPLE_PX)
        is_conflict[indices] |= is_other_preferred & (by_other.difference > AGREE_SIGMAS * sigma)
        findings += _agreement_findings(index, other_index, view, other, observed)
    return Comparison(total_weight, weighted_difference, weighted_variance, agrees, is_duplicate, is_conflict, findings)


def _fused_points(view: PairView, comparison: Comparison) -> ViewPoints:
    """Return the kept points of a view, moved along their rays to the weighted mean with the agreeing views.

    The point and the agreeing views have the ranges r_i, their standard deviations s_i and the weights w_i. The new
    range is `sum w_i r_i / sum w_i`. Its variance is `c sigma^2 + (1 - c) sum w_i^2 s_i^2 / (sum w_i)^2`, where sigma
    is the standard deviation of the point and c the fraction of the variance that is common to all pairs. Away from the
    image border the weights are `1 / s_i^2`, and the last term is `(1 - c) / sum w_i`.
    """
    kept = np.flatnonzero(~(comparison.is_duplicate | comparison.is_conflict))
    points = view.points.select(kept)
    moved = np.flatnonzero(comparison.agrees[kept])
    total_weight = comparison.total_weight[kept[moved]]
    positions = points.xyz.take(moved, axis=0)
    rays = positions - view.T_lm_left.translation.astype(F)
    ranges = np.sqrt(np.einsum("ij,ij->i", rays, rays))
    step = comparison.weighted_difference[kept[moved]] / total_weight / ranges
    independent = comparison.weighted_variance[kept[moved]] / np.square(total_weight)
    variance = COMMON_VARIANCE * np.square(points.fusion_sigma[moved]) + (1.0 - COMMON_VARIANCE) * independent
    xyz = points.xyz.copy()
    xyz[moved] = positions + rays * step[:, None]
    sigma = points.fusion_sigma.copy()
    sigma[moved] = np.sqrt(variance)
    return points._replace(xyz=xyz, fusion_sigma=sigma)


def _pose_agreement(view: PairView, other: PairView, observed: ObservedPoints) -> PoseAgreement:
    """Return how well the points of one view agree with another view, which observes at least one point.

    Range differences are compared with those expected for correct sigmas and poses. Grey level differences are compared
    with those at an offset of `SHIFT_PX`, because they reveal a wrong yaw on any texture.
    """
    thinned = observed.every(AGREEMENT_STRIDE)
    by_other = thinned.observations
    difference = by_other.difference
    sigma = thinned.difference_sigma(view.points.fusion_sigma)
    own_grey = view.points.intensity[thinned.indices]
    grey = _spread_of_finite(by_other.grey - own_grey)
    grey_shifted = _spread_of_finite(by_other.grey_shifted - own_grey)
    is_textured = grey_shifted > TEXTURE_SIGMAS * max(view.noise_grey, other.noise_grey)
    return PoseAgreement(
        difference_median_m=median(difference),
        difference_spread_m=spread(difference),
        range_ratio=mad_sigma(difference / sigma),
        grey_ratio=grey / grey_shifted if is_textured else math.nan,
    )


def _agreement_findings(i: int, j: int, view: PairView, other: PairView, observed: ObservedPoints) -> Findings:
    """Return the agreement of the points of view i with the other view j, and a warning if their poses disagree.

    Each of two views is compared with the other. Only the comparison of the view with the lower index issues the
    warning.
    """
    common = len(observed.indices)
    overlap = {f"overlap_{i}_{j}": common / max(view.points.size, 1)}
    if common == 0:
        return Findings(overlap)
    agreement = _pose_agreement(view, other, observed)
    statistics = overlap | {
        f"difference_median_m_{i}_{j}": agreement.difference_median_m,
        f"difference_spread_m_{i}_{j}": agreement.difference_spread_m,
        f"difference_over_sigma_{i}_{j}": agreement.range_ratio,
        f"grey_difference_over_beside_{i}_{j}": agreement.grey_ratio,
    }
    disagree = agreement.range_ratio > MAX_RANGE_RATIO or agreement.grey_ratio > MAX_GREY_RATIO
    if i > j or common < MIN_OVERLAP or not disagree:
        return Findings(statistics)
    warning = (
        f"pairs {i} and {j} disagree where they overlap: range differences are {agreement.range_ratio:.1f} times the "
        f"expected differences, and grey level differences are {agreement.grey_ratio:.2f} times the differences at an "
        f"offset of {SHIFT_PX} pixels; check the baseline and their poses, or register them (refine_poses)"
    )
    return Findings(statistics, (warning,))


def _spread_of_finite(values: FloatArray32) -> float:
    """Return the robust standard deviation of the finite values; NaN if there are none."""
    return spread(values[np.isfinite(values)])
