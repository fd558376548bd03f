"""The coverage of a map: which true points of each pair have a point of the cloud.

A pixel is covered by a point of the cloud at this pixel (`pixel_coverage`), or, for a fused cloud and for points
without pixels, by a point near its true point (`footprint_coverage`, `coverage_by_points`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.metrics.completeness.expected_items import share_of
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.map.pair_truth import PairTruth

FOOTPRINTS = 2.0
"""Distance, in pixel footprints Z / f, within which a point of a fused cloud covers a true point. The definition of the
coverage of a fused cloud (docs/metrics.md) has this number. Neighbouring points of one pair are one footprint apart."""
BATCH = 262144  #: Maximum number of true points in one search, which bounds the memory.


class PixelCounts(NamedTuple):
    """Numbers of pixels with a true point in a range."""

    true: int
    covered: int  #: Of these pixels, those that the cloud covers.

    @property
    def uncovered_share(self) -> float | None:
        """The fraction of the pixels that the cloud does not cover; None without a pixel."""
        return share_of(self.true - self.covered, self.true)


@dataclass(frozen=True, slots=True, eq=False)
class PairCoverage:
    """Which pixels of one pair are covered."""

    is_covered: Mask  #: `(H, W)`.
    range_m: FloatArray  #: `(H, W)`, distance of the true point from the left optical centre, NaN without a true point.

    def counts(self, low_m: float, high_m: float) -> PixelCounts:
        """Return the numbers of pixels whose true point is in a range [low, high)."""
        inside = (self.range_m >= low_m) & (self.range_m < high_m)
        return PixelCounts(int(np.count_nonzero(inside)), int(np.count_nonzero(self.is_covered[inside])))


def coverage_row(part: str | None, pairs: Sequence[PairCoverage], low_m: float, high_m: float) -> Figure:
    """Return the row of the fraction of true points in a range [low, high) that are covered."""
    counts = [pair.counts(low_m, high_m) for pair in pairs]
    total = sum(each.true for each in counts)
    return figure_row("coverage", part=part, n=total, value=share_of(sum(each.covered for each in counts), total))


def pixel_coverage(cloud: PointCloud, truths: Sequence[PairTruth]) -> list[PairCoverage]:
    """Return the coverage of each pair by the points at its pixels."""
    pairs = []
    for number, truth in enumerate(truths):
        is_covered = np.zeros(truth.points.shape[:2], np.bool_)
        mine = cloud.pair == number
        is_covered[cloud.v[mine], cloud.u[mine]] = True
        pairs.append(PairCoverage(is_covered, truth.ranges_m()))
    return pairs


def footprint_coverage(cloud: PointCloud, truths: Sequence[PairTruth], farthest_m: float) -> list[PairCoverage]:
    """Return the coverage of each pair by the points within `FOOTPRINTS` of its true points.

    True points beyond the range `farthest_m` are not searched.
    """
    # avoids most of the search, because most points are near the true point of their own pixel
    is_near_own = [near_own_point(cloud, truth, number) for number, truth in enumerate(truths)]
    return coverage_by_points(cloud.xyz, truths, farthest_m, is_near_own)


def near_own_point(cloud: PointCloud, truth: PairTruth, number: int) -> Mask:
    """Return the mask `(H, W)` of the true points that have the point of their own pixel within `FOOTPRINTS`."""
    is_near = np.zeros(truth.points.shape[:2], np.bool_)
    mine = np.flatnonzero(cloud.pair == number)
    v, u = cloud.v[mine], cloud.u[mine]
    distance = np.sqrt(np.square(cloud.xyz[mine].astype(np.float64) - truth.points[v, u]).sum(axis=1))
    is_own = distance < footprints_m(truth)[v, u]
    is_near[v[is_own], u[is_own]] = True
    return is_near


def coverage_by_points(
    xyz: NDArray[np.floating], truths: Sequence[PairTruth], farthest_m: float, is_known: Sequence[Mask] = ()
) -> list[PairCoverage]:
    """Return the coverage of each pair by the points `(P, 3)` within `FOOTPRINTS` of its true points.

    True points beyond the range `farthest_m` are not searched. `is_known` contains masks `(H, W)` of true points that
    are known to be covered, for each pair; empty if none are known.
    """
    from scipy.spatial import cKDTree  # slow to import, and nodes rarely need it

    points = np.asarray(xyz, np.float32).astype(np.float64)  # the precision of clouds
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False) if len(points) else None
    pairs = []
    for number, truth in enumerate(truths):
        range_m = truth.ranges_m()
        is_covered = is_known[number].copy() if is_known else np.zeros(range_m.shape, np.bool_)
        if tree is not None:
            is_searched = (range_m <= farthest_m) & ~is_covered
            is_covered[is_searched] = has_point_within(
                tree, truth.points[is_searched].astype(np.float64), footprints_m(truth)[is_searched]
            )
        pairs.append(PairCoverage(is_covered, range_m))
    return pairs


def footprints_m(truth: PairTruth) -> FloatArray:
    """Return `FOOTPRINTS` times the pixel footprint Z / f `(H, W)` at each true point, m."""
    return np.asarray(FOOTPRINTS * truth.depths_m(truth.points) / truth.rig.fx)


def has_point_within(tree: Any, points: FloatArray, radius_m: FloatArray) -> Mask:  # noqa: ANN401 - a cKDTree
    """Return whether a point of a tree is nearer to each of the points `(N, 3)` than its radius `(N,)`."""
    is_near = np.zeros(len(points), np.bool_)
    order = np.argsort(radius_m, kind="stable")  # a batch is searched within its largest radius
    for first in range(0, len(order), BATCH):
        batch = order[first : first + BATCH]
        distance, _ = tree.query(points[batch], distance_upper_bound=float(radius_m[batch[-1]]), workers=-1)
        is_near[batch] = distance < radius_m[batch]
    return is_near
