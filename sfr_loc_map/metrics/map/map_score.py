"""The map score: the errors of the points of a cloud [4.3.4], the coverage and the completeness, as rows.

`score_map` scores a cloud whose points have pixels, and `score_nearest` scores points without pixels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import IntArray, Mask
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.metrics import formulas, other_formulas
from sfr_loc_map.metrics.completeness.expected_items import map_completeness
from sfr_loc_map.metrics.config import CloudKind, MapScoreConfig
from sfr_loc_map.metrics.figures.details import ErrorImage, MapDetails, PointRows, Triangulation, column
from sfr_loc_map.metrics.figures.records import CloudRecord
from sfr_loc_map.metrics.figures.results import MapResult
from sfr_loc_map.metrics.figures.row_part import POINTS, pair_part, range_part
from sfr_loc_map.metrics.figures.rows import Figure, figure_row, nees_row
from sfr_loc_map.metrics.map.cloud_frame import frame_problem
from sfr_loc_map.metrics.map.coverage import (
    PairCoverage,
    coverage_by_points,
    coverage_row,
    footprint_coverage,
    pixel_coverage,
)
from sfr_loc_map.metrics.map.pair_truth import PairTruth, check_points
from sfr_loc_map.metrics.map.point_errors import PointErrors, point_errors

MOST_AT_TRUE_POINT = 10
"""Maximum number of points that count for one nearest true point, if their pixels are unknown. On average at most one
point per pixel counts, and noise concentrates points by a much smaller factor than this number."""
NEES_BLOCK_PX = 32
"""Size of a block, px. One point of each block tests sigma, because errors of neighbours are correlated."""
IMAGE_WIDTH = 128  #: Maximum number of blocks in a row of an error image.
CLOUD_ROWS = 8000  #: Maximum number of points in plots.


def score_map(
    cloud: PointCloud,
    truths: Sequence[PairTruth],
    config: MapScoreConfig,
    *,
    expected_pairs: int | None = None,
    not_finite: int = 0,
) -> MapResult:
    """Return the score of a cloud in LM with known pixels.

    `expected_pairs` is the number of mapping pairs of the source, by default the number of truths. `not_finite` is the
    number of points that were dropped because a coordinate is not finite.

    MetricsError if it is unknown whether the cloud is fused, if there is no truth, if a point is not finite, or if a
    pixel or pair of the cloud is not of this source.
    """
    if cloud.fused is None:
        raise MetricsError(
            "it is unknown whether the cloud is fused, which changes the coverage: give fused=True or fused=False"
        )
    errors = point_errors(cloud, truths)
    scored = (config.scored_from_m, config.scored_to_m)
    if cloud.fused:
        pairs = footprint_coverage(cloud, truths, max((config.scored_to_m, *config.range_edges_m)))
    else:
        pairs = pixel_coverage(cloud, truths)
    figures = [*point_error_rows(None, errors, np.full(len(errors.index), True))]
    figures.append(coverage_row(None, pairs, *scored))
    figures += rows_of_ranges(errors, pairs, config.range_edges_m)
    figures += rows_of_pairs(cloud.pair[errors.index], errors, pairs, scored)
    figures += [figure_row("points", value=len(cloud)), figure_row("pairs", value=len(truths))]
    point_pairs = pairs_by_stamp(cloud)
    pixels = (point_pairs << 32) | (cloud.v.astype(np.int64) << 16) | cloud.u
    figures += map_completeness(
        points=len(cloud),
        not_finite=not_finite,
        without_truth=len(cloud) - len(errors.index),
        point_pairs=point_pairs,
        expected_pairs=len(truths) if expected_pairs is None else expected_pairs,
        uncovered=[pair.counts(*scored).uncovered_share for pair in pairs],
        repeated=len(cloud) - len(np.unique(pixels)),
    )
    figures += sigma_rows(cloud, errors)
    kind = CloudKind.FUSED if cloud.fused else CloudKind.SINGLE_PAIRS
    record = CloudRecord(kind=kind, scored_range_m=scored)
    return MapResult(figures=tuple(figures), cloud=record, details=map_details(cloud, errors, truths))


def score_nearest(
    xyz: NDArray[np.floating],
    truths: Sequence[PairTruth],
    config: MapScoreConfig,
    *,
    expected_pairs: int | None = None,
    not_finite: int = 0,
) -> MapResult:
    """Return the score of points with unknown pixels, by the distance to the nearest true point.

    The nearest true point is rarely the observed point, so these distances underestimate the errors. The number of
    repeated points is the largest of three numbers: points at the position of an earlier point, points in excess of the
    number of pixels of all pairs, and points in excess of `MOST_AT_TRUE_POINT` with the same nearest true point. A
    warning reports a cloud that is probably not in LM or not in metres.

    MetricsError if there is no truth, or if a point is not finite.
    """
    check_points(xyz, truths)
    from scipy.spatial import cKDTree  # slow to import, and nodes rarely need it

    true = [truth.points[np.isfinite(truth.points).all(axis=2)] for truth in truths]
    true_points = np.concatenate(true).astype(np.float64)
    tree = cKDTree(true_points, balanced_tree=False, compact_nodes=False)
    distance, nearest = (np.asarray(values) for values in tree.query(np.asarray(xyz, np.float64), workers=-1))
    problem = frame_problem(np.asarray(xyz, np.float64), true_points, lambda points: np.asarray(tree.query(points)[0]))
    scored = (config.scored_from_m, config.scored_to_m)
    pairs = coverage_by_points(xyz, truths, config.scored_to_m)
    uncovered = [pair.counts(*scored).uncovered_share for pair in pairs]
    is_mapped = [share is not None and share < 1.0 for share in uncovered]  # the pairs of the points are unknown
    near_pairs = np.flatnonzero(is_mapped)
    pixels = sum(truth.rig.height * truth.rig.width for truth in truths)
    has_nearest = np.isfinite(distance)  # no point has one if there is no true point
    crowded = int(np.maximum(np.bincount(nearest[has_nearest]) - MOST_AT_TRUE_POINT, 0).sum())
    repeated = max(len(xyz) - len(np.unique(xyz, axis=0)), len(xyz) - pixels, crowded)
    many = len(truths) if expected_pairs is None else expected_pairs
    figures = (
        figure_row("nearest_distance", statistics=formulas.statistics(distance)),
        coverage_row(None, pairs, *scored),
        figure_row("points", value=len(xyz)),
        figure_row("pairs", value=len(truths)),
        *map_completeness(
            points=len(xyz),
            not_finite=not_finite,
            without_truth=0,
            point_pairs=near_pairs,
            expected_pairs=many,
            uncovered=uncovered,
            repeated=repeated,
        ),
    )
    record = CloudRecord(nearest_only=True, scored_range_m=scored)
    return MapResult(figures=figures, cloud=record, warnings=(problem,) if problem else ())


# ---- rows


def rows_of_ranges(errors: PointErrors, pairs: Sequence[PairCoverage], edges_m: Sequence[float]) -> Iterator[Figure]:
    """Yield the rows of the points in each range between two edges."""
    for low, high in pairwise(edges_m):
        part = range_part(low, high)
        yield from point_error_rows(part, errors, (errors.range_m >= low) & (errors.range_m < high))
        yield coverage_row(part, pairs, low, high)


def rows_of_pairs(
    pair_of_point: NDArray[np.integer], errors: PointErrors, pairs: Sequence[PairCoverage], scored: tuple[float, float]
) -> Iterator[Figure]:
    """Yield the rows of the points of each mapping pair; `scored` is the range of the coverage, m."""
    for number, pair in enumerate(pairs):
        part = pair_part(number)
        yield from point_error_rows(part, errors, pair_of_point == number)
        yield coverage_row(part, [pair], *scored)


def point_error_rows(part: str | None, errors: PointErrors, chosen: Mask) -> Iterator[Figure]:
    """Yield the rows of the point, height, horizontal and disparity errors of the chosen points."""
    vertical_m, horizontal_m = errors.vertical_m[chosen], errors.horizontal_m[chosen]
    robust = {"nmad": other_formulas.nmad, "le90": other_formulas.le90, "ce90": other_formulas.ce90}
    for name, number in robust.items():
        values = horizontal_m if name == "ce90" else vertical_m
        yield figure_row(name, part=part, n=len(values), value=number(values) if len(values) else None)
    yield figure_row("point_error", part=part, statistics=formulas.statistics(errors.error_m[chosen]))
    yield figure_row("disparity_error", part=part, statistics=formulas.statistics(errors.disparity_px[chosen]))


def sigma_rows(cloud: PointCloud, errors: PointErrors) -> Iterator[Figure]:
    """Yield the mean of (error along the ray / sigma)^2 over one point of each block.

    The errors of points in different blocks are independent.
    """
    sigma = cloud.sigma[errors.index].astype(np.float64)
    usable = np.flatnonzero(np.isfinite(sigma) & (sigma > 0) & np.isfinite(errors.along_m))
    points = errors.index[usable]
    u, v = (pixels[points].astype(np.int64) // NEES_BLOCK_PX for pixels in (cloud.u, cloud.v))
    block = (cloud.pair[points].astype(np.int64) << 32) + (v << 16) + u
    chosen = usable[np.unique(block, return_index=True)[1]]
    if len(chosen) < 2:
        return
    squares = np.square(errors.along_m[chosen] / sigma[chosen])
    yield nees_row("nees", squares, 1, part=POINTS, p50=float(np.median(squares)))


def pairs_by_stamp(cloud: PointCloud) -> IntArray:
    """Return the pair of each point; pairs with the same stamp count as one pair, with the number of the first."""
    numbers = cloud.pair.astype(np.int64)
    if cloud.pair_stamps_ns is None:
        return numbers
    _, first, of_stamp = np.unique(cloud.pair_stamps_ns, return_index=True, return_inverse=True)
    return np.asarray(first[of_stamp][numbers], np.int64)


# ---- data of the plots


def map_details(cloud: PointCloud, errors: PointErrors, truths: Sequence[PairTruth]) -> MapDetails:
    """Return the data of the plots of a map."""
    step = max(1, -(-len(errors.index) // CLOUD_ROWS))
    x, y, z = (column(values.astype(float), 3) for values in cloud.xyz[errors.index[::step]].T)
    sample = PointRows(
        x_m=x, y_m=y, z_m=z, error_m=column(errors.error_m[::step], 4), range_m=column(errors.range_m[::step], 3)
    )
    images = tuple(error_image(cloud, errors, truth, number) for number, truth in enumerate(truths))
    law = Triangulation(focal_px=truths[0].rig.fx, baseline_m=truths[0].rig.baseline_m)
    return MapDetails(cloud=sample, error_images=images, triangulation=law)


def error_image(cloud: PointCloud, errors: PointErrors, truth: PairTruth, number: int) -> ErrorImage:
    """Return the mean error in each block of pixels of one pair."""
    block = max(1, -(-truth.rig.width // IMAGE_WIDTH))
    rows, columns = -(-truth.rig.height // block), -(-truth.rig.width // block)
    mine = cloud.pair[errors.index] == number
    points = errors.index[mine]
    block_of_point = (cloud.v[points].astype(np.int64) // block) * columns + cloud.u[points].astype(np.int64) // block
    count = np.bincount(block_of_point, minlength=rows * columns)
    total = np.bincount(block_of_point, weights=errors.error_m[mine], minlength=rows * columns)
    mean = np.where(count > 0, np.rint(1e4 * total / np.maximum(count, 1)), -1).astype(int)
    return ErrorImage(
        pair=number, block_px=block, error_0p1mm=tuple(tuple(row) for row in mean.reshape(rows, columns).tolist())
    )
