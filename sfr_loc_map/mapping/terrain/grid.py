"""The elevation grid: height, slope, roughness, step and hazard of square cells in LM.

Slope and roughness are those of the plane fitted to the ground under the rover, as in Goldberg, Maimone and Matthies,
"Stereo vision and rover navigation software for planetary exploration" (IEEE Aerospace Conference 2002); the three
criteria are joined by their ratio to what the rover can bear, as in Chilian and Hirschmueller, "Stereo camera based
navigation of mobile robots on rough terrain" (IROS 2009), here by the largest of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.config import TerrainConfig
from sfr_loc_map.mapping.terrain.elevation import CellGrid, ElevationModel, elevation_of_cells

MIN_POINTS = 3
"""A cell with fewer points has no height: two may both be outliers, and say nothing of what differs within the cell."""
TAIL = 0.15
"""Share of the points of a cell that lie above its high height, and below its low one: outliers are among them."""
STEP_RADIUS_M = 0.25
"""A step is a difference of heights within this distance: more would count a slope of small rocks as one."""
KNOWN_SHARE = 0.5  #: Share of the cells of the footprint that must have a height for slope and roughness.
NEIGHBOURS = 1.5  #: Least radius, in cells, of a window in which a plane is fitted: a cell and its eight neighbours.
HAZARD, UNKNOWN = 100, -1


@dataclass(frozen=True, slots=True, eq=False)
class TerrainGrid:
    """What a rover needs to know of the ground, over a grid whose rows go along y and columns along x of LM."""

    #: Heights, their sigma, points of each cell, place and size of the cells. Cells with too few points have no
    #: height.
    elevation: ElevationModel
    #: `(R, C)` float32, angle of the plane fitted to the heights within the rover's footprint.
    slope_rad: NDArray[np.float32]
    #: `(R, C)` float32, root of the mean squared difference of these heights from the plane.
    roughness_m: NDArray[np.float32]
    #: `(R, C)` float32, largest difference of heights above that plane around the cell.
    step_m: NDArray[np.float32]
    #: `(R, C)` int8, 100 where a criterion reaches its limit, 0 to 99 the largest share of a limit in percent, -1
    #: where not known.
    hazard: NDArray[np.int8]


def elevation_grid(
    cloud: PointCloud,
    config: TerrainConfig,
    T_lm_left: Sequence[Transform] | None = None,
    random_sigma: NDArray[np.float32] | None = None,
) -> TerrainGrid:
    """Return the terrain of a cloud in LM, with z upwards; raises MappingError for no points or too many cells.

    Poses of the left cameras are in the order of the points' `pair`; without them all points count, whatever their
    range, and the sigma of heights is overstated. The random part of sigma `(N,)`, metres, differs from point to point;
    None is all of it.
    """
    within: tuple[float, float, float] | None = None
    if T_lm_left:
        x, y = np.mean([pose.translation[:2] for pose in T_lm_left], axis=0).tolist()
        within = (x, y, config.range_m)
    cell_m = config.cell_m
    grid = CellGrid.over(cloud.xyz, cell_m, within)
    cell = grid.cell_of(cloud.xyz)
    model = elevation_of_cells(cloud, T_lm_left or None, grid, cell, random_sigma)
    few = model.count < MIN_POINTS
    height_m, sigma_m = model.height_m.copy(), model.sigma_m.copy()
    height_m[few] = sigma_m[few] = np.nan
    low, high = outer_heights(cell, cloud.xyz[:, 2], model.count.reshape(-1)).reshape(2, grid.rows, grid.columns)
    around = disc(max(config.footprint_radius_m / cell_m, NEIGHBOURS))
    slope_x, slope_y, residual_m = fit_planes(height_m.astype(np.float64), around, cell_m)
    slope_rad = np.arctan(np.hypot(slope_x, slope_y)).astype(np.float32)
    roughness_m = residual_m.astype(np.float32)
    step_m = steps(low, high, slope_x, slope_y, disc(STEP_RADIUS_M / cell_m), cell_m).astype(np.float32)
    shares = np.maximum(slope_rad / np.radians(config.max_slope_deg), roughness_m / config.max_roughness_m)
    step_share = step_m / np.float32(config.max_step_m)
    hazard = hazards(shares.astype(np.float32), step_share, disc(config.footprint_radius_m / cell_m))
    return TerrainGrid(replace(model, height_m=height_m, sigma_m=sigma_m), slope_rad, roughness_m, step_m, hazard)


def warm_up() -> None:
    """Load or compile all kernels, so that no later call pays for it."""
    xyz = np.random.default_rng(0).uniform(0.0, 1.0, (1000, 3)).astype(np.float32)
    zeros = np.zeros(len(xyz), np.uint16)
    ones = np.ones(len(xyz), np.float32)
    cloud = PointCloud(xyz, ones, ones, zeros, zeros, zeros.astype(np.uint8))
    elevation_grid(cloud, TerrainConfig(), [Transform.identity()], ones)


def disc(radius_cells: float) -> IntArray:
    """Return the cells whose centres lie within a distance, in cells: rows and columns from the middle one `(K, 2)`."""
    reach = int(radius_cells)
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    inside = rows**2 + columns**2 <= radius_cells**2 + 1e-9
    return np.column_stack((rows[inside], columns[inside])).astype(np.int64)


def outer_heights(cell: NDArray[np.int32], height: NDArray[np.float32], count: NDArray[np.int32]) -> FloatArray:
    """Return a low and a high one of the heights of each cell `(2, cells)`, `TAIL` from either end, by nearest rank.

    Of each point `(N,)` the cell, or -1, and the height; a cell with fewer than `MIN_POINTS` points gives NaN.
    """
    # one integer of cell and height, in the order of both, is sorted many times as fast as by two keys
    inside = cell >= 0
    ordered = cell[inside].astype(np.int64)
    ordered <<= 32
    ordered += _in_order(height[inside].view(np.int32))
    ordered.sort()
    known = count >= MIN_POINTS
    below, last = (np.cumsum(count) - count)[known], count[known] - 1
    found = np.full((2, len(count)), np.nan)
    for which in range(2):
        rank = below + np.rint((TAIL + (1.0 - 2.0 * TAIL) * which) * last).astype(np.int64)
        found[which, known] = _in_order(ordered[rank].astype(np.int32)).view(np.float32)
    return found


def _in_order(bits: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return bits of float32 as integers in their order, and such integers as bits: negative ones run backwards."""
    return np.where(bits < 0, bits ^ np.int32(0x7FFFFFFF), bits)


@jit_rows
def fit_planes(height: FloatArray, window: IntArray, cell_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the least-squares plane of the heights around each cell, all `(R, C)`, NaN where there is none.

    They are its rise along x and along y, metres a metre, and the root of the mean squared difference from it, metres.

    Heights `(R, C)` are NaN where not known; `KNOWN_SHARE` of the window `(K, 2)` around a cell must be known.
    """
    rows, columns = height.shape
    slope_x, slope_y = np.full((rows, columns), np.nan), np.full((rows, columns), np.nan)
    residual = np.full((rows, columns), np.nan)
    size = len(window)
    for row in prange(rows):
        for column in range(columns):
            own = height[row, column]
            if np.isnan(own):
                continue
            n, x, y, z = 0.0, 0.0, 0.0, 0.0
            xx, xy, yy, xz, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(size):
                i, j = row + window[k, 0], column + window[k, 1]
                if 0 <= i < rows and 0 <= j < columns and not np.isnan(height[i, j]):
                    dx, dy, dz = window[k, 1] * cell_m, window[k, 0] * cell_m, height[i, j] - own
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
    return slope_x, slope_y, residual


@jit_rows
def steps(
    low: FloatArray, high: FloatArray, slope_x: FloatArray, slope_y: FloatArray, window: IntArray, cell_m: float
) -> FloatArray:
    """Return the step of each cell `(R, C)`, metres, NaN where there is no plane.

    It is the largest high height less the smallest low height of the cells of a window (`outer_heights`), all of them
    above the plane of the footprint: a slope alone is no step.
    """
    rows, columns = low.shape
    step = np.full((rows, columns), np.nan)
    for row in prange(rows):
        for column in range(columns):
            a, b = slope_x[row, column], slope_y[row, column]
            if np.isnan(a):
                continue
            least, largest = np.inf, -np.inf
            for k in range(len(window)):
                i, j = row + window[k, 0], column + window[k, 1]
                if 0 <= i < rows and 0 <= j < columns and not np.isnan(low[i, j]):
                    plane = (a * window[k, 1] + b * window[k, 0]) * cell_m
                    least, largest = min(least, low[i, j] - plane), max(largest, high[i, j] - plane)
            step[row, column] = largest - least
    return step


def hazards(shares: NDArray[np.float32], step_share: NDArray[np.float32], footprint: IntArray) -> NDArray[np.int8]:
    """Return the hazard of each cell `(R, C)`: 100 for one, 0 to 99 for none, -1 where not known.

    A cell is a hazard where a criterion reaches its limit under a rover that stands there: a step does so anywhere in
    the footprint, also next to cells that are not known. Below that the value is the largest share of a limit.

    Shares `(R, C)` of the limits are NaN where not known: the larger one of slope and roughness, and that of the step.
    """
    reach = int(np.abs(footprint).max())
    disc_mask = np.zeros((2 * reach + 1,) * 2, np.uint8)
    disc_mask[tuple(footprint.T + reach)] = 1
    largest = np.fmax(cv2.dilate(np.nan_to_num(step_share, nan=0.0), disc_mask), shares)
    hazard = np.where(np.isnan(shares), UNKNOWN, np.minimum(largest, 1.0).astype(np.float64) * HAZARD)
    return np.where(largest >= 1.0, HAZARD, hazard).astype(np.int8)
