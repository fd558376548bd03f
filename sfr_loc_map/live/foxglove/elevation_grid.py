"""The cloud that is shown as a grid from above, with one layer for each quantity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.live.updates import CloudSample

CELL_M = 0.1
MAX_CELLS = 512
"""Along each axis; beyond them the cells are larger."""
LAYERS = ("height", "sigma", "error", "count")


@dataclass(frozen=True, slots=True, eq=False)
class ElevationGrid:
    """Cells in LM, seen from above.

    Attributes:
        origin_m: Corner of cell (0, 0).
        cell_m: Side of a cell.
        layers: `(rows along y, columns along x, 4)` float32 in the order of `LAYERS`: means over the points of a cell,
            metres, and their number; NaN where there is none.
    """

    origin_m: tuple[float, float]
    cell_m: float
    layers: FloatArray32


def elevation_grid(cloud: CloudSample) -> ElevationGrid | None:
    """Return the grid of a cloud, None of an empty one."""
    points = cloud.points
    if not len(points):
        return None
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    cell_m = max(CELL_M, float((high - low).max()) / (MAX_CELLS - 1))
    columns, rows = (int(size) for size in np.floor((high - low) / cell_m) + 1)
    at = np.floor((points[:, :2] - low) / cell_m).astype(np.intp)
    cell = np.minimum(at[:, 1], rows - 1) * columns + np.minimum(at[:, 0], columns - 1)
    error = np.full(len(points), np.nan, np.float32) if cloud.error is None else cloud.error
    means = [_means(cell, values, rows * columns) for values in (points[:, 2], points[:, 3], error)]
    count = np.bincount(cell, minlength=rows * columns).astype(np.float64)
    layers = np.stack([*means, np.where(count > 0, count, np.nan)], axis=-1)
    return ElevationGrid((float(low[0]), float(low[1])), cell_m, layers.reshape(rows, columns, 4).astype(np.float32))


def _means(cell: NDArray[np.intp], values: FloatArray32, size: int) -> NDArray[np.float64]:
    """Return the mean of the values in each cell, NaN without."""
    known = np.isfinite(values)
    count = np.bincount(cell[known], minlength=size)
    total = np.bincount(cell[known], values[known].astype(np.float64), minlength=size)
    return np.asarray(np.divide(total, count, out=np.full(size, np.nan), where=count > 0))
