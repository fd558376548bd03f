"""The map score: the error of every point relative to the true point of its pixel, and the coverage [4.3.4]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.message_text import counted
from sfr_loc_map.metrics import formulas, formulas_beside
from sfr_loc_map.metrics.completeness.expected_items import map_completeness
from sfr_loc_map.metrics.config import CloudKind, MapScoreConfig
from sfr_loc_map.metrics.table.details import ErrorImage, MapDetails, PointRows, Triangulation, column
from sfr_loc_map.metrics.table.records import CloudRecord
from sfr_loc_map.metrics.table.results import MapResult
from sfr_loc_map.metrics.table.row_part import POINTS, pair_part, range_part
from sfr_loc_map.metrics.table.rows import Figure, figure_row, nees_row

MOST_AT_TRUE_POINT = 10
"""Maximum number of points without pixels with the same nearest true point that count. On average at most one point per
pixel counts, and noise concentrates points by much less."""
FOOTPRINTS = 2.0  #: Distance, in pixel footprints Z / f, within which a point of a fused cloud covers a true point.
BATCH = 262144
PIXEL_SAMPLES = 2000  #: Number of points per pair whose projection is compared with their pixel.
NEES_BLOCK_PX = 32
"""Size of a block, px. One point of each block tests sigma, because errors of neighbours are correlated."""
IMAGE_WIDTH = 128
CLOUD_ROWS = 8000


@dataclass(frozen=True, slots=True, eq=False)
class PairTruth:
    """The truth of one pair: points `(H, W, 3)` float32 in LM, metres, NaN if absent, and the left optical frame."""

    points: NDArray[np.float32]
    T_lm_left: Transform
    rig: StereoRig

    def __post_init__(self) -> None:
        """Check that the truth has the image size of the rig; MetricsError if not."""
        if self.points.shape != (self.rig.height, self.rig.width, 3):
            needed = (self.rig.height, self.rig.width, 3)
            raise MetricsError(f"truth of a mapping pair has the shape {self.points.shape}: {needed} is required")

    @classmethod
    def of(cls, pair: PosedStereoPair, rig: StereoRig) -> PairTruth | None:
        """Return the truth of a pair, None if the source has none."""
        return None if pair.truth is None else cls(pair.truth, pair.T_lm_navsb @ rig.T_sb_left, rig)

    def ranges_m(self) -> FloatArray:
        """Return the distance `(H, W)` of each true point from the left optical centre; NaN without a true point."""
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
        which = f"the pairs of stamps {', '.join(without)} ns have none" if without else "the source has no pair"
        raise MetricsError(f"a map score requires the truth of every pair, but {which}: give a source with truth")
    return [truth for truth in truths if truth is not None]


def check_cloud(xyz: NDArray[np.floating], truths: Sequence[PairTruth]) -> None:
    """Check that all points `(P, 3)` are finite and that there is a truth; MetricsError if not."""
    if not truths:
        raise MetricsError("a map score requires the truth of at least one pair: give a source with truth")
    if not np.isfinite(xyz).all():
        raise MetricsError("the cloud has points that are not finite: remove them")


# ---- coverage and point errors


def pixel_coverage(cloud: PointCloud, truths: Sequence[PairTruth]) -> list[Mask]:
    """Return for each pair the mask `(H, W)` of the pixels that have a point."""
    covered = [np.zeros(truth.points.shape[:2], np.bool_) for truth in truths]
    for number, image in enumerate(covered):
        mine = cloud.pair == number
        image[cloud.v[mine], cloud.u[mine]] = True
    return covered


def footprint_coverage(
    cloud: PointCloud, truths: Sequence[PairTruth], ranges: Sequence[FloatArray], farthest_m: float
) -> list[Mask]:
    """Return for each pair the mask `(H, W)` of the true points that have a cloud point within two footprints.

    True points beyond the range `farthest_m` are not searched.
    """
    from scipy.spatial import cKDTree  # slow to import, and nodes rarely need it

    tree = cKDTree(cloud.xyz.astype(np.float64), balanced_tree=False, compact_nodes=False) if len(cloud) else None
    covered = []
    for number, (truth, distance) in enumerate(zip(truths, ranges, strict=True)):
        image = np.zeros(distance.shape, np.bool_)
        radius = FOOTPRINTS * truth.depths_m(truth.points) / truth.rig.fx
        mine = np.flatnonzero(cloud.pair == number)
        v, u = cloud.v[mine], cloud.u[mine]
        own = np.sqrt(np.square(cloud.xyz[mine].astype(np.float64) - truth.points[v, u]).sum(axis=1))
        image[v[own < radius[v, u]], u[own < radius[v, u]]] = True  # avoids most of the search
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


def typical_pixel_offset(cloud: PointCloud, truths: Sequence[PairTruth]) -> float:
    """Return the median distance between the projections of points and the pixels that the cloud states, px.

    The distance of a point behind the camera is infinite. The result is 0 without points.
    """
    offsets = []
    for number, truth in enumerate(truths):
        mine = np.flatnonzero(cloud.pair == number)
        mine = mine[:: max(1, len(mine) // PIXEL_SAMPLES)]
        x, y, z = ((cloud.xyz[mine].astype(np.float64) - truth.T_lm_left.translation) @ truth.T_lm_left.rotation).T
        rig, is_seen = truth.rig, z > 0.0
        depth = np.where(is_seen, z, 1.0)
        across = rig.fx * x / depth + rig.cx - cloud.u[mine]
        down = rig.fy * y / depth + rig.cy - cloud.v[mine]
        offsets.append(np.where(is_seen, np.hypot(across, down), np.inf))
    known = np.concatenate(offsets) if offsets else np.zeros(0)
    return float(np.median(known)) if len(known) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PointErrors:
    """The errors `(N,)` of points that have a true point, in the order of the cloud."""

    index: NDArray[np.intp]  #: Indices of the points in the cloud.
    error_m: FloatArray  #: Distance from the true point [4.3.4].
    range_m: FloatArray  #: Distance of the true point from the left optical centre.
    along_m: FloatArray  #: Component of the error along the ray, positive if the point is too far.
    vertical_m: FloatArray  #: Error along z of LM, positive if the point is too high.
    horizontal_m: FloatArray  #: Norm of the error in the x-y plane of LM.
    disparity_px: FloatArray  #: `f b / Z - f b / Z_true` of the depths Z along the left optical axis; NaN unless Z > 0.


def point_errors(cloud: PointCloud, truths: Sequence[PairTruth]) -> PointErrors:
    """Return the errors of all points whose pixel has a true point; MetricsError if a point is not of this source."""
    check_cloud(cloud.xyz, truths)
    if len(cloud) and int(last := cloud.pair.max()) >= len(truths):
        pairs = counted(len(truths), "pair")
        problem = f"the cloud has points of pair {last} (counted from 0) but the truth has only {pairs}"
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
        ray = true - truth.T_lm_left.translation
        distance = np.linalg.norm(ray, axis=1)
        depth, true_depth = truth.depths_m(estimated), truth.depths_m(true)
        disparity = formulas_beside.disparity_error(truth.rig.fx, truth.rig.baseline_m, depth, true_depth)
        error = formulas.point_error(estimated, true)
        along = np.sum((estimated - true) * ray, axis=1) / distance
        offset = estimated - true
        horizontal = np.hypot(offset[:, 0], offset[:, 1])
        parts.append(
            PointErrors(
                index=index,
                error_m=error,
                range_m=distance,
                along_m=along,
                vertical_m=offset[:, 2],
                horizontal_m=horizontal,
                disparity_px=disparity,
            )
        )
    order = np.argsort(np.concatenate([part.index for part in parts]), kind="stable")
    columns = (field.name for field in fields(PointErrors))
    return PointErrors(**{name: np.concatenate([getattr(part, name) for part in parts])[order] for name in columns})


def points_table(cloud: PointCloud, truths: Sequence[PairTruth]) -> dict[str, NDArray[Any]]:
    """Return the pixel, estimated and true position, range, error and sigma of every point with a truth, as columns."""
    errors = point_errors(cloud, truths)
    rows = errors.index
    pair, u, v = cloud.pair[rows], cloud.u[rows], cloud.v[rows]
    true = np.empty((len(rows), 3))
    for number, truth in enumerate(truths):
        mine = pair == number
        true[mine] = truth.points[v[mine], u[mine]]
    table: dict[str, NDArray[Any]] = {"pair": pair, "u": u, "v": v, "range_m": errors.range_m}
    table |= {"error_m": errors.error_m, "sigma_m": cloud.sigma[rows].astype(np.float64)}
    for axis, values in zip("xyz", true.T, strict=True):
        table[f"true_{axis}_m"] = values
    for axis, values in zip("xyz", cloud.xyz[rows].astype(np.float64).T, strict=True):
        table[f"estimated_{axis}_m"] = values
    return table


# ---- the score


def score_map(
    cloud: PointCloud,
    truths: Sequence[PairTruth],
    config: MapScoreConfig,
    *,
    expected_pairs: int | None = None,
    not_finite: int = 0,
) -> MapResult:
    """Return the score of a cloud in LM with known pixels; MetricsError if the cloud is not of this source.

    `expected_pairs` is the number of mapping pairs of the source, by default the number of truths. `not_finite` is the
    number of points that were dropped because a coordinate is not finite.
    """
    if cloud.fused is None:
        raise MetricsError(
            "it is unknown whether the cloud is fused, which changes the coverage: give fused=True or fused=False"
        )
    errors = point_errors(cloud, truths)
    ranges = [truth.ranges_m() for truth in truths]
    scored = (config.scored_from_m, config.scored_to_m)
    if cloud.fused:
        covered = footprint_coverage(cloud, truths, ranges, max((config.scored_to_m, *config.range_edges_m)))
    else:
        covered = pixel_coverage(cloud, truths)
    figures = [*error_rows(None, errors, np.full(len(errors.index), True))]
    figures.append(coverage_row(None, covered, ranges, *scored))
    figures += rows_of_ranges(errors, covered, ranges, config.range_edges_m)
    figures += rows_of_pairs(cloud.pair[errors.index], errors, covered, ranges, scored)
    figures += [figure_row("points", value=len(cloud)), figure_row("pairs", value=len(truths))]
    point_pairs = pairs_by_stamp(cloud)
    pixels = (point_pairs << 32) | (cloud.v.astype(np.int64) << 16) | cloud.u
    figures += map_completeness(
        points=len(cloud),
        not_finite=not_finite,
        without_truth=len(cloud) - len(errors.index),
        point_pairs=point_pairs,
        expected_pairs=len(truths) if expected_pairs is None else expected_pairs,
        bare=[bare_share(image, distance, *scored) for image, distance in zip(covered, ranges, strict=True)],
        repeated=len(cloud) - len(np.unique(pixels)),
    )
    figures += sigma_rows(cloud, errors)
    kind = CloudKind.FUSED if cloud.fused else CloudKind.SINGLE_PAIRS
    record = CloudRecord(kind=kind, scored_range_m=scored)
    return MapResult(figures=tuple(figures), cloud=record, details=_details(cloud, errors, truths))


def rows_of_ranges(
    errors: PointErrors, covered: Sequence[Mask], ranges: Sequence[FloatArray], edges_m: Sequence[float]
) -> Iterator[Figure]:
    """Yield the rows of the points in each range between two edges."""
    for low, high in pairwise(edges_m):
        part = range_part(low, high)
        yield from error_rows(part, errors, (errors.range_m >= low) & (errors.range_m < high))
        yield coverage_row(part, covered, ranges, low, high)


def rows_of_pairs(
    pair_of_point: NDArray[np.integer],
    errors: PointErrors,
    covered: Sequence[Mask],
    ranges: Sequence[FloatArray],
    scored: tuple[float, float],
) -> Iterator[Figure]:
    """Yield the rows of the points of each mapping pair; `scored` is the range of its coverage, m."""
    for number, (image, distance) in enumerate(zip(covered, ranges, strict=True)):
        part = pair_part(number)
        yield from error_rows(part, errors, pair_of_point == number)
        yield coverage_row(part, [image], [distance], *scored)


def pairs_by_stamp(cloud: PointCloud) -> IntArray:
    """Return the pair of each point; pairs with the same stamp count as one pair, with the number of the first."""
    numbers = cloud.pair.astype(np.int64)
    if cloud.pair_stamps_ns is None:
        return numbers
    _, first, of_stamp = np.unique(cloud.pair_stamps_ns, return_index=True, return_inverse=True)
    return np.asarray(first[of_stamp][numbers], np.int64)


def score_nearest(
    xyz: NDArray[np.floating],
    truths: Sequence[PairTruth],
    config: MapScoreConfig,
    *,
    expected_pairs: int | None = None,
    not_finite: int = 0,
) -> MapResult:
    """Return the score of points with unknown pixels, by the distance to the nearest true point.

    The nearest true point is rarely the observed point, so these distances underestimate the errors. Points at the
    position of an earlier point, points in excess of the number of pixels of all pairs, and points in excess of
    `MOST_AT_TRUE_POINT` with the same nearest true point count as repeated. MetricsError if a point is not finite.
    """
    check_cloud(xyz, truths)
    from scipy.spatial import cKDTree  # slow to import, and nodes rarely need it

    true = [truth.points[np.isfinite(truth.points).all(axis=2)] for truth in truths]
    tree = cKDTree(np.concatenate(true).astype(np.float64), balanced_tree=False, compact_nodes=False)
    distance, nearest = (np.asarray(values) for values in tree.query(np.asarray(xyz, np.float64), workers=-1))
    records = np.zeros(len(xyz), PointCloud.dtype())
    records["x"], records["y"], records["z"], records["pair"] = (*np.asarray(xyz).T, 255)  # 255: no pair
    ranges, scored = [truth.ranges_m() for truth in truths], (config.scored_from_m, config.scored_to_m)
    covered = footprint_coverage(PointCloud.from_structured(records), truths, ranges, config.scored_to_m)
    bare = [bare_share(image, far, *scored) for image, far in zip(covered, ranges, strict=True)]
    is_mapped = [share is not None and share < 1.0 for share in bare]  # the pairs of the points are unknown
    near_pairs = np.flatnonzero(is_mapped)
    pixels = sum(truth.rig.height * truth.rig.width for truth in truths)
    crowded = int(np.maximum(np.bincount(nearest) - MOST_AT_TRUE_POINT, 0).sum())
    repeated = max(len(xyz) - len(np.unique(xyz, axis=0)), len(xyz) - pixels, crowded)
    many = len(truths) if expected_pairs is None else expected_pairs
    figures = (
        figure_row("nearest_distance", statistics=formulas.statistics(distance)),
        coverage_row(None, covered, ranges, *scored),
        figure_row("points", value=len(xyz)),
        figure_row("pairs", value=len(truths)),
        *map_completeness(
            points=len(xyz),
            not_finite=not_finite,
            without_truth=0,
            point_pairs=near_pairs,
            expected_pairs=many,
            bare=bare,
            repeated=repeated,
        ),
    )
    return MapResult(figures=figures, cloud=CloudRecord(nearest_only=True, scored_range_m=scored))


def error_rows(part: str | None, errors: PointErrors, chosen: Mask) -> Iterator[Figure]:
    """Yield the rows of the point, height, horizontal and disparity errors of the chosen points."""
    vertical_m, horizontal_m = errors.vertical_m[chosen], errors.horizontal_m[chosen]
    robust = {"nmad": formulas_beside.nmad, "le90": formulas_beside.le90, "ce90": formulas_beside.ce90}
    for name, number in robust.items():
        values = horizontal_m if name == "ce90" else vertical_m
        yield figure_row(name, part=part, n=len(values), value=number(values) if len(values) else None)
    yield figure_row("point_error", part=part, statistics=formulas.statistics(errors.error_m[chosen]))
    yield figure_row("disparity_error", part=part, statistics=formulas.statistics(errors.disparity_px[chosen]))


def coverage_row(
    part: str | None, covered: Sequence[Mask], ranges: Sequence[FloatArray], low: float, high: float
) -> Figure:
    """Return the row of the fraction of true points in a range [low, high) that are covered."""
    inside = [(distance >= low) & (distance < high) for distance in ranges]
    total = sum(int(np.count_nonzero(which)) for which in inside)
    have = sum(int(np.count_nonzero(image[which])) for image, which in zip(covered, inside, strict=True))
    return figure_row("coverage", part=part, n=total, value=have / total if total else None)


def bare_share(covered: Mask, distance: FloatArray, low: float, high: float) -> float | None:
    """Return the fraction of the true pixels in a range [low, high) that have no point; None without a true pixel."""
    inside = (distance >= low) & (distance < high)
    total = int(np.count_nonzero(inside))
    return int(np.count_nonzero(inside & ~covered)) / total if total else None


def sigma_rows(cloud: PointCloud, errors: PointErrors) -> Iterator[Figure]:
    """Yield the mean of (error along the ray / sigma)^2 over one point of each block, whose errors are independent."""
    sigma = cloud.sigma[errors.index].astype(np.float64)
    usable = np.flatnonzero(np.isfinite(sigma) & (sigma > 0))
    points = errors.index[usable]
    u, v = (pixels[points].astype(np.int64) // NEES_BLOCK_PX for pixels in (cloud.u, cloud.v))
    block = (cloud.pair[points].astype(np.int64) << 32) + (v << 16) + u
    chosen = usable[np.unique(block, return_index=True)[1]]
    if len(chosen) < 2:
        return
    squares = np.square(errors.along_m[chosen] / sigma[chosen])
    yield nees_row("nees", squares, 1, part=POINTS, p50=float(np.median(squares)))


def _details(cloud: PointCloud, errors: PointErrors, truths: Sequence[PairTruth]) -> MapDetails:
    step = max(1, -(-len(errors.index) // CLOUD_ROWS))
    some = errors.index[::step]
    x, y, z = (column(values.astype(float), 3) for values in cloud.xyz[some].T)
    sample = PointRows(
        x_m=x, y_m=y, z_m=z, error_m=column(errors.error_m[::step], 4), range_m=column(errors.range_m[::step], 3)
    )
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
        images.append(ErrorImage(pair=number, block_px=block, error_0p1mm=rows))
    law = Triangulation(focal_px=truths[0].rig.fx, baseline_m=truths[0].rig.baseline_m)
    return MapDetails(cloud=sample, error_images=tuple(images), triangulation=law)
