"""A digital elevation model: height, its standard deviation and the number of points of square cells in LM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform

MAX_CELLS = 25_000_000
SLOPE = 0.1
"""Typical slope of ground: a point displaced along its ray lies over ground that is as much higher or lower."""


@dataclass(frozen=True, slots=True, eq=False)
class ElevationModel:
    """Heights over a grid whose rows go along y and columns along x of LM.

    Attributes:
        height_m: `(R, C)` float32, z of LM, NaN in cells without a point.
        sigma_m: `(R, C)` float32, standard deviation of the height, NaN likewise.
        count: `(R, C)` int32, points in the cell.
        origin_m: x and y of the outer corner of cell (0, 0), which has the least x and y.
        cell_m: Side of a cell.
    """

    height_m: NDArray[np.float32]
    sigma_m: NDArray[np.float32]
    count: NDArray[np.int32]
    origin_m: tuple[float, float]
    cell_m: float


def elevation_from_cloud(
    cloud: PointCloud,
    T_lm_left: Sequence[Transform],
    cell_m: float,
    random_sigma: NDArray[np.float32] | None = None,
) -> ElevationModel:
    """Return the elevation model of a cloud.

    An error `e` of a point along its ray is an error of its height of the ray's z component times `e`, and of what the
    ground rises over the horizontal displacement. Heights of a cell are averaged by the inverse of that variance.
    Errors of neighbouring points are correlated, so the variance of a cell's mean is that of its points; to it comes
    that of the mean over heights that differ within the cell, and what the points' sigma has beyond its random part: an
    error that they share has no say in their weights, and no mean removes it.

    Args:
        cloud: Points in LM.
        T_lm_left: Pose of the left camera of each pair, in the order of the points' `pair`.
        cell_m: Side of a cell.
        random_sigma: `(N,)`, metres, the part of sigma that differs from point to point; None for all of it.

    Raises:
        MappingError: If the cell is not positive, the cloud is empty, or there would be too many cells.
    """
    if not cell_m > 0.0:
        raise MappingError(f"cells of {cell_m} m: the side must be more than 0")
    if len(cloud) == 0:
        raise MappingError("the cloud has no points: an elevation model needs some")
    first, (rows, columns), cell = _cells(cloud, cell_m)
    height = cloud.xyz[:, 2].astype(np.float64)
    random, common = _height_variances(cloud, T_lm_left, random_sigma)
    weight = 1.0 / random

    def summed(values: FloatArray | None) -> FloatArray:
        return np.bincount(cell, values, rows * columns).astype(np.float64).reshape(rows, columns)

    count, weights = summed(None), summed(weight)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = summed(weight * height) / weights
        spread = summed(weight * np.square(height - mean.ravel()[cell])) / weights
        variance = count / weights + spread / count + summed(weight * common) / weights
    return ElevationModel(
        mean.astype(np.float32),
        np.sqrt(variance).astype(np.float32),
        count.astype(np.int32),
        (float(first[0] * cell_m), float(first[1] * cell_m)),
        cell_m,
    )


def _cells(cloud: PointCloud, cell_m: float) -> tuple[IntArray, tuple[int, int], IntArray]:
    """Return the number of the first cell along x and y, rows and columns of the grid, and each point's cell in it.

    Raises:
        MappingError: If there would be too many cells.
    """
    grid = np.floor(cloud.xyz[:, :2].astype(np.float64) / cell_m).astype(np.int64)
    first = grid.min(axis=0)
    columns, rows = (int(size) for size in grid.max(axis=0) - first + 1)
    if rows * columns > MAX_CELLS:
        raise MappingError(
            f"cells of {cell_m} m over {columns * cell_m:.0f} x {rows * cell_m:.0f} m are {rows * columns / 1e6:.0f} "
            f"million: {MAX_CELLS / 1e6:.0f} million are the limit; take larger cells or a smaller max_range_m"
        )
    return first, (rows, columns), (grid[:, 1] - first[1]) * columns + grid[:, 0] - first[0]


def _height_variances(
    cloud: PointCloud, T_lm_left: Sequence[Transform], random_sigma: NDArray[np.float32] | None
) -> tuple[FloatArray, FloatArray]:
    """Return the random part and the common part of the variance of each point's height `(N,)`, square metres."""
    share = np.square(rays(cloud, T_lm_left)[:, 2]) + SLOPE**2
    total = np.square(cloud.sigma, dtype=np.float64)
    random = total if random_sigma is None else np.square(random_sigma, dtype=np.float64)
    return np.asarray(share * random), np.asarray(share * np.maximum(total - random, 0.0))


def rays(cloud: PointCloud, T_lm_left: Sequence[Transform]) -> FloatArray:
    """Return the unit vectors `(N, 3)` in LM along which each point is seen by its pair's left camera."""
    centres = np.stack([pose.translation for pose in T_lm_left])
    ray = cloud.xyz - centres[cloud.pair]
    ray /= np.sqrt(np.einsum("ij,ij->i", ray, ray))[:, None]
    return np.asarray(ray)


def point_covariances(cloud: PointCloud, T_lm_left: Sequence[Transform], focal_px: float) -> NDArray[np.float32]:
    """Return the covariance of each point in LM `(N, 3, 3)`, square metres.

    Along the ray it is the point's variance. Across, a point represents its whole pixel: a uniform distribution over a
    square of side `Z / f`, whose variance is `(Z / f)^2 / 12`.

    Args:
        cloud: Points in LM.
        T_lm_left: Pose of the left camera of each pair, in the order of the points' `pair`.
        focal_px: Focal length, pixels.
    """
    ray = rays(cloud, T_lm_left)
    axes = np.stack([pose.rotation[:, 2] for pose in T_lm_left])[cloud.pair]
    centres = np.stack([pose.translation for pose in T_lm_left])[cloud.pair]
    depth = np.einsum("ij,ij->i", cloud.xyz - centres, axes)
    across = np.square(depth / focal_px) / 12.0
    along = np.square(cloud.sigma.astype(np.float64))
    outer = np.einsum("n,ni,nj->nij", along - across, ray, ray)
    outer[:, [0, 1, 2], [0, 1, 2]] += across[:, None]
    return np.asarray(outer, np.float32)
