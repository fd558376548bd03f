"""The map score: error of every point against the surface that its pixel sees, with the coverage [4.3.4]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.config import CloudKind, MapScoreConfig
from sfr_loc_map.metrics.score import (
    DisparityStatistic,
    ErrorImage,
    MapCompleteness,
    MapDetails,
    MapScore,
    PairScore,
    PointErrorScore,
    PointRows,
    RangeScore,
    SigmaNees,
    Triangulation,
)
from sfr_loc_map.metrics.statistics import chi2_interval95, chi2_quantile, column, sample_statistic

FOOTPRINTS = 2.0  #: A true point is covered by a point of a fused cloud nearer than so many pixel footprints, Z / f.
BATCH = 262144
NEES_BLOCK_PX = 32
"""One point of each block of pixels counts for the consistency of sigma: neighbours' errors are not independent."""
IMAGE_WIDTH = 128
CLOUD_ROWS = 8000


@dataclass(frozen=True, slots=True, eq=False)
class PairTruth:
    """The truth of one pair: points `(H, W, 3)` float32, metres, LM, NaN where none; pose of the left optical frame."""

    points: NDArray[np.float32]
    T_lm_left: Transform
    rig: StereoRig

    def __post_init__(self) -> None:
        """Check the size; MetricsError if the truth is not of the rig's size."""
        if self.points.shape != (self.rig.height, self.rig.width, 3):
            needed = (self.rig.height, self.rig.width, 3)
            raise MetricsError(f"truth of a mapping pair is {self.points.shape}: {needed} is needed")

    @classmethod
    def of(cls, pair: PosedStereoPair, rig: StereoRig) -> PairTruth | None:
        """Return the truth of a pair, None if the source has none."""
        return None if pair.truth is None else cls(pair.truth, pair.T_lm_navsb @ rig.T_sb_left, rig)

    def ranges_m(self) -> FloatArray:
        """Return the distance `(H, W)` of each true point from the left optical centre; NaN where none."""
        offset = self.points - self.T_lm_left.translation
        return np.asarray(np.sqrt(np.einsum("ijk,ijk->ij", offset, offset)))

    def depths_m(self, points: NDArray[np.floating]) -> FloatArray:
        """Return the depth `(...)` along the left optical axis of points `(..., 3)` in LM."""
        return np.asarray((points - self.T_lm_left.translation) @ self.T_lm_left.rotation[:, 2])


def truths_of(pairs: Sequence[PosedStereoPair], rig: StereoRig) -> list[PairTruth]:
    """Return the truth of every pair of a set; MetricsError if a pair has none."""
    truths = [PairTruth.of(pair, rig) for pair in pairs]
    without = [str(pair.pair.stamp_ns) for pair, truth in zip(pairs, truths, strict=True) if truth is None]
    if without or not truths:
        none = ", ".join(without) or "any (no pair at all)"
        raise MetricsError(f"a map score needs the truth of every pair: none for {none}; give a source with truth")
    return [truth for truth in truths if truth is not None]


# ---- what is covered, and how far points are off


def pixel_coverage(cloud: PointCloud, truths: Sequence[PairTruth]) -> list[Mask]:
    """Return for each pair which pixels `(H, W)` have a point."""
    covered = [np.zeros(truth.points.shape[:2], np.bool_) for truth in truths]
    for number, image in enumerate(covered):
        mine = cloud.pair == number
        image[cloud.v[mine], cloud.u[mine]] = True
    return covered


def footprint_coverage(
    cloud: PointCloud, truths: Sequence[PairTruth], ranges: Sequence[FloatArray], farthest_m: float
) -> list[Mask]:
    """Return for each pair which true points `(H, W)` up to a range have a cloud point within two footprints."""
    from scipy.spatial import cKDTree  # slow to import, and a node seldom needs it

    tree = cKDTree(cloud.xyz.astype(np.float64), balanced_tree=False, compact_nodes=False) if len(cloud) else None
    covered = []
    for number, (truth, distance) in enumerate(zip(truths, ranges, strict=True)):
        image = np.zeros(distance.shape, np.bool_)
        radius = FOOTPRINTS * truth.depths_m(truth.points) / truth.rig.fx
        mine = np.flatnonzero(cloud.pair == number)
        v, u = cloud.v[mine], cloud.u[mine]
        own = np.sqrt(np.square(cloud.xyz[mine].astype(np.float64) - truth.points[v, u]).sum(axis=1))
        image[v[own < radius[v, u]], u[own < radius[v, u]]] = True  # spares most of the search
        covered.append(image)
        if tree is None:
            continue
        rows, columns = np.nonzero((distance <= farthest_m) & ~image)
        points, within = truth.points[rows, columns].astype(np.float64), radius[rows, columns]
        order = np.argsort(within, kind="stable")
        for first in range(0, len(order), BATCH):
            batch = order[first : first + BATCH]
            near, _ = tree.query(points[batch], distance_upper_bound=float(within[batch[-1]]), workers=-1)
            image[rows[batch], columns[batch]] = near < within[batch]
    return covered


@dataclass(frozen=True, slots=True, eq=False)
class PointErrors:
    """The errors `(N,)` of points that have a truth, in the order of the cloud."""

    index: NDArray[np.intp]  #: Which points of the cloud.
    error_m: FloatArray  #: Distance from the truth [4.3.4].
    range_m: FloatArray  #: Distance of the truth from the left optical centre.
    along_m: FloatArray  #: Part of the error along the ray, positive if too far.
    disparity_px: FloatArray  #: `f b / Z - f b / Z_true`, Z the depth along the left optical axis.


def point_errors(cloud: PointCloud, truths: Sequence[PairTruth]) -> PointErrors:
    """Return the errors of all points whose pixel has a truth; MetricsError if a point is none of this source."""
    if not np.isfinite(cloud.xyz).all():
        raise MetricsError("the cloud has points that are not finite: leave them out")
    if len(cloud) and int(last := cloud.pair.max()) >= len(truths):
        problem = f"the cloud has points of pair {last} but the truth has {len(truths)} pairs"
        raise MetricsError(f"{problem}: give the source that the cloud was made from")
    parts = []
    for number, truth in enumerate(truths):
        index = np.flatnonzero(cloud.pair == number)
        if (cloud.u[index] >= truth.rig.width).any() or (cloud.v[index] >= truth.rig.height).any():
            problem = f"the cloud has pixels outside the {truth.rig.width} x {truth.rig.height} of pair {number}"
            raise MetricsError(f"{problem}: give the source that the cloud was made from")
        true = truth.points[cloud.v[index], cloud.u[index]].astype(np.float64)
        known = np.isfinite(true).all(axis=1)
        index, true = index[known], true[known]
        estimated = cloud.xyz[index].astype(np.float64)
        difference, ray = estimated - true, true - truth.T_lm_left.translation
        distance = np.sqrt(np.einsum("ij,ij->i", ray, ray))
        scale = truth.rig.fx * truth.rig.baseline_m
        disparity = scale / truth.depths_m(estimated) - scale / truth.depths_m(true)
        error = np.sqrt(np.einsum("ij,ij->i", difference, difference))
        along = np.einsum("ij,ij->i", difference, ray) / distance
        parts.append((index, error, distance, along, disparity))
    index, *rest = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(index, kind="stable")
    return PointErrors(index[order], *(column[order] for column in rest))


# ---- the score


class ScoredMap(NamedTuple):
    """What a cloud adds to the score: its part, and what figures are drawn from if the points' pixels are known."""

    score: MapScore
    details: MapDetails | None


def score_map(cloud: PointCloud, truths: Sequence[PairTruth], config: MapScoreConfig) -> ScoredMap:
    """Return the score of a cloud in LM whose points' pixels are known; MetricsError if it is not of this source."""
    if cloud.fused is None:
        raise MetricsError("the cloud does not say whether it is fused: set `fused`, coverage depends on it")
    errors = point_errors(cloud, truths)
    ranges = [truth.ranges_m() for truth in truths]
    if cloud.fused:
        covered = footprint_coverage(cloud, truths, ranges, max(config.scored_to_m, *config.range_edges_m))
    else:
        covered = pixel_coverage(cloud, truths)
    bins, by_pair = [], []
    for low, high in zip(config.range_edges_m, config.range_edges_m[1:], strict=False):
        which = (errors.range_m >= low) & (errors.range_m < high)
        statistic, disparity = sample_statistic(errors.error_m[which]), _disparity(errors.disparity_px[which])
        share = _coverage(covered, ranges, low, high)
        made = RangeScore(from_m=low, to_m=high, coverage=share, point_error_m=statistic, disparity_error_px=disparity)
        bins.append(made)
    numbers, scored = cloud.pair[errors.index], (config.scored_from_m, config.scored_to_m)
    for number, (image, distance) in enumerate(zip(covered, ranges, strict=True)):
        statistic = sample_statistic(errors.error_m[numbers == number])
        share = _coverage([image], [distance], *scored)
        by_pair.append(PairScore(pair=number, coverage=share, point_error_m=statistic))
    sky, empty = len(cloud) - len(errors.index), len(set(range(len(truths))) - set(cloud.pair.tolist()))
    whole = MapCompleteness(
        pairs=len(truths),
        pairs_without_cloud=empty,
        pairs_without_cloud_share=empty / len(truths) if truths else None,
        points_without_truth=sky,
        points_without_truth_share=sky / len(cloud) if len(cloud) else None,
    )
    by_pixels = PointErrorScore(
        points_without_truth=sky,
        point_error_m=sample_statistic(errors.error_m),
        disparity_error_px=_disparity(errors.disparity_px),
        sigma_nees=_consistency(cloud, errors),
        by_range=tuple(bins),
        by_pair=tuple(by_pair),
    )
    score = MapScore(
        pairs=len(truths),
        points=len(cloud),
        completeness=whole,
        cloud=CloudKind.FUSED if cloud.fused else CloudKind.SINGLE_PAIRS,
        coverage=_coverage(covered, ranges, *scored),
        coverage_range_m=scored,
        nearest_only=False,
        errors=by_pixels,
    )
    return ScoredMap(score, _details(cloud, errors, truths))


def score_nearest(xyz: NDArray[np.floating], truths: Sequence[PairTruth], config: MapScoreConfig) -> ScoredMap:
    """Return the score of points whose pixels are not known: by the nearest true point, seldom the one seen."""
    from scipy.spatial import cKDTree  # slow to import, and seldom needed by a node

    true = [truth.points[np.isfinite(truth.points).all(axis=2)] for truth in truths]
    tree = cKDTree(np.concatenate(true).astype(np.float64), balanced_tree=False, compact_nodes=False)
    distance = np.asarray(tree.query(np.asarray(xyz, np.float64), workers=-1)[0])
    records = np.zeros(len(xyz), PointCloud.dtype())
    records["x"], records["y"], records["z"], records["pair"] = (*np.asarray(xyz).T, 255)  # of no pair
    ranges, scored = [truth.ranges_m() for truth in truths], (config.scored_from_m, config.scored_to_m)
    covered = footprint_coverage(PointCloud.from_structured(records), truths, ranges, config.scored_to_m)
    score = MapScore(
        pairs=len(truths),
        points=len(xyz),
        completeness=MapCompleteness(pairs=len(truths)),
        coverage=_coverage(covered, ranges, *scored),
        coverage_range_m=scored,
        nearest_only=True,
        nearest_distance_m=sample_statistic(distance),
    )
    return ScoredMap(score, None)


def _coverage(covered: Sequence[Mask], ranges: Sequence[FloatArray], low: float, high: float) -> float | None:
    inside = [(distance >= low) & (distance < high) for distance in ranges]
    total = sum(int(np.count_nonzero(which)) for which in inside)
    have = sum(int(np.count_nonzero(image[which])) for image, which in zip(covered, inside, strict=True))
    return have / total if total else None


def _disparity(error_px: FloatArray) -> DisparityStatistic:
    known = error_px[np.isfinite(error_px)]
    signed, size = sample_statistic(known), sample_statistic(np.abs(known))
    return DisparityStatistic(mean=signed.mean, sigma=signed.sigma, p50_abs=size.p50, p95_abs=size.p95)


def _consistency(cloud: PointCloud, errors: PointErrors) -> SigmaNees | None:
    """Return the mean of (error along the ray / sigma)^2 over one point of each block, and where it should lie.

    If sigma is right the sum over n independent points is chi-square distributed with n degrees of freedom
    (Bar-Shalom, Li, Kirubarajan 2001, section 5.4), so the mean lies in the interval in 95 % of all cases.
    """
    sigma = cloud.sigma[errors.index].astype(np.float64)
    usable = np.flatnonzero(np.isfinite(sigma) & (sigma > 0))
    points = errors.index[usable]
    u, v = (pixels[points].astype(np.int64) // NEES_BLOCK_PX for pixels in (cloud.u, cloud.v))
    block = (cloud.pair[points].astype(np.int64) << 32) + (v << 16) + u
    chosen = usable[np.unique(block, return_index=True)[1]]
    count = len(chosen)
    if count < 2:
        return None
    squares = np.square(errors.along_m[chosen] / sigma[chosen])
    return SigmaNees(
        count=count,
        mean=float(np.mean(squares)),
        median=float(np.median(squares)),
        expected=1.0,
        expected_median=chi2_quantile(0.5, 1),
        interval95=chi2_interval95(count, count),
    )


def _details(cloud: PointCloud, errors: PointErrors, truths: Sequence[PairTruth]) -> MapDetails:
    step = max(1, -(-len(errors.index) // CLOUD_ROWS))
    some = errors.index[::step]
    x, y, z = (column(np.round(values.astype(float), 3), None) for values in cloud.xyz[some].T)
    error_m = column(np.round(errors.error_m[::step], 4), None)
    sample = PointRows(x_m=x, y_m=y, z_m=z, error_m=error_m, range_m=column(np.round(errors.range_m[::step], 3), None))
    images = []
    for number, truth in enumerate(truths):  # the mean error of blocks of pixels
        block = max(1, -(-truth.rig.width // IMAGE_WIDTH))
        shape = -(-truth.rig.height // block), -(-truth.rig.width // block)
        mine = cloud.pair[errors.index] == number
        points = errors.index[mine]
        index = (cloud.v[points].astype(np.int64) // block) * shape[1] + cloud.u[points].astype(np.int64) // block
        count = np.bincount(index, minlength=shape[0] * shape[1])
        total = np.bincount(index, weights=errors.error_m[mine], minlength=shape[0] * shape[1])
        mean = np.where(count > 0, np.rint(1e4 * total / np.maximum(count, 1)), -1).astype(int)
        rows = tuple(tuple(row) for row in mean.reshape(shape).tolist())
        images.append(ErrorImage(pair=number, block_px=block, error=rows))
    law = Triangulation(focal_px=truths[0].rig.fx, baseline_m=truths[0].rig.baseline_m)
    return MapDetails(cloud=sample, error_images=tuple(images), triangulation=law)
