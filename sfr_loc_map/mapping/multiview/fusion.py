"""One cloud from up to three stereo pairs.

Every point is reprojected into the disparity images of the other pairs. If both agree within their uncertainty, the
point moves along its own ray to the mean weighted by inverse variance, so that the points of all pairs are on one
surface. If another pair with the larger weight observes a farther surface at that pixel, the other pair sees through
the point, and the point is dropped. A nearer surface of the other pair only hides the point. A conflict with one pair
outweighs agreement with a third, because a missing point is preferred to a wrong one. Of two equal weights that of the
earlier pair counts as the larger one. A weight is `1 / sigma^2`, reduced near the border.

The remaining points are samples of the ground and are kept, each on the ray of its own pixel. Where the ground is seen
at a grazing angle, the rows of one image are centimetres apart, and those of another pair are between them. Of two
points that sample the same spot, the one with the larger weight is kept.

Two ranges are compared along the ray of the camera that observes the surface, and their mean is applied along the
point's own ray. This is an approximation for cameras at one place, as those of a panorama. On a plane with the normal
n a difference d along the unit ray e' of the other camera is `d (e' . n) / (e . n)` along the point's own ray e, and
its standard deviation changes by the same factor. Within the panoramas of the development data and of the sample the
factor is 0.95 to 1.05, and the conversion changes the mean error of the fused points by less than 0.01 mm. If the
cameras are 4 m apart along the line of sight, the factor is 0.4 to 1.8, and the error of the fused points is 14 %
larger for the farther camera and 2 % larger for the nearer one than with the conversion. Of rendered pairs
that are metres apart, the near points became worse by the fusion, with and without the conversion
(measurements/mapper_trials.md).
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

AGREE_SIGMAS = 3.0  #: Differences up to this many standard deviations are consistent: 0.3 % exceed it by chance.
COMMON_VARIANCE = 0.5
"""Fraction of a point's variance that all pairs have in common (smoothing of the same shape), which averaging does not
reduce. The errors of two rendered pairs at points on which they agree have a correlation of 0.49 to 0.59
(measurements/mapper_trials.md)."""
SAME_SAMPLE_PX = F(0.02)
"""Points closer than this in an image sample the same spot, pixels: the images have the same pose, and rounding moves
points by less."""
AGREEMENT_STRIDE = 4  #: The agreement of poses is measured by every fourth point: medians need fewer samples.
MAX_RANGE_RATIO = 1.8
"""Measured over expected range differences above which poses disagree: nearly twice that of correct poses, which have 1
or less (docs/mapping.md)."""
MAX_GREY_RATIO = 0.45
"""Grey level differences over those at `SHIFT_PX` above which poses disagree; correct poses have 0.1 to 0.3. Poses
that are wrong by 0.3 deg have 0.45, so that errors are detected from about 0.3 deg on (docs/mapping.md)."""


class FusedViews(NamedTuple):
    """Result of the fusion."""

    points: ViewPoints  #: N points of all views.
    pair: NDArray[np.uint8]  #: `(N,)`, index of the view of each point.
    findings: Findings


class Comparison(NamedTuple):
    """How the other views observe the N points of a view."""

    total_weight: FloatArray32  #: `(N,)`, weight of the point and of the views that agree, 1 / m^2.
    weighted_difference: FloatArray32  #: `(N,)`, sum of weight times range difference of the views that agree, 1 / m.
    #: `(N,)`, variance of the weighted sum of these ranges, the sum of weight^2 sigma^2, 1 / m^2.
    weighted_variance: FloatArray32
    agrees: Mask  #: `(N,)`, another view agrees.
    is_duplicate: Mask  #: `(N,)`, a preferred view has the same sample.
    is_conflict: Mask  #: `(N,)`, a preferred view sees through the point: it observes a farther surface.
    findings: Findings  #: Agreement of the poses.


class PoseAgreement(NamedTuple):
    """How well two views agree where they overlap."""

    difference_median_m: float  #: Median of the range differences.
    difference_spread_m: float  #: Robust standard deviation of the range differences.
    range_ratio: float  #: Range differences over those expected of correct sigmas and poses, robust.
    #: Grey level differences over those at `SHIFT_PX`, robust; NaN if there is too little texture.
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
    """Return how the other views observe the points of the view of an index.

    At each point the preferred one of two views is that with the larger weight, or the first one if both are equal. A
    point is dropped only if the other view is preferred and sees through it.
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
    """Return the points of a view that are kept, moved along their rays to the weighted mean with the other views.

    With the ranges r_i, their standard deviations s_i and the weights w_i of the point and of the views that agree, the
    new range is `sum w_i r_i / sum w_i`. Its variance is `c sigma^2 + (1 - c) sum w_i^2 s_i^2 / (sum w_i)^2`, with
    sigma that of the point and c the fraction of the variance that all pairs have in common. Away from the border of
    the images the weights are `1 / s_i^2`, and the last term is `(1 - c) / sum w_i`.
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
    """Return how well the points of one view agree with another view; at least one point is seen by both.

    Range differences are compared with those expected of correct sigmas and poses, grey level differences with those at
    `SHIFT_PX`: a wrong yaw shows there on any texture.
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

    Of two views each is compared with the other; the comparison from the one of the lower index gives the warning.
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
    if i > j or common <= MIN_OVERLAP or not disagree:
        return Findings(statistics)
    warning = (
        f"pairs {i} and {j} disagree where they overlap: range differences are {agreement.range_ratio:.1f} times the "
        f"expected ones, grey level differences {agreement.grey_ratio:.2f} times those {SHIFT_PX} pixels away; check "
        "the baseline and their poses, or register the poses (refine_poses)"
    )
    return Findings(statistics, (warning,))


def _spread_of_finite(values: FloatArray32) -> float:
    """Return the robust standard deviation of the finite values; NaN without any."""
    return spread(values[np.isfinite(values)])
