"""A digital elevation model: height, its standard deviation and the number of points of square cells in LM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform

MAX_CELLS = 2_500_000  #: A grid takes up to 120 bytes a cell while it is made: 300 MB.
SLOPE = 0.1
"""Typical slope of ground: a point displaced along its ray lies over ground that is as much higher or lower."""


@dataclass(frozen=True, slots=True)
class CellGrid:
    """A grid of square cells whose sides lie at multiples of their length in x and y of LM.

    So grids of one cell size have the same cells, whatever cloud they were made of.
    """

    first: tuple[int, int]  # number of the first cell along x and along y, counted from that at the origin of LM
    rows: int  # along y
    columns: int  # along x
    cell_m: float  # side of a cell

    @property
    def origin_m(self) -> tuple[float, float]:
        """The x and y of the outer corner of cell (0, 0), which has the least x and y."""
        return self.first[0] * self.cell_m, self.first[1] * self.cell_m

    @classmethod
    def over(
        cls, xyz: NDArray[np.float32], cell_m: float, within: tuple[float, float, float] | None = None
    ) -> CellGrid:
        """Return a grid that has a cell for each point `(N, 3)` in LM.

        Points outside of a square, x, y and half its side, do not count. Raises MappingError if the cell is not
        positive, no point counts, or there would be too many cells.
        """
        if not cell_m > 0.0:
            raise MappingError(f"cells of {cell_m} m: the side must be more than 0")
        if len(xyz) == 0:
            raise MappingError("the cloud has no points: an elevation model needs some")
        low, high = (np.array([float(side(xyz[:, axis])) for axis in (0, 1)]) for side in (np.min, np.max))
        if within is not None:
            centre, reach = np.array(within[:2]), within[2]
            low, high = np.maximum(low, centre - reach), np.minimum(high, centre + reach)
            if (low > high).any():
                raise MappingError(f"the cloud has no points within {reach} m of the cameras: raise terrain.range_m")
        if not (np.isfinite((low, high)).all() and np.isfinite(xyz[:, 2]).all()):
            raise MappingError("the cloud has points that are not finite: leave them out")
        first, last = np.floor(low / cell_m), np.floor(high / cell_m)
        columns, rows = last - first + 1
        if rows * columns > MAX_CELLS:
            x, y = high - low  # of which a cell c makes at most x / c + 2 by y / c + 2 cells
            fits = (x + y + np.hypot(x + y, np.sqrt((MAX_CELLS - 4) * x * y))) / (MAX_CELLS - 4)
            raise MappingError(
                f"cells of {cell_m} m over {x:.4g} x {y:.4g} m are {rows * columns / 1e6:.3g} million: "
                f"{MAX_CELLS / 1e6} million are the limit; take cells of {1.05 * fits:.2g} m or more"
            )
        return cls((int(first[0]), int(first[1])), int(rows), int(columns), cell_m)

    def cell_of(self, xyz: NDArray[np.float32]) -> NDArray[np.int32]:
        """Return the cell `(N,)` of each point, row times columns plus column; -1 where it lies outside."""
        cell, inside = np.zeros(len(xyz), np.int32), np.ones(len(xyz), np.bool_)
        for axis, count, step in ((0, self.columns, 1), (1, self.rows, self.columns)):
            number = np.floor(xyz[:, axis].astype(np.float64) / self.cell_m) - self.first[axis]
            inside &= (number >= 0.0) & (number < count)
            cell += np.where(inside, number * step, 0.0).astype(np.int32)
        cell[~inside] = -1
        return cell


@dataclass(frozen=True, slots=True, eq=False)
class ElevationModel:
    """Heights over a grid whose rows go along y and columns along x of LM."""

    height_m: NDArray[np.float32]  #: `(R, C)` float32, z of LM, NaN in cells without a point.
    sigma_m: NDArray[np.float32]  #: `(R, C)` float32, standard deviation of the height, NaN likewise.
    count: NDArray[np.int32]  #: `(R, C)` int32, points in the cell.
    origin_m: tuple[float, float]  #: x and y of the outer corner of cell (0, 0), which has the least x and y.
    cell_m: float  #: Side of a cell.


def elevation_of_cells(
    cloud: PointCloud,
    T_lm_left: Sequence[Transform] | None,
    grid: CellGrid,
    cell: NDArray[np.int32],
    random_sigma: NDArray[np.float32] | None = None,
) -> ElevationModel:
    """Return the elevation model of a cloud over a grid.

    An error `e` of a point along its ray is an error of its height of the ray's z component times `e`, and of what the
    ground rises over the horizontal displacement. Heights of a cell are averaged by the inverse of that variance.
    Errors of neighbouring points are correlated, so the variance of a cell's mean is that of its points; to it comes
    that of the mean over heights that differ within the cell, and what the points' sigma has beyond its random part: an
    error that they share has no say in their weights, and no mean removes it.
    """
    inside = np.flatnonzero(cell >= 0)
    if not len(inside):
        raise MappingError("the cloud has no points on the grid: raise terrain.range_m")
    at, xyz = cell[inside].astype(np.intp), cloud.xyz.take(inside, axis=0)  # faster than an index of rows
    height, total = xyz[:, 2].astype(np.float64), np.square(cloud.sigma[inside], dtype=np.float64)
    random = total if random_sigma is None else np.square(random_sigma[inside], dtype=np.float64)
    share = np.ones(len(inside))  # of a point's variance along its ray: that of its height
    if T_lm_left is not None:
        centres = np.stack([pose.translation for pose in T_lm_left])
        x, y, z = np.square(xyz - centres.take(cloud.pair[inside], axis=0)).T
        share = z / (x + y + z)
    share = share + SLOPE**2

    def sums(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(at, values, grid.rows * grid.columns), np.float64)

    weight = 1.0 / (share * random)
    with np.errstate(divide="ignore", invalid="ignore"):
        points, weights = np.bincount(at, minlength=grid.rows * grid.columns), sums(weight)
        mean = sums(weight * height) / weights
        spread = sums(np.square(height - mean[at]) / (share * random))
        common = sums(weight * (share * np.maximum(total - random, 0.0)))
        variance = points / weights + spread / weights / points + common / weights
    shape = (grid.rows, grid.columns)
    return ElevationModel(
        mean.astype(np.float32).reshape(shape),
        np.sqrt(variance).astype(np.float32).reshape(shape),
        points.astype(np.int32).reshape(shape),
        grid.origin_m,
        grid.cell_m,
    )


def point_covariances(cloud: PointCloud, T_lm_left: Sequence[Transform], focal_px: float) -> NDArray[np.float32]:
    """Return the covariance of each point in LM `(N, 3, 3)`, square metres.

    Along the ray it is the point's variance. Across, a point represents its whole pixel: a uniform distribution over a
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
