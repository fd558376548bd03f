"""How well two views agree where they overlap, and what that says of their poses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.median import median
from sfr_loc_map.mapping.multiview.view import View
from sfr_loc_map.mapping.multiview.view_reprojection import SHIFT_PX, ReprojectedPoints
from sfr_loc_map.mapping.robust import mad_sigma

SAMPLE = 4
"""Figures are taken from every fourth point."""
MIN_OVERLAP = 1000
"""Fewer points in common say nothing of poses."""
MEDIAN_ABSOLUTE = 0.6745
"""Median of the absolute value of a standard normal variable."""
RANGE_WARNING = 1.8
"""Ratio of measured to expected differences in range beyond which two poses are doubted."""
GREY_WARNING = 0.45
"""Ratio of grey level differences to those `SHIFT_PX` away beyond which poses are doubted; 0.1-0.3 for right poses."""
MIN_TEXTURE = 2.0
"""Spread of grey level differences `SHIFT_PX` away over that of noise below which grey levels say nothing of poses."""


@dataclass(frozen=True, slots=True)
class PoseAgreement:
    """Agreement of the points of one view with another view.

    Attributes:
        pairs: Numbers of the view whose points are compared and of the other.
        common: Number of points that both see.
        overlap: Share of the view's points that the other sees.
        median_m: Median difference of range, metres.
        spread_m: Robust standard deviation of the difference of range, metres.
        range_ratio: Measured over expected difference of range, 1 for correct sigmas and poses.
        grey_ratio: Spread of grey level differences over that at `SHIFT_PX` away: a wrong yaw shows here on any
            texture. NaN where there is too little texture or overlap.
    """

    pairs: tuple[int, int]
    common: int
    overlap: float
    median_m: float
    spread_m: float
    range_ratio: float
    grey_ratio: float

    @classmethod
    def measure(cls, pairs: tuple[int, int], views: tuple[View, View], points: ReprojectedPoints) -> PoseAgreement:
        """Return the agreement of a view's points with another view.

        Args:
            pairs: Numbers of the two.
            views: The two, in the same order.
            points: Points of the first as reprojected into the second.
        """
        view, other = views
        common = len(points.index)
        overlap = common / max(len(view.cloud), 1)
        if common == 0:
            return cls(pairs, 0, overlap, math.nan, math.nan, math.nan, math.nan)
        difference = points.difference[::SAMPLE]
        own = view.cloud.sigma[points.index[::SAMPLE]]
        normalised = np.abs(difference) / np.sqrt(np.square(own) + np.square(points.deviation[::SAMPLE]))
        middle = median(difference)
        grey, shifted = (_spread(item[::SAMPLE]) for item in (points.grey_difference, points.grey_difference_shifted))
        noise = max(view.noise_grey, other.noise_grey)
        return cls(
            pairs,
            common,
            overlap,
            middle,
            mad_sigma(difference - np.float32(middle)),
            float(np.float32(median(normalised)) / MEDIAN_ABSOLUTE),
            grey / shifted if shifted > MIN_TEXTURE * noise else math.nan,
        )

    def statistics(self) -> dict[str, float]:
        """Return the figures by name."""
        i, j = self.pairs
        overlap = {f"overlap_{i}_{j}": self.overlap}
        if self.common == 0:
            return overlap
        return overlap | {
            f"difference_median_m_{i}_{j}": self.median_m,
            f"difference_spread_m_{i}_{j}": self.spread_m,
            f"difference_over_sigma_{i}_{j}": self.range_ratio,
            f"grey_difference_over_beside_{i}_{j}": self.grey_ratio,
        }

    def warnings(self) -> tuple[str, ...]:
        """Return a line if the poses are in doubt, once for two views."""
        i, j = self.pairs
        wrong = self.range_ratio > RANGE_WARNING or self.grey_ratio > GREY_WARNING
        if not (i < j and wrong and self.common > MIN_OVERLAP):
            return ()
        return (
            f"pairs {i} and {j} disagree where they overlap: ranges differ by {self.range_ratio:.1f} times what is "
            f"expected, grey levels by {self.grey_ratio:.2f} of what they differ {SHIFT_PX} pixels away: check the "
            "baseline and their poses, or have the poses fitted (refine_poses)",
        )


def _spread(values: FloatImage) -> float:
    known = values[np.isfinite(values)]
    return mad_sigma(known - median(known)) if len(known) else math.nan
