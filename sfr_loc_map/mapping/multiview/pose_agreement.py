"""The agreement of the poses of two views where they overlap, from range differences and grey level differences."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray32, median
from sfr_loc_map.geometry.robust_statistics import mad_sigma, spread
from sfr_loc_map.mapping.disparity.match_check import TEXTURE_SIGMAS
from sfr_loc_map.mapping.findings import Findings
from sfr_loc_map.mapping.multiview.projection import MIN_OVERLAP, SHIFT_PX, Observations
from sfr_loc_map.mapping.pair_view import PairView

OVERLAP_STRIDE = 4  #: Poses are compared at every fourth common point.
MAX_RANGE_RATIO = 1.8
"""Poses disagree if the ratio of measured to expected range differences exceeds this (docs/mapping.md)."""
MAX_GREY_RATIO = 0.45
"""Poses disagree if the ratio of grey level differences to grey level differences at an offset of `SHIFT_PX` exceeds
this (docs/mapping.md)."""


def pose_disagreement(range_ratio: float, grey_ratio: float) -> str:
    """Return a clause for each ratio that exceeds its limit (`agreement_of_poses`); empty if the poses agree.

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


def agreement_of_poses(views: Sequence[PairView], index: int, observer: int, observed: Observations) -> Findings:
    """Return the agreement of the poses of a view and an observing view, and a warning if the poses disagree.

    `observed` contains what the view `observer` observes at the points of the view `index`. Two views are compared
    twice, once with the points of each view. The warning follows from the points of the earlier view. The statistics
    except for the overlap are computed at every fourth observed point. Their names end with the indices of both views:

    - `overlap`: fraction of the points that are observed.
    - `difference_median_m`: median of the range differences.
    - `difference_spread_m`: robust standard deviation of the range differences.
    - `difference_over_sigma`: robust ratio of the range differences to those expected for correct sigmas and poses.
    - `grey_difference_over_beside`: robust ratio of grey level differences to those at an offset of `SHIFT_PX`, which
      reveals a wrong yaw on any texture. NaN if there is too little texture, given the larger noise of both views.
    """
    points = views[index].points
    indices = observed.indices
    statistics = {f"overlap_{index}_{observer}": len(indices) / max(points.size, 1)}
    if not len(indices):
        return Findings(statistics)

    sampled = indices[::OVERLAP_STRIDE]
    samples = observed.select(sampled)
    difference = samples.difference
    range_ratio = mad_sigma(difference / samples.difference_sigma(points.fusion_sigma[sampled]))

    own_grey = points.intensity[sampled]
    grey_spread = _spread_of_finite(samples.grey - own_grey)
    shifted_spread = _spread_of_finite(samples.grey_shifted - own_grey)
    noise_grey = max(views[index].noise_grey, views[observer].noise_grey)
    is_textured = shifted_spread > TEXTURE_SIGMAS * noise_grey
    grey_ratio = grey_spread / shifted_spread if is_textured else math.nan

    statistics |= {
        f"difference_median_m_{index}_{observer}": median(difference),
        f"difference_spread_m_{index}_{observer}": spread(difference),
        f"difference_over_sigma_{index}_{observer}": range_ratio,
        f"grey_difference_over_beside_{index}_{observer}": grey_ratio,
    }
    disagreement = pose_disagreement(range_ratio, grey_ratio)
    if index > observer or len(indices) < MIN_OVERLAP or not disagreement:
        return Findings(statistics)
    warning = (
        f"pairs {index} and {observer} disagree where they overlap: {disagreement}; check the baseline, their poses "
        "and whether their exposures are equal, or register them (refine_poses)"
    )
    return Findings(statistics, (warning,))


def _spread_of_finite(values: FloatArray32) -> float:
    """Return the robust standard deviation of the finite values; NaN if there are none."""
    return spread(values[np.isfinite(values)])
