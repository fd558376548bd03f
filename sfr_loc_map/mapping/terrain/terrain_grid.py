"""The terrain grid: height, slope, roughness, step and hazard of square cells in LM.

Slope and roughness describe the plane fitted to the ground under the rover, as in Goldberg, Maimone and Matthies,
"Stereo vision and rover navigation software for planetary exploration" (IEEE Aerospace Conference 2002). The hazard
combines the three criteria by their ratio to the rover's limits, as in Chilian and Hirschmueller, "Stereo camera based
navigation of mobile robots on rough terrain" (IROS 2009); here, the hazard is the largest ratio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.configuration.parameters import checked
from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import F, FloatArray, FloatArray32, IntArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.cloud_checks import check_poses
from sfr_loc_map.mapping.config import TerrainConfig
from sfr_loc_map.mapping.terrain.cells import CellGrid, Square
from sfr_loc_map.mapping.terrain.elevation import ElevationModel, elevation_model

MIN_POINTS = 3
"""Minimum number of points of a cell with a height: one point remains if the lowest and the highest are excluded."""
OUTLIER_FRACTION = 0.15
"""Fraction of a cell's points above its high height, and below its low height; at least one point of each cell. A rock
that covers a smaller fraction of a cell does not cause a step. Chosen by hand."""
STEP_RADIUS_M = 0.25
"""Radius within which a difference of heights is a step, metres. Chosen by hand: with a larger radius, the shape of the
ground would count as a step, and with a smaller radius, steps across several cells would be missed. The radius is part
of the definition of a step; the parameters `max_step_m` and `footprint_radius_m` describe the rover. If cells are
larger than the radius, a cell with a plane is not compared with other cells: its step is then the difference of the
heights within the cell, without the slope of the plane."""
MIN_KNOWN_FRACTION = 0.5
"""Minimum fraction of the cells with a height in the disc to which a plane is fitted. At the edge of the mapped ground,
half of the disc has heights, so that the plane is interpolated and not extrapolated. Chosen by hand."""
MIN_RADIUS_CELLS = 1.5  #: Minimum radius of the disc to which a plane is fitted, cells: a cell and its neighbours.
MAX_FOOTPRINT_CELLS = 100
"""Maximum radius of the footprint, cells. A plane is then fitted to at most 31 400 cells around each cell."""
MIN_DETERMINANT = 1e-6
"""Minimum determinant of the covariance of the cells' positions, in units of cell_m^4: 0 if all cells are on a line."""
ROUNDING = 1e-9  #: Added to a squared radius, in cells, so that cells on the circle are inside despite rounding.
HAZARD = 100  #: Value of a cell that is a hazard, as in nav_msgs/OccupancyGrid.
UNKNOWN = -1  #: Value of a cell that is unknown, as in nav_msgs/OccupancyGrid.


class Planes(NamedTuple):
    """Least-squares planes around each cell, `(R, C)` each; NaN where a plane is missing."""

    slope_x: FloatArray  #: Rise along x, metres per metre.
    slope_y: FloatArray  #: Rise along y, metres per metre.
    residual_m: FloatArray  #: Root mean squared difference of the heights from the plane.


class Discs(NamedTuple):
    """Discs of cells around a cell: rows and columns relative to the cell `(K, 2)` each."""

    plane: IntArray  #: Cells to which a plane is fitted: the footprint, or within `MIN_RADIUS_CELLS` if this is larger.
    step: IntArray  #: Cells within `STEP_RADIUS_M`, whose heights are compared relative to the plane.
    footprint: IntArray  #: Cells within the rover's footprint, in which a step is a hazard.


class CellHeights(NamedTuple):
    """Heights of the cells, and the cells of the points."""

    model: ElevationModel  #: Without the heights of cells with fewer than `MIN_POINTS` points.
    cell_of_point: NDArray[np.int32]  #: `(N,)`, cell of each point of the cloud; -1 outside the range.


class OuterHeights(NamedTuple):
    """Lowest and highest height of each cell without its outliers, `(R, C)` each; NaN with too few points."""

    low: FloatArray  #: Height above the fraction `OUTLIER_FRACTION` of the points, and above at least one point.
    high: FloatArray  #: Height below the same fraction of the points, and below at least one point.


@dataclass(frozen=True, slots=True, eq=False)
class TerrainGrid:
    """The ground as a rover's planner uses it, over a grid whose rows are along y and columns along x of LM."""

    #: Heights, their sigma, points of each cell, position and size of the cells. Unlike in the model of
    #: `elevation_model`, cells with fewer than `MIN_POINTS` points are NaN.
    elevation: ElevationModel
    #: `(R, C)` float32, angle of the plane fitted to the heights within the rover's footprint, or within
    #: `MIN_RADIUS_CELLS` if this is larger (`Discs.plane`).
    slope_rad: FloatArray32
    #: `(R, C)` float32, root of the mean squared difference of these heights from the plane.
    roughness_m: FloatArray32
    #: `(R, C)` float32, largest difference, relative to that plane, between the high and the low heights of the cells
    #: within `STEP_RADIUS_M`. Without a plane, largest height difference between the cell and a cell of `Discs.plane`,
    #: reduced by the rise of the steepest passable slope between both cells.
    step_m: FloatArray32
    #: `(R, C)` int8, 100 if a criterion reaches its limit, otherwise the largest ratio to a limit in percent; -1 where
    #: unknown.
    hazard: NDArray[np.int8]


def terrain_grid(
    cloud: PointCloud,
    config: TerrainConfig,
    poses_lm_left: Sequence[Transform] | None = None,
    random_sigma: FloatArray32 | None = None,
) -> TerrainGrid:
    """Return the terrain of a cloud in LM, with z upwards.

    The pair index of a point is that of its left camera's pose. Without poses, points at all ranges are used and the
    sigma of heights is overestimated. `random_sigma` `(N,)`, metres, is the part of sigma that differs from point to
    point; None if this is the whole sigma.

    The computation has four stages: heights of the cells, planes fitted to these heights (slope, roughness), steps
    relative to these planes, and hazards from the ratios of slope, roughness and step to the rover's limits.

    To add a criterion of hazard, add a layer to `TerrainGrid` and compute the ratio of the layer to its limit. If the
    criterion describes the ground under the complete footprint, as the slope does, include the ratio in `plane_ratio`
    of `_hazards`. If the criterion describes a single cell, as the step does, include the ratio in `step_ratio`, so
    that the cell counts anywhere in the footprint.

    Raises ConfigError if a value of the configuration is invalid. Raises MappingError if the cloud has no points within
    the range, a coordinate is not finite, a sigma is negative or not finite, the grid or the footprint would have too
    many cells, `random_sigma` has another shape than the sigma of the cloud or exceeds this sigma, or the pose of a
    point is missing.
    """
    config = checked(config)
    discs = _discs(config)
    poses = poses_lm_left or None  # an empty sequence means no poses
    check_poses(poses or ())
    heights = _heights(cloud, config, poses, random_sigma)
    planes = _fit_planes(heights.model.height_m.astype(np.float64), discs.plane, config.cell_m)
    slope_rad = np.arctan(np.hypot(planes.slope_x, planes.slope_y)).astype(F)
    roughness_m = planes.residual_m.astype(F)
    step_m = _steps(cloud.xyz, heights, planes, discs, config)
    hazard = _hazards(slope_rad, roughness_m, step_m, discs.footprint, config)
    return TerrainGrid(heights.model, slope_rad, roughness_m, step_m, hazard)


def _discs(config: TerrainConfig) -> Discs:
    """Return the discs of cells; MappingError if the footprint has too many cells."""
    footprint_cells = config.footprint_radius_m / config.cell_m
    if footprint_cells > MAX_FOOTPRINT_CELLS:
        raise MappingError(
            f"the footprint of {config.footprint_radius_m} m has a radius of {footprint_cells:.4g} cells of "
            f"{config.cell_m} m: at most {MAX_FOOTPRINT_CELLS} are allowed; use larger cells or a smaller footprint "
            "(terrain.cell_m, terrain.footprint_radius_m)"
        )
    return Discs(
        plane=_disc(max(footprint_cells, MIN_RADIUS_CELLS)),
        step=_disc(STEP_RADIUS_M / config.cell_m),
        footprint=_disc(footprint_cells),
    )


def _disc(radius_cells: float) -> IntArray:
    """Return the cells whose centres are within a radius: rows and columns relative to the centre `(K, 2)`."""
    squared_radius = radius_cells**2 + ROUNDING
    reach = int(np.sqrt(squared_radius))
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    inside = rows**2 + columns**2 <= squared_radius
    return np.column_stack((rows[inside], columns[inside])).astype(np.int64)


# ---- heights


def _heights(
    cloud: PointCloud, config: TerrainConfig, poses: Sequence[Transform] | None, random_sigma: FloatArray32 | None
) -> CellHeights:
    """Return the heights of the cells from the points within the configured range of the cameras."""
    square = None if poses is None else _mapped_square(poses, config)
    cells = CellGrid.over(cloud.xyz, config.cell_m, square)
    cell_of_point = cells.cell_of(cloud.xyz)
    if square is not None:
        cell_of_point = np.where(square.contains(cloud.xyz), cell_of_point, np.int32(-1))
    model = elevation_model(cloud, cells, cell_of_point, poses, random_sigma)
    return CellHeights(_without_sparse_cells(model), cell_of_point)


def _mapped_square(poses: Sequence[Transform], config: TerrainConfig) -> Square:
    """Return the square of the configured range around the mean position of the cameras."""
    x_m, y_m = np.mean([pose.translation[:2] for pose in poses], axis=0).tolist()
    return Square(x_m, y_m, config.range_m)


def _without_sparse_cells(model: ElevationModel) -> ElevationModel:
    """Return the model without the heights of cells with fewer than `MIN_POINTS` points."""
    is_sparse = model.count < MIN_POINTS
    height_m = np.where(is_sparse, F(np.nan), model.height_m)
    sigma_m = np.where(is_sparse, F(np.nan), model.sigma_m)
    return replace(model, height_m=height_m, sigma_m=sigma_m)


# ---- planes


@jit_rows
def _fit_planes(height: FloatArray, disc: IntArray, cell_m: float) -> Planes:
    """Return the least-squares planes of heights `(R, C)`, NaN where unknown, in a disc `(K, 2)` around each cell.

    A plane requires that `MIN_KNOWN_FRACTION` of the disc is known.
    """
    rows, columns = height.shape
    slope_x = np.full((rows, columns), np.nan)
    slope_y = np.full((rows, columns), np.nan)
    residual = np.full((rows, columns), np.nan)
    size = len(disc)
    for row in prange(rows):
        for column in range(columns):
            own = height[row, column]
            if np.isnan(own):
                continue
            # Sums of the coordinates and of their products, relative to the cell.
            n = 0.0
            x = 0.0
            y = 0.0
            z = 0.0
            xx = 0.0
            xy = 0.0
            yy = 0.0
            xz = 0.0
            yz = 0.0
            zz = 0.0
            for k in range(size):
                i = row + disc[k, 0]
                j = column + disc[k, 1]
                if 0 <= i < rows and 0 <= j < columns and not np.isnan(height[i, j]):
                    dx = disc[k, 1] * cell_m
                    dy = disc[k, 0] * cell_m
                    dz = height[i, j] - own
                    n += 1.0
                    x += dx
                    y += dy
                    z += dz
                    xx += dx * dx
                    xy += dx * dy
                    yy += dy * dy
                    xz += dx * dz
                    yz += dy * dz
                    zz += dz * dz
            if n < MIN_KNOWN_FRACTION * size:
                continue
            mean_x = x / n
            mean_y = y / n
            mean_z = z / n
            cov_xx = xx / n - mean_x * mean_x
            cov_xy = xy / n - mean_x * mean_y
            cov_yy = yy / n - mean_y * mean_y
            cov_xz = xz / n - mean_x * mean_z
            cov_yz = yz / n - mean_y * mean_z
            cov_zz = zz / n - mean_z * mean_z
            determinant = cov_xx * cov_yy - cov_xy * cov_xy
            if determinant > MIN_DETERMINANT * cell_m**4:
                a = (cov_yy * cov_xz - cov_xy * cov_yz) / determinant
                b = (cov_xx * cov_yz - cov_xy * cov_xz) / determinant
                slope_x[row, column] = a
                slope_y[row, column] = b
                residual[row, column] = np.sqrt(max(cov_zz - a * cov_xz - b * cov_yz, 0.0))
    return Planes(slope_x, slope_y, residual)


# ---- steps


def _steps(
    xyz: FloatArray32, heights: CellHeights, planes: Planes, discs: Discs, config: TerrainConfig
) -> FloatArray32:
    """Return the step of each cell `(R, C)`, metres, NaN without heights, from the points `(N, 3)` of the cloud."""
    cells = heights.model.cells
    count = heights.model.count
    level_height = _level_heights(xyz, heights.cell_of_point, cells, planes)
    return _largest_steps(
        raw=_outer_heights(heights.cell_of_point, xyz[:, 2].copy(), count),
        level=_outer_heights(heights.cell_of_point, level_height, count),
        planes=planes,
        discs=discs,
        max_rise=float(np.tan(np.radians(config.max_slope_deg))),
        cell_m=config.cell_m,
    ).astype(F)


def _level_heights(
    xyz: FloatArray32, cell_of_point: NDArray[np.int32], cells: CellGrid, planes: Planes
) -> FloatArray32:
    """Return the height of each point `(N,)`, moved along the plane of its cell to the centre of the cell.

    The slope within a cell is then no difference of heights. The height is unchanged in a cell without a plane, and for
    points outside the grid.
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
    raw: OuterHeights, level: OuterHeights, planes: Planes, discs: Discs, max_rise: float, cell_m: float
) -> FloatArray:
    """Return the step of each cell `(R, C)`, metres, NaN without heights.

    `raw` contains the outer heights of the points as they are, and `level` those of the points without the slope of
    their cell (`_level_heights`). `max_rise` is the rise of the steepest slope that is not a hazard, metres per metre.
    """
    rows, columns = raw.low.shape
    step = np.full((rows, columns), np.nan)
    for row in prange(rows):
        for column in range(columns):
            a = planes.slope_x[row, column]
            b = planes.slope_y[row, column]
            if np.isnan(a):
                step[row, column] = _step_beyond_slope(raw, row, column, discs.plane, max_rise * cell_m)
            else:
                step[row, column] = _step_from_plane(level, row, column, discs.step, a * cell_m, b * cell_m)
    return step


@jit_rows_inline
def _step_from_plane(level: OuterHeights, row: int, column: int, near: IntArray, rise_x: float, rise_y: float) -> float:
    """Return the largest high height minus the smallest low height of the cells around a cell, `near` `(K, 2)`.

    Both heights are relative to the plane of the cell, which rises by `rise_x` per column and by `rise_y` per row,
    metres. `level` does not contain the slope within a cell, so that a slope alone is not a step.
    """
    rows, columns = level.low.shape
    lowest = np.inf
    highest = -np.inf
    for k in range(len(near)):
        i = row + near[k, 0]
        j = column + near[k, 1]
        if 0 <= i < rows and 0 <= j < columns and not np.isnan(level.low[i, j]):
            plane = rise_x * near[k, 1] + rise_y * near[k, 0]
            lowest = min(lowest, level.low[i, j] - plane)
            highest = max(highest, level.high[i, j] - plane)
    return highest - lowest


@jit_rows_inline
def _step_beyond_slope(raw: OuterHeights, row: int, column: int, around: IntArray, max_rise: float) -> float:
    """Return the step of a cell without a plane; NaN without heights.

    The slope of the ground is unknown. Any slope that is not a hazard explains at most the height difference `max_rise`
    times the distance, in cells, between the cell and one of the cells `around` `(K, 2)`. The height difference within
    the cell is not reduced. The step is the largest rest of a difference, so that an isolated obstacle is a hazard even
    if its sides are not observed.
    """
    rows, columns = raw.low.shape
    low = raw.low[row, column]
    high = raw.high[row, column]
    step: float = high - low
    for k in range(len(around)):
        i = row + around[k, 0]
        j = column + around[k, 1]
        if 0 <= i < rows and 0 <= j < columns and not np.isnan(raw.low[i, j]):
            rise = max_rise * np.hypot(around[k, 0], around[k, 1])
            step = max(step, high - raw.low[i, j] - rise, raw.high[i, j] - low - rise)
    return step


# ---- hazards


def _hazards(
    slope_rad: FloatArray32, roughness_m: FloatArray32, step_m: FloatArray32, footprint: IntArray, config: TerrainConfig
) -> NDArray[np.int8]:
    """Return the hazard of each cell `(R, C)`: 100 for a hazard, otherwise 0 to 99, -1 where unknown.

    A cell is a hazard if a criterion reaches its limit under a rover at that cell. A step counts anywhere in the
    footprint `(K, 2)`, even if other cells of the footprint are unknown. Otherwise the value is the largest ratio to a
    limit in percent. Slope, roughness and step are NaN where unknown.
    """
    slope_ratio = slope_rad / np.radians(config.max_slope_deg)
    roughness_ratio = roughness_m / config.max_roughness_m
    plane_ratio = np.maximum(slope_ratio, roughness_ratio).astype(F)
    step_ratio = step_m / F(config.max_step_m)
    reach = int(np.abs(footprint).max())
    side = 2 * reach + 1
    disc_mask = np.zeros((side, side), np.uint8)
    disc_mask[tuple(footprint.T + reach)] = 1
    largest = np.fmax(cv2.dilate(np.nan_to_num(step_ratio, nan=0.0), disc_mask), plane_ratio)
    hazard = np.where(np.isnan(plane_ratio), UNKNOWN, np.minimum(largest, 1.0).astype(np.float64) * HAZARD)
    return np.where(largest >= 1.0, HAZARD, hazard).astype(np.int8)


def warm_up() -> None:
    """Load or compile all kernels, so that the first call is not slower than later calls."""
    xyz = np.random.default_rng(0).uniform(0.0, 1.0, (1000, 3)).astype(F)
    zeros = np.zeros(len(xyz), np.uint16)
    ones = np.ones(len(xyz), F)
    cloud = PointCloud(xyz, ones, ones, zeros, zeros, zeros.astype(np.uint8))
    terrain_grid(cloud, TerrainConfig(), [Transform.identity()], ones)
