"""Steps: differences of height between neighbouring cells that the slope of the ground does not explain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatArray, FloatArray32, IntArray
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.terrain.cells import CellGrid
from sfr_loc_map.mapping.terrain.elevation import MIN_POINTS, ElevationModel
from sfr_loc_map.mapping.terrain.planes import Planes

OUTLIER_FRACTION = 0.15
"""Fraction of a cell's points above the high height of the cell, and fraction below its low height; at least one point
each. A rock that covers a smaller fraction of a cell does not cause a step."""


class OuterHeights(NamedTuple):
    """Lowest and highest height of each cell without its outliers, `(R, C)` each; NaN with too few points."""

    low: FloatArray  #: Height above the fraction `OUTLIER_FRACTION` of the points, and above at least one point.
    high: FloatArray  #: Height below the same fraction of the points, and below at least one point.


def steps_of_cells(
    xyz: FloatArray32,
    cell_of_point: NDArray[np.int32],
    model: ElevationModel,
    planes: Planes,
    step_disc: IntArray,
    plane_disc: IntArray,
    max_rise: float,
) -> FloatArray32:
    """Return the step of each cell `(R, C)`, metres, NaN without heights, from the points `(N, 3)` of the cloud.

    The step of a cell with a plane is measured relative to this plane over the cells `step_disc` `(K, 2)`. The step of
    a cell without a plane is measured relative to the cells `plane_disc` `(K, 2)`. `max_rise` is the rise of the
    steepest slope that is not a hazard, metres per metre.
    """
    level_height = _level_heights(xyz, cell_of_point, model.cells, planes)
    return _largest_steps(
        raw=_outer_heights(cell_of_point, xyz[:, 2].copy(), model.count),
        level=_outer_heights(cell_of_point, level_height, model.count),
        planes=planes,
        step_disc=step_disc,
        plane_disc=plane_disc,
        max_rise=max_rise,
        cell_m=model.cell_m,
    ).astype(F)


def _level_heights(
    xyz: FloatArray32, cell_of_point: NDArray[np.int32], cells: CellGrid, planes: Planes
) -> FloatArray32:
    """Return the height of each point `(N,)`, moved along the plane of its cell to the centre of the cell.

    These heights differ within a cell only by what its slope does not explain. The height of a point is unchanged if
    the cell has no plane or the point is outside the grid.
    """
    cell = np.maximum(cell_of_point, 0)
    row, column = np.divmod(cell, cells.columns)
    x_offset = xyz[:, 0] - (cells.first_column + column + 0.5) * cells.cell_m
    y_offset = xyz[:, 1] - (cells.first_row + row + 0.5) * cells.cell_m
    rise = planes.slope_x.reshape(-1)[cell] * x_offset + planes.slope_y.reshape(-1)[cell] * y_offset
    is_known = np.isfinite(rise) & (cell_of_point >= 0)
    return np.asarray(xyz[:, 2] - np.where(is_known, rise, 0.0), F)


@jit_rows
def _outer_heights(cell_of_point: NDArray[np.int32], height: FloatArray32, count: NDArray[np.int32]) -> OuterHeights:
    """Return the quantiles `OUTLIER_FRACTION` and `1 - OUTLIER_FRACTION` of the heights of each cell, by nearest rank.

    The lowest and the highest point are always excluded. By nearest rank alone, no point of a cell with three or four
    points would be excluded.

    `cell_of_point` `(N,)` is the cell of each point, -1 outside, and `height` `(N,)` its height. `count` `(R, C)` is
    the number of points of each cell.
    """
    rows, columns = count.shape
    ends = np.cumsum(count.reshape(-1))
    # The heights are ordered by cell: each point is written before the earlier points of its cell.
    ordered = np.empty(ends[-1], F)
    firsts = ends.copy()
    for n in range(len(height)):
        cell = cell_of_point[n]
        if cell >= 0:
            firsts[cell] -= 1
            ordered[firsts[cell]] = height[n]
    low = np.full((rows, columns), np.nan)
    high = np.full((rows, columns), np.nan)
    for row in prange(rows):
        for column in range(columns):
            if count[row, column] < MIN_POINTS:
                continue
            cell = row * columns + column
            heights = ordered[firsts[cell] : ends[cell]]
            heights.sort()
            last = len(heights) - 1
            low_rank = int(np.rint(OUTLIER_FRACTION * last))
            high_rank = int(np.rint((1.0 - OUTLIER_FRACTION) * last))
            low[row, column] = heights[max(low_rank, 1)]
            high[row, column] = heights[min(high_rank, last - 1)]
    return OuterHeights(low, high)


@jit_rows
def _largest_steps(
    raw: OuterHeights,
    level: OuterHeights,
    planes: Planes,
    step_disc: IntArray,
    plane_disc: IntArray,
    max_rise: float,
    cell_m: float,
) -> FloatArray:
    """Return the step of each cell `(R, C)`, metres, NaN without heights; the arguments are as in `steps_of_cells`.

    `raw` contains the outer heights of the points. `level` contains the outer heights without the slopes of the cells
    (`_level_heights`).
    """
    rows, columns = raw.low.shape
    step = np.full((rows, columns), np.nan)
    for row in prange(rows):
        for column in range(columns):
            a = planes.slope_x[row, column]
            b = planes.slope_y[row, column]
            if np.isnan(a):
                step[row, column] = _step_beyond_slope(raw, row, column, plane_disc, max_rise * cell_m)
            else:
                step[row, column] = _step_from_plane(level, row, column, step_disc, a * cell_m, b * cell_m)
    return step


@jit_rows_inline
def _step_from_plane(
    level: OuterHeights, row: int, column: int, step_disc: IntArray, rise_x: float, rise_y: float
) -> float:
    """Return the largest high height minus the smallest low height of the cells around a cell, `step_disc` `(K, 2)`.

    Both heights are relative to the plane of the cell, which rises by `rise_x` per column and by `rise_y` per row,
    metres. `level` does not contain the slope within a cell, so that a slope alone is not a step.
    """
    rows, columns = level.low.shape
    lowest = np.inf
    highest = -np.inf
    for k in range(len(step_disc)):
        i = row + step_disc[k, 0]
        j = column + step_disc[k, 1]
        if 0 <= i < rows and 0 <= j < columns and not np.isnan(level.low[i, j]):
            plane = rise_x * step_disc[k, 1] + rise_y * step_disc[k, 0]
            lowest = min(lowest, level.low[i, j] - plane)
            highest = max(highest, level.high[i, j] - plane)
    return highest - lowest


@jit_rows_inline
def _step_beyond_slope(raw: OuterHeights, row: int, column: int, plane_disc: IntArray, rise_per_cell: float) -> float:
    """Return the step of a cell without a plane; NaN without heights.

    An isolated obstacle must be a hazard even if its sides are not observed. The high and the low height of the cell
    are therefore compared with those of the cells at the offsets `plane_disc` `(K, 2)`. The slope of the ground is
    unknown here. The steepest slope that is not a hazard rises by `rise_per_cell`, metres per cell, and this rise over
    the distance of two cells is subtracted from their height difference. The step is the largest of the remaining
    differences and of the height difference within the cell.
    """
    rows, columns = raw.low.shape
    low = raw.low[row, column]
    high = raw.high[row, column]
    step: float = high - low
    for k in range(len(plane_disc)):
        i = row + plane_disc[k, 0]
        j = column + plane_disc[k, 1]
        if 0 <= i < rows and 0 <= j < columns and not np.isnan(raw.low[i, j]):
            rise = rise_per_cell * np.hypot(plane_disc[k, 0], plane_disc[k, 1])
            step = max(step, high - raw.low[i, j] - rise, raw.high[i, j] - low - rise)
    return step
