"""Slope, roughness, step and hazard of the cells of a grid.

Slope and roughness are those of the plane fitted to the ground under the rover, as in Goldberg, Maimone and Matthies,
"Stereo vision and rover navigation software for planetary exploration" (IEEE Aerospace Conference 2002); the three
criteria are joined by their ratio to what the rover can bear, as in Chilian and Hirschmueller, "Stereo camera based
navigation of mobile robots on rough terrain" (IROS 2009), here by the largest of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit_rows

KNOWN_SHARE = 0.5
"""Share of the cells of the footprint that must have a height for slope and roughness."""
NEIGHBOURS = 1.5
"""Least radius, in cells, of a window in which a plane is fitted: a cell and its eight neighbours."""
HAZARD, UNKNOWN = 100, -1


class Window(NamedTuple):
    """The cells of a disc around a cell.

    Attributes:
        rows: `(K,)` their rows, counted from that of the cell.
        columns: `(K,)` likewise.
    """

    rows: IntArray
    columns: IntArray

    @classmethod
    def disc(cls, radius_cells: float) -> Window:
        """Return the cells whose centres lie within a distance, in cells."""
        reach = int(radius_cells)
        rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        inside = rows**2 + columns**2 <= radius_cells**2 + 1e-9
        return cls(rows[inside].astype(np.int64), columns[inside].astype(np.int64))


class Planes(NamedTuple):
    """The plane around each cell, all `(R, C)`, NaN where there is none.

    Attributes:
        slope_x: Rise along x, metres a metre.
        slope_y: Rise along y.
        residual_m: Root of the mean squared difference of the heights from it.
    """

    slope_x: FloatArray
    slope_y: FloatArray
    residual_m: FloatArray


@jit_rows
def fit_planes(height: FloatArray, window: Window, cell_m: float) -> Planes:
    """Return the least-squares plane of the heights around each cell that has one.

    Args:
        height: `(R, C)` metres, NaN where not known.
        window: Cells that count; `KNOWN_SHARE` of them must have a height.
        cell_m: Side of a cell.
    """
    rows, columns = height.shape
    slope_x, slope_y = np.full((rows, columns), np.nan), np.full((rows, columns), np.nan)
    residual = np.full((rows, columns), np.nan)
    size = len(window.rows)
    for row in numba.prange(rows):
        for column in range(columns):
            own = height[row, column]
            if np.isnan(own):
                continue
            n, x, y, z = 0.0, 0.0, 0.0, 0.0
            xx, xy, yy, xz, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(size):
                i, j = row + window.rows[k], column + window.columns[k]
                if 0 <= i < rows and 0 <= j < columns and not np.isnan(height[i, j]):
                    dx, dy, dz = window.columns[k] * cell_m, window.rows[k] * cell_m, height[i, j] - own
                    n, x, y, z = n + 1.0, x + dx, y + dy, z + dz
                    xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
                    xz, yz, zz = xz + dx * dz, yz + dy * dz, zz + dz * dz
            if n < KNOWN_SHARE * size:
                continue
            x, y, z = x / n, y / n, z / n
            xx, xy, yy = xx / n - x * x, xy / n - x * y, yy / n - y * y
            xz, yz, zz = xz / n - x * z, yz / n - y * z, zz / n - z * z
            determinant = xx * yy - xy * xy
            if determinant > 1e-6 * cell_m**4:
                a, b = (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
                slope_x[row, column], slope_y[row, column] = a, b
                residual[row, column] = np.sqrt(max(zz - a * xz - b * yz, 0.0))
    return Planes(slope_x, slope_y, residual)


@jit_rows
def steps(low: FloatArray, high: FloatArray, planes: Planes, window: Window, cell_m: float) -> FloatArray:
    """Return the step of each cell `(R, C)`, metres, NaN where there is no plane.

    It is the largest high height less the smallest low height of the cells of a window (`cells.outer_heights`), all of
    them above the plane of the footprint: a slope alone is no step.

    Args:
        low: `(R, C)` low height of each cell, metres, NaN where not known.
        high: `(R, C)` high height.
        planes: Of the footprint around each cell.
        window: Cells that count.
        cell_m: Side of a cell.
    """
    rows, columns = low.shape
    step = np.full((rows, columns), np.nan)
    slope_x, slope_y = planes.slope_x, planes.slope_y
    for row in numba.prange(rows):
        for column in range(columns):
            a, b = slope_x[row, column], slope_y[row, column]
            if np.isnan(a):
                continue
            least, largest = np.inf, -np.inf
            for k in range(len(window.rows)):
                i, j = row + window.rows[k], column + window.columns[k]
                if 0 <= i < rows and 0 <= j < columns and not np.isnan(low[i, j]):
                    plane = (a * window.columns[k] + b * window.rows[k]) * cell_m
                    least, largest = min(least, low[i, j] - plane), max(largest, high[i, j] - plane)
            step[row, column] = largest - least
    return step


@jit_rows
def hazards(shares: NDArray[np.float32], step_share: NDArray[np.float32], footprint: Window) -> NDArray[np.int8]:
    """Return the hazard of each cell `(R, C)`: 100 for one, 0 to 99 for none, -1 where not known.

    A cell is a hazard where a criterion reaches its limit under a rover that stands there: a step does so anywhere in
    the footprint, also next to cells that are not known. Below that the value is the largest share of a limit.

    Args:
        shares: `(R, C)` larger one of slope and roughness over their limits, NaN where not known.
        step_share: `(R, C)` step over its limit, likewise.
        footprint: Cells under the rover.
    """
    rows, columns = shares.shape
    hazard = np.full((rows, columns), np.int8(UNKNOWN))
    for row in numba.prange(rows):
        for column in range(columns):
            largest = np.float32(0.0)
            for k in range(len(footprint.rows)):
                i, j = row + footprint.rows[k], column + footprint.columns[k]
                if 0 <= i < rows and 0 <= j < columns and step_share[i, j] > largest:
                    largest = step_share[i, j]
            own = shares[row, column]
            largest = max(largest, own)
            if largest >= 1.0:
                hazard[row, column] = HAZARD
            elif not np.isnan(own):
                hazard[row, column] = np.int8(largest * 100.0)
    return hazard
