"""The agreement of the poses of two views where they overlap, from range differences and grey level differences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray32, median
from sfr_loc_map.geometry.robust_statistics import mad_sigma, spread
from sfr_loc_map.mapping.disparity.match_check import TEXTURE_SIGMAS
from sfr_loc_map.mapping.findings import Findings
from sfr_loc_map.mapping.multiview.projection import MIN_OVERLAP, SHIFT_PX, Observations
from sfr_loc_map.mapping.pair_view import PairView, ViewPoints

OVERLAP_STRIDE = 4  #: Poses are compared at every fourth common point.
MAX_RANGE_RATIO = 1.8
"""Poses disagree if the ratio of measured to expected range differences exceeds this (docs/mapping.md)."""
MAX_GREY_RATIO = 0.45
"""Poses disagree if the ratio of grey level differences to grey level differences at an offset of `SHIFT_PX` exceeds
this (docs/mapping.md)."""


class Overlap(NamedTuple):
    """Points of a view that another view observes, and the differences at n samples of these points, `(n,)` each."""

    common: int  #: Number of points that the other view observes.
    difference: FloatArray32  #: Range differences (`Observations.difference`), metres.
    difference_sigma: FloatArray32  #: Standard deviations of the range differences, metres.
    grey_difference: FloatArray32  #: Grey level of the other view minus the grey level of the point.
    shifted_difference: FloatArray32  #: The same difference with the other view at the offset of `SHIFT_PX`.


def overlap_of(points: ViewPoints, observed: Observations) -> Overlap:
    """Return the overlap of a view, given its points, with the view that has observed these points."""
    indices = observed.indices
    sampled = indices[::OVERLAP_STRIDE]
    samples = observed.select(sampled)
    own_grey = points.intensity[sampled]
    return Overlap(
        common=len(indices),
        difference=samples.difference,
        difference_sigma=samples.difference_sigma(points.fusion_sigma[sampled]),
        grey_difference=samples.grey - own_grey,
        shifted_difference=samples.grey_shifted - own_grey,
    )


def pose_disagreement(range_ratio: float, grey_ratio: float) -> str:
    """Return a clause for each ratio that exceeds its limit (`_agreement`); empty if the poses agree.

    A ratio that was not measured is NaN and does not count as a disagreement.
    """
    clauses = []
    if range_ratio > MAX_RANGE_RATIO:
        clauses.append(f"range differences are {range_ratio:.1f} times the expected differences")
    if grey_ratio > MAX_GREY_RATIO:
        clauses.append(
            f"grey level differences are {grey_ratio:.2f} times the differences at an offset of {SHIFT_PX} pixels"
        )
    return ", and ".join(clauses)


def agreement_of_poses(views: Sequence[PairView], overlaps: Mapping[tuple[int, int], Overlap]) -> Findings:
    """Return the agreement of the poses of each two views, and a warning for each two views that disagree.

    `overlaps[i, j]` is the overlap of view i with view j, which observes points of view i. Two views are compared
    twice, once with the points of each view. The warning follows from the points of the earlier view.
    """
    statistics = {}
    warnings = []
    for (i, j), overlap in overlaps.items():
        statistics[f"overlap_{i}_{j}"] = overlap.common / max(views[i].points.size, 1)
        if overlap.common == 0:
            continue
        agreement = _agreement(overlap, max(views[i].noise_grey, views[j].noise_grey))
        statistics |= {f"{name}_{i}_{j}": value for name, value in agreement.items()}
        disagreement = pose_disagreement(agreement["difference_over_sigma"], agreement["grey_difference_over_beside"])
        if i < j and overlap.common >= MIN_OVERLAP and disagreement:
            warnings.append(
                f"pairs {i} and {j} disagree where they overlap: {disagreement}; check the baseline, their poses and "
                "whether their exposures are equal, or register them (refine_poses)"
            )
    return Findings(statistics, tuple(warnings))


def _agreement(overlap: Overlap, noise_grey: float) -> dict[str, float]:
    """Return the agreement of two views at the sampled points of their overlap, by the names of the statistics.

    - `difference_median_m`: median of the range differences.
    - `difference_spread_m`: robust standard deviation of the range differences.
    - `difference_over_sigma`: robust ratio of the range differences to those expected for correct sigmas and poses.
    - `grey_difference_over_beside`: robust ratio of grey level differences to those at an offset of `SHIFT_PX`, which
      reveals a wrong yaw on any texture. NaN if there is too little texture, given the larger noise of both views.
    """
    grey = _spread_of_finite(overlap.grey_difference)
    grey_shifted = _spread_of_finite(overlap.shifted_difference)
    is_textured = grey_shifted > TEXTURE_SIGMAS * noise_grey
    return {
        "difference_median_m": median(overlap.difference),
        "difference_spread_m": spread(overlap.difference),
        "difference_over_sigma": mad_sigma(overlap.difference / overlap.difference_sigma),
        "grey_difference_over_beside": grey / grey_shifted if is_textured else math.nan,
    }


def _spread_of_finite(values: FloatArray32) -> float:
    """Return the robust standard deviation of the finite values; NaN if there are none."""
    return spread(values[np.isfinite(values)])
