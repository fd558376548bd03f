"""A digital elevation model: height, its standard deviation and the number of points of square cells in LM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import F, FloatArray, FloatArray32
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.cloud_checks import check_random_sigma, check_sigma
from sfr_loc_map.mapping.point_covariance import rays_from_cameras
from sfr_loc_map.mapping.terrain.cells import CellGrid

MIN_POINTS = 3
"""Minimum number of points that a cell needs to be given a height. With three points, one remains when `steps` removes
the lowest and the highest."""
TYPICAL_SLOPE = 0.1
"""Typical slope of ground, metres per metre, which converts a horizontal error of a point to a height error."""
MIN_SIGMA_M = 1e-6  #: Lower bound of the random sigma of a point, metres, whose inverse square is a weight.


@dataclass(frozen=True, slots=True, eq=False)
class ElevationModel:
    """Heights over a grid whose rows are along y and columns along x of LM."""

    height_m: FloatArray32  #: `(R, C)` float32, z of LM; NaN where `count` is below `MIN_POINTS`.
    sigma_m: FloatArray32  #: `(R, C)` float32, standard deviation of the height; NaN where the height is unknown.
    count: NDArray[np.int32]  #: `(R, C)` int32, points in the cell.
    cells: CellGrid  #: Number, position and size of the cells.

    @property
    def origin_m(self) -> tuple[float, float]:
        """The smallest x and y of cell (0, 0)."""
        return self.cells.origin_m

    @property
    def cell_m(self) -> float:
        """Side of a cell."""
        return self.cells.cell_m


def elevation_model(
    cloud: PointCloud,
    cells: CellGrid,
    cell_of_point: NDArray[np.int32],
    poses_lm_left: Sequence[Transform] | None = None,
    random_sigma: FloatArray32 | None = None,
) -> ElevationModel:
    """Return the elevation model of a cloud over cells.

    Raises MappingError if no cell contains a point, if a sigma is negative or not finite, if `random_sigma` has another
    shape than the sigma of the cloud or exceeds this sigma, or if the pose of a point is missing.

    `cell_of_point` `(N,)` is the cell of each point, -1 outside (`CellGrid.cell_of`). The caller passes the cells,
    because other layers of the grid use them, too. The pair index of a point is the index of its left camera's pose.
    Without poses, the sigma of heights is overestimated. `random_sigma` `(N,)` is the part of the points' sigma that
    differs from point to point; None if the complete sigma differs from point to point.

    The height of a cell is the weighted mean of its n points' heights, and is unknown with fewer than `MIN_POINTS`. The
    weight w is the inverse of the random variance of a height (`_height_variance_ratio`). The variance of a cell is the
    sum of three parts:

    - the harmonic mean of the random variances of its heights, `n / sum w`: the errors of neighbouring points are
      correlated, so averaging does not reduce them;
    - the variance of the mean due to different heights h within the cell, `sum w (h - mean)^2 / sum w / n`;
    - the weighted mean of the common variance of the heights, which is the total minus the random variance.
    """
    check_sigma(cloud.sigma, "the sigma of the cloud")
    if random_sigma is not None:
        check_random_sigma(random_sigma, cloud.sigma)
    inside = np.flatnonzero(cell_of_point >= 0)
    if not len(inside):
        raise MappingError("the cloud has no points on the grid: increase the range (terrain.range_m)")
    cell = cell_of_point[inside].astype(np.intp)
    xyz = cloud.xyz.take(inside, axis=0)  # faster than fancy indexing
    height = xyz[:, 2].astype(np.float64)
    total = np.square(cloud.sigma[inside], dtype=np.float64)
    random = total if random_sigma is None else np.square(random_sigma[inside], dtype=np.float64)
    random = np.maximum(random, MIN_SIGMA_M**2)
    ratio = _height_variance_ratio(xyz, cloud.pair[inside], poses_lm_left)
    weight = 1.0 / (ratio * random)
    cell_count = cells.rows * cells.columns

    def sums(values: FloatArray) -> FloatArray:
        """Return the sum over the points of each cell."""
        return np.asarray(np.bincount(cell, values, cell_count), np.float64)

    with np.errstate(divide="ignore", invalid="ignore"):
        count = np.bincount(cell, minlength=cell_count)
        weights = sums(weight)
        mean = sums(weight * height) / weights
        squares = sums(weight * np.square(height - mean[cell]))
        variance_of_points = count / weights
        variance_of_mean = squares / weights / count
        common_variance = sums(weight * (ratio * np.maximum(total - random, 0.0))) / weights
        sigma = np.sqrt(variance_of_points + variance_of_mean + common_variance)
    is_sparse = count < MIN_POINTS
    mean[is_sparse] = np.nan
    sigma[is_sparse] = np.nan
    shape = (cells.rows, cells.columns)
    return ElevationModel(
        height_m=mean.astype(F).reshape(shape),
        sigma_m=sigma.astype(F).reshape(shape),
        count=count.astype(np.int32).reshape(shape),
        cells=cells,
    )


def _height_variance_ratio(
    xyz: FloatArray32, pair_index: NDArray[np.uint8], poses_lm_left: Sequence[Transform] | None
) -> FloatArray:
    """Return the ratio of the variance of the height to the variance along the ray for each point `(N,)`.

    An error along a ray with the unit vector `(x, y, z)` changes the height by z times the error. The horizontal part
    of the error displaces the point, and the ground there differs in height by about `TYPICAL_SLOPE` times the error.
    The ratio is `z^2 + TYPICAL_SLOPE^2`. Without poses, z is assumed to be 1, its maximum.
    """
    if poses_lm_left is None:
        return np.full(len(xyz), 1.0 + TYPICAL_SLOPE**2)
    squares = rays_from_cameras(xyz, pair_index, poses_lm_left)
    np.square(squares, out=squares)
    x_squared, y_squared, z_squared = squares.T
    return np.asarray(z_squared / (x_squared + y_squared + z_squared) + TYPICAL_SLOPE**2)
