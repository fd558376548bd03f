"""A digital elevation model: height, its standard deviation and the number of points of square cells in LM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import F, FloatArray, FloatArray32
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.rays import rays_from_cameras

MAX_CELLS = 2_500_000  #: Largest number of cells: a grid takes up to 120 bytes per cell while it is made, 300 MB.
TYPICAL_SLOPE = 0.1
"""Typical slope of ground, metres per metre: a displaced point has the height of other ground. Chosen by hand: a point
that is seen from above then has 0.5 % more standard deviation of its height, one seen along the ground a tenth of its
sigma."""
ROUNDED_DOWN = 1.05  #: Rounding to two digits lowers a number by less than this factor.


class Square(NamedTuple):
    """A square in x and y of LM."""

    x_m: float  #: Centre.
    y_m: float  #: Centre.
    half_side_m: float


@dataclass(frozen=True, slots=True)
class CellGrid:
    """A grid of square cells whose sides are at multiples of their length in x and y of LM.

    Grids of one cell size therefore have the same cells, whatever cloud they were made of.
    """

    first_column: int  #: Column of cell (0, 0), counted from the cell at the origin of LM.
    first_row: int  #: Row of cell (0, 0), counted likewise.
    rows: int  #: Cells along y.
    columns: int  #: Cells along x.
    cell_m: float  #: Side of a cell.

    @property
    def origin_m(self) -> tuple[float, float]:
        """The smallest x and y of cell (0, 0)."""
        return self.first_column * self.cell_m, self.first_row * self.cell_m

    @classmethod
    def over(cls, xyz: FloatArray32, cell_m: float, within: Square | None = None) -> CellGrid:
        """Return a grid that has a cell for each point `(N, 3)` in LM; points outside a square are ignored.

        Raises MappingError if the cell size is not positive, no point remains, or there would be too many cells.
        """
        if not cell_m > 0.0:
            raise MappingError(f"cells of {cell_m} m: the side must be more than 0")
        if len(xyz) == 0:
            raise MappingError("the cloud has no points: an elevation model needs some")
        low = np.array([float(xyz[:, axis].min()) for axis in (0, 1)])
        high = np.array([float(xyz[:, axis].max()) for axis in (0, 1)])
        if within is not None:
            centre = np.array((within.x_m, within.y_m))
            low = np.maximum(low, centre - within.half_side_m)
            high = np.minimum(high, centre + within.half_side_m)
            if (low > high).any():
                raise MappingError(
                    f"the cloud has no points within {within.half_side_m} m of the cameras: raise terrain.range_m"
                )
        if not (np.isfinite((low, high)).all() and np.isfinite(xyz[:, 2]).all()):
            raise MappingError("the cloud has points that are not finite: remove them")
        first = np.floor(low / cell_m)
        columns, rows = np.floor(high / cell_m) - first + 1
        if rows * columns > MAX_CELLS:
            x, y = high - low
            possible_m = ROUNDED_DOWN * _smallest_cell(x, y)
            raise MappingError(
                f"cells of {cell_m} m over {x:.4g} x {y:.4g} m are {rows * columns / 1e6:.3g} million: "
                f"{MAX_CELLS / 1e6} million are the limit; take cells of {possible_m:.2g} m or more"
            )
        return cls(int(first[0]), int(first[1]), int(rows), int(columns), cell_m)

    def cell_of(self, xyz: FloatArray32) -> NDArray[np.int32]:
        """Return the cell `(N,)` of each point, row times columns plus column; -1 outside the grid."""
        column = np.floor(xyz[:, 0].astype(np.float64) / self.cell_m) - self.first_column
        row = np.floor(xyz[:, 1].astype(np.float64) / self.cell_m) - self.first_row
        inside = (column >= 0.0) & (column < self.columns) & (row >= 0.0) & (row < self.rows)
        return np.where(inside, row * self.columns + column, -1.0).astype(np.int32)


def _smallest_cell(x_m: float, y_m: float) -> float:
    """Return the smallest cell size of which a rectangle has at most `MAX_CELLS`.

    Cells of size c cover it with at most `(x / c + 2) (y / c + 2)` cells, a quadratic equation in c.
    """
    spare = MAX_CELLS - 4
    return float((x_m + y_m + np.hypot(x_m + y_m, np.sqrt(spare * x_m * y_m))) / spare)


@dataclass(frozen=True, slots=True, eq=False)
class ElevationModel:
    """Heights over a grid whose rows are along y and columns along x of LM."""

    height_m: FloatArray32  #: `(R, C)` float32, z of LM; NaN in cells without a point.
    sigma_m: FloatArray32  #: `(R, C)` float32, standard deviation of the height; NaN in cells without a point.
    count: NDArray[np.int32]  #: `(R, C)` int32, points in the cell.
    grid: CellGrid  #: The cells.

    @property
    def origin_m(self) -> tuple[float, float]:
        """The smallest x and y of cell (0, 0)."""
        return self.grid.origin_m

    @property
    def cell_m(self) -> float:
        """Side of a cell."""
        return self.grid.cell_m


def elevation_model(
    cloud: PointCloud,
    grid: CellGrid,
    poses_lm_left: Sequence[Transform] | None = None,
    random_sigma: FloatArray32 | None = None,
) -> ElevationModel:
    """Return the elevation model of a cloud over a grid; raises MappingError if no point is on it.

    Poses of the left cameras are in the order of the points' `pair`; without poses, sigma of heights is overstated.
    `random_sigma` `(N,)` is the part of the points' sigma that differs from point to point; None if all of it does.

    The height of a cell is the mean of its points' heights with the weights w, one over the random variance of a height
    (`_height_variance_ratio`). The variance of a cell is the sum of three parts:

    - the harmonic mean of the variances of its points, `n / sum w`: the errors of neighbouring points are correlated,
      so that averaging does not reduce them;
    - the variance of the mean of heights h that differ within the cell, `sum w (h - mean)^2 / sum w / n`;
    - the weighted mean of the part of the points' variance beyond the random one, which all points share.
    """
    cell = grid.cell_of(cloud.xyz)
    inside = np.flatnonzero(cell >= 0)
    if not len(inside):
        raise MappingError("the cloud has no points on the grid: raise terrain.range_m")
    cell_of_point = cell[inside].astype(np.intp)
    xyz = cloud.xyz.take(inside, axis=0)  # faster than indexing by rows
    height = xyz[:, 2].astype(np.float64)
    total = np.square(cloud.sigma[inside], dtype=np.float64)
    random = total if random_sigma is None else np.square(random_sigma[inside], dtype=np.float64)
    ratio = _height_variance_ratio(xyz, cloud.pair[inside], poses_lm_left)
    weight = 1.0 / (ratio * random)
    cell_count = grid.rows * grid.columns

    def sums(values: FloatArray) -> FloatArray:
        """Return the sum over the points of each cell."""
        return np.asarray(np.bincount(cell_of_point, values, cell_count), np.float64)

    with np.errstate(divide="ignore", invalid="ignore"):
        count = np.bincount(cell_of_point, minlength=cell_count)
        weights = sums(weight)
        mean = sums(weight * height) / weights
        squares = sums(weight * np.square(height - mean[cell_of_point]))
        variance_of_points = count / weights
        variance_of_mean = squares / weights / count
        common_variance = sums(weight * (ratio * np.maximum(total - random, 0.0))) / weights
        sigma = np.sqrt(variance_of_points + variance_of_mean + common_variance)
    shape = (grid.rows, grid.columns)
    return ElevationModel(
        height_m=mean.astype(F).reshape(shape),
        sigma_m=sigma.astype(F).reshape(shape),
        count=count.astype(np.int32).reshape(shape),
        grid=grid,
    )


def _height_variance_ratio(
    xyz: FloatArray32, pair: NDArray[np.uint8], poses_lm_left: Sequence[Transform] | None
) -> FloatArray:
    """Return the variance of the height of each point `(N,)` over its variance along the ray.

    An error along a ray with the unit vector `(x, y, z)` changes the height by z times the error. The horizontal part
    of the error displaces the point, and displaced ground is higher by the slope: about `TYPICAL_SLOPE` times the
    error. The ratio is `z^2 + TYPICAL_SLOPE^2`. Without poses, z is 1, the largest value.
    """
    if poses_lm_left is None:
        return np.full(len(xyz), 1.0 + TYPICAL_SLOPE**2)
    x_squared, y_squared, z_squared = np.square(rays_from_cameras(xyz, pair, poses_lm_left)).T
    return np.asarray(z_squared / (x_squared + y_squared + z_squared) + TYPICAL_SLOPE**2)
