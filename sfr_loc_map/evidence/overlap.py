"""Agreement of the maps of several stereo pairs in their overlap.

Each point of a pair is reprojected into another pair. The difference between the range of the reprojected point and the
range measured by the other pair is compared with its standard deviation, which follows from the reported sigmas if the
poses are correct. Both maps share the errors of the calibration and, for pairs of one position, the errors of the
mast's mount. Shared errors cancel in the difference, so the difference is not a measure of accuracy.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, islice
from typing import NamedTuple

import numpy as np

from sfr_loc_map.evidence.check_result import MAPS, Check, CheckResult, combined, result_of_overlap
from sfr_loc_map.io.sequence import NavSequence
from sfr_loc_map.kernels import load_kernels
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.mapping.multiview.pose_agreement import pose_disagreement
from sfr_loc_map.mapping.multiview.projection import MIN_OVERLAP
from sfr_loc_map.metrics.figures.rows import Figure, figure_row

TOO_FEW = f"no two mapping pairs have {MIN_OVERLAP} points in common"  #: Why maps cannot be compared.


class Overlap(NamedTuple):
    """Region that two pairs observe."""

    first: int  #: Number of the pair, from 0.
    other: int
    fraction: float  #: Fraction of the points of the first pair that the other pair observes.
    points: int  #: Number of points that the other pair observes.
    difference_m: float  #: Robust root mean square of the range differences, from median and spread.
    ratio: float  #: Ratio of the range differences to those expected; about 1 if sigmas and poses are correct.
    grey_ratio: float  #: Ratio of the grey level differences to those `SHIFT_PX` away; NaN without texture.

    @property
    def name(self) -> str:
        """Name of the two pairs."""
        return f"pairs {self.first} and {self.other}"

    @property
    def disagreement(self) -> str:
        """Description of the disagreement; empty if the pairs agree."""
        if self.result is not CheckResult.INCONSISTENT:
            return ""
        return f"the maps of {self.name} disagree: {pose_disagreement(self.ratio, self.grey_ratio)}"

    @property
    def result(self) -> CheckResult:
        """Result for the two pairs."""
        return result_of_overlap(self.points, self.ratio, self.grey_ratio)


def check_maps(sequence: NavSequence, config: MappingConfig) -> Check:
    """Map the first `MAX_PAIRS` pairs of a source and compare every two maps that overlap."""
    overlaps = find_overlaps(sequence, config)
    has_enough_data = combined(overlap.result for overlap in overlaps) is not CheckResult.NOT_ENOUGH_DATA
    return Check(
        pairs={MAPS: min(len(sequence), MAX_PAIRS)},
        pairs_of_source={MAPS: len(sequence)},
        figures=tuple(row for overlap in overlaps for row in overlap_rows(overlap)),
        disagreements=tuple(overlap.disagreement for overlap in overlaps if overlap.disagreement),
        not_checked=() if has_enough_data else (TOO_FEW,),
    )


def find_overlaps(sequence: NavSequence, config: MappingConfig) -> list[Overlap]:
    """Map the first `MAX_PAIRS` pairs of a source and return the overlaps of two pairs each."""
    mapper = Mapper(sequence.rig, config)
    load_kernels("mapping")
    pairs = islice(sequence.pairs(), MAX_PAIRS)
    maps = [mapper.process(item.pair, item.T_lm_navsb, index) for index, item in enumerate(pairs)]
    found = mapper.fuse(maps).statistics
    overlaps = []
    for first, other in combinations(range(len(maps)), 2):
        fraction = found[f"overlap_{first}_{other}"]
        if fraction == 0.0:
            continue
        of_pairs = f"{first}_{other}"
        difference_m = np.hypot(found[f"difference_median_m_{of_pairs}"], found[f"difference_spread_m_{of_pairs}"])
        points = round(fraction * len(maps[first].cloud))
        ratios = found[f"difference_over_sigma_{of_pairs}"], found[f"grey_difference_over_beside_{of_pairs}"]
        overlaps.append(Overlap(first, other, fraction, points, float(difference_m), *ratios))
    return overlaps


def overlap_rows(overlap: Overlap) -> Iterator[Figure]:
    """Yield the rows of an overlap."""
    yield figure_row("overlap", part=overlap.name, n=overlap.points, value=overlap.fraction)
    yield figure_row("overlap_difference", part=overlap.name, n=overlap.points, value=overlap.difference_m)
    yield figure_row("overlap_ratio", part=overlap.name, n=overlap.points, value=overlap.ratio)
    grey_ratio = overlap.grey_ratio if np.isfinite(overlap.grey_ratio) else None
    yield figure_row("overlap_grey", part=overlap.name, n=overlap.points, value=grey_ratio)
