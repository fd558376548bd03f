"""A digital elevation model: height, its standard deviation and the number of points of square cells in LM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform

MAX_CELLS = 2_500_000  #: Largest number of cells: a grid takes up to 120 bytes per cell while it is made, 300 MB.
TYPICAL_SLOPE = 0.1  #: Typical slope of ground: height error per horizontal displacement of a point.


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

    first: tuple[int, int]  #: Number of the first cell along x and along y, counted from the cell at the origin of LM.
    rows: int  #: Cells along y.
    columns: int  #: Cells along x.
    cell_m: float  #: Side of a cell.

    @property
    def origin_m(self) -> tuple[float, float]:
        """The smallest x and y of cell (0, 0)."""
        return self.first[0] * self.cell_m, self.first[1] * self.cell_m

    @classmethod
    def over(cls, xyz: NDArray[np.float32], cell_m: float, within: Square | None = None) -> CellGrid:
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
            raise MappingError("the cloud has points that are not finite: leave them out")
        first = np.floor(low / cell_m)
        columns, rows = np.floor(high / cell_m) - first + 1
        if rows * columns > MAX_CELLS:
            x, y = high - low
            raise MappingError(
                f"cells of {cell_m} m over {x:.4g} x {y:.4g} m are {rows * columns / 1e6:.3g} million: "
                f"{MAX_CELLS / 1e6} million are the limit; take cells of {1.05 * _smallest_cell(x, y):.2g} m or more"
            )
        return cls((int(first[0]), int(first[1])), int(rows), int(columns), cell_m)

    def cell_of(self, xyz: NDArray[np.float32]) -> NDArray[np.int32]:
        """Return the cell `(N,)` of each point, row times columns plus column; -1 outside the grid."""
        cell = np.zeros(len(xyz), np.int32)
        inside = np.ones(len(xyz), np.bool_)
        for axis, count, step in ((0, self.columns, 1), (1, self.rows, self.columns)):
            number = np.floor(xyz[:, axis].astype(np.float64) / self.cell_m) - self.first[axis]
            inside &= (number >= 0.0) & (number < count)
            cell += np.where(inside, number * step, 0.0).astype(np.int32)
        cell[~inside] = -1
        return cell


def _smallest_cell(x_m: float, y_m: float) -> float:
    """Return the smallest cell size of which a rectangle has at most `MAX_CELLS`.

    Cells of size c cover it with at most `(x / c + 2) (y / c + 2)` cells, a quadratic equation in c.
    """
    spare = MAX_CELLS - 4
    return float((x_m + y_m + np.hypot(x_m + y_m, np.sqrt(spare * x_m * y_m))) / spare)


@dataclass(frozen=True, slots=True, eq=False)
class ElevationModel:
    """Heights over a grid whose rows are along y and columns along x of LM."""

    height_m: NDArray[np.float32]  #: `(R, C)` float32, z of LM; NaN in cells without a point.
    sigma_m: NDArray[np.float32]  #: `(R, C)` float32, standard deviation of the height; NaN in cells without a point.
    count: NDArray[np.int32]  #: `(R, C)` int32, points in the cell.
    origin_m: tuple[float, float]  #: The smallest x and y of cell (0, 0).
    cell_m: float  #: Side of a cell.


def elevation_of_cells(
    cloud: PointCloud,
    T_lm_left: Sequence[Transform] | None,
    grid: CellGrid,
    cell: NDArray[np.int32],
    random_sigma: NDArray[np.float32] | None = None,
) -> ElevationModel:
    """Return the elevation model of a cloud over a grid.

    An error `e` of a point along its ray is an error of its height by the ray's z component times `e`, and by the rise
    of the ground over the horizontal displacement. Heights of a cell are averaged by the inverse of that variance.

    The variance of a cell has three parts. The first is that of its points, because the errors of neighbouring points
    are correlated. The second is that of the mean over heights that differ within the cell. The third is the part of
    the points' sigma beyond its random part, which all points share and averaging does not reduce.
    """
    inside = np.flatnonzero(cell >= 0)
    if not len(inside):
        raise MappingError("the cloud has no points on the grid: raise terrain.range_m")
    cell_of_point = cell[inside].astype(np.intp)
    xyz = cloud.xyz.take(inside, axis=0)  # faster than indexing by rows
    height = xyz[:, 2].astype(np.float64)
    total = np.square(cloud.sigma[inside], dtype=np.float64)
    random = total if random_sigma is None else np.square(random_sigma[inside], dtype=np.float64)
    height_fraction = _height_fraction(xyz, cloud.pair[inside], T_lm_left)
    cell_count = grid.rows * grid.columns

    def sums(values: FloatArray) -> FloatArray:
        """Return the sum over the points of each cell."""
        return np.asarray(np.bincount(cell_of_point, values, cell_count), np.float64)

    weight = 1.0 / (height_fraction * random)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = np.bincount(cell_of_point, minlength=cell_count)
        weights = sums(weight)
        mean = sums(weight * height) / weights
        spread = sums(np.square(height - mean[cell_of_point]) / (height_fraction * random))
        common = sums(weight * (height_fraction * np.maximum(total - random, 0.0)))
        variance = points / weights + spread / weights / points + common / weights
    shape = (grid.rows, grid.columns)
    return ElevationModel(
        mean.astype(np.float32).reshape(shape),
        np.sqrt(variance).astype(np.float32).reshape(shape),
        points.astype(np.int32).reshape(shape),
        grid.origin_m,
        grid.cell_m,
    )


def _height_fraction(
    xyz: NDArray[np.float32], pair: NDArray[np.uint8], T_lm_left: Sequence[Transform] | None
) -> FloatArray:
    """Return the variance of the height of each point `(N,)` over its variance along the ray; 1 without poses."""
    if T_lm_left is None:
        return np.full(len(xyz), 1.0 + TYPICAL_SLOPE**2)
    centres = np.stack([pose.translation for pose in T_lm_left])
    x_squared, y_squared, z_squared = np.square(xyz - centres.take(pair, axis=0)).T
    return np.asarray(z_squared / (x_squared + y_squared + z_squared) + TYPICAL_SLOPE**2)


def point_covariances(cloud: PointCloud, T_lm_left: Sequence[Transform], focal_px: float) -> NDArray[np.float32]:
    """Return the covariance of each point in LM `(N, 3, 3)`, square metres.

    Along the ray it is the point's variance. Across the ray a point represents its pixel: a uniform distribution over a
    square of side `Z / f`, whose variance is `(Z / f)^2 / 12`. Poses are in the order of the points' `pair`.
    """
    axes = np.stack([pose.rotation[:, 2] for pose in T_lm_left])[cloud.pair]
    ray = cloud.xyz - np.stack([pose.translation for pose in T_lm_left])[cloud.pair]
    depth = np.einsum("ij,ij->i", ray, axes)
    ray /= np.sqrt(np.einsum("ij,ij->i", ray, ray))[:, None]
    across = np.square(depth / focal_px) / 12.0
    along = np.square(cloud.sigma.astype(np.float64))
    outer = np.einsum("n,ni,nj->nij", along - across, ray, ray)
    outer[:, [0, 1, 2], [0, 1, 2]] += across[:, None]
    return np.asarray(outer, np.float32)
