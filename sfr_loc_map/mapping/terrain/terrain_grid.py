"""The terrain grid: height, slope, roughness, step and hazard of square cells in LM.

Slope and roughness describe the plane fitted to the ground under the rover, as in Goldberg, Maimone and Matthies,
"Stereo vision and rover navigation software for planetary exploration" (IEEE Aerospace Conference 2002). The hazard
combines the three criteria by their ratio to the rover's limits, as in Chilian and Hirschmueller, "Stereo camera based
navigation of mobile robots on rough terrain" (IROS 2009); here, the hazard is the largest ratio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.configuration.parameters import checked
from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import F, FloatArray32, IntArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.cloud_checks import check_poses
from sfr_loc_map.mapping.config import TerrainConfig
from sfr_loc_map.mapping.terrain.cells import CellGrid, Square
from sfr_loc_map.mapping.terrain.elevation import ElevationModel, elevation_model
from sfr_loc_map.mapping.terrain.planes import fit_planes
from sfr_loc_map.mapping.terrain.steps import steps_of_cells

STEP_RADIUS_M = 0.25
"""Radius within which a difference of heights is a step, metres. If cells are larger than the radius, the step of a
cell with a plane is the height difference within the cell, without the slope of the plane."""
MIN_RADIUS_CELLS = 1.5  #: Minimum radius of the disc to which a plane is fitted, cells: a cell and its neighbours.
MAX_FOOTPRINT_CELLS = 100
"""Maximum radius of the footprint, cells. A plane is then fitted to at most 31 400 cells around each cell."""
ROUNDING = 1e-9  #: Added to a squared radius, in cells, so that cells on the circle are inside despite rounding.
HAZARD = 100  #: Value of a cell that is a hazard, as in nav_msgs/OccupancyGrid.
UNKNOWN = -1  #: Value of a cell that is unknown, as in nav_msgs/OccupancyGrid.


class Discs(NamedTuple):
    """Discs of cells around a cell: rows and columns relative to the cell `(K, 2)` each."""

    #: Cells to which a plane is fitted: the footprint, or the cells within `MIN_RADIUS_CELLS` if this radius is larger.
    plane_disc: IntArray
    step_disc: IntArray  #: Cells within `STEP_RADIUS_M`, whose heights are compared relative to the plane.
    footprint: IntArray  #: Cells within the rover's footprint, in which a step is a hazard.


@dataclass(frozen=True, slots=True, eq=False)
class TerrainGrid:
    """The ground as a rover's planner uses it, over a grid whose rows are along y and columns along x of LM."""

    elevation: ElevationModel  #: Heights, their sigma, points of each cell, position and size of the cells.
    #: `(R, C)` float32, angle of the plane fitted to the heights within the rover's footprint, or within
    #: `MIN_RADIUS_CELLS` if this is larger (`Discs.plane_disc`).
    slope_rad: FloatArray32
    #: `(R, C)` float32, root of the mean squared difference of these heights from the plane.
    roughness_m: FloatArray32
    #: `(R, C)` float32, largest difference, relative to that plane, between the high and the low heights of the cells
    #: within `STEP_RADIUS_M`. Without a plane, largest height difference between the cell and a cell of
    #: `Discs.plane_disc`, reduced by the rise of the steepest passable slope between both cells.
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

    The pair index of a point is the index of its left camera's pose. Without poses, points at all ranges are used and
    the sigma of heights is overestimated. `random_sigma` `(N,)`, metres, is the part of sigma that differs from point
    to point; None if the complete sigma differs from point to point.

    The computation has four stages: heights of the cells (`elevation`), planes fitted to these heights (`planes`:
    slope, roughness), steps relative to these planes (`steps`), and hazards from the ratios of slope, roughness and
    step to the rover's limits.

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
    model, cell_of_point = _heights(cloud, config, poses, random_sigma)
    planes = fit_planes(model.height_m.astype(np.float64), discs.plane_disc, config.cell_m)
    slope_rad = np.arctan(np.hypot(planes.slope_x, planes.slope_y)).astype(F)
    roughness_m = planes.residual_m.astype(F)
    max_rise = float(np.tan(np.radians(config.max_slope_deg)))
    step_m = steps_of_cells(
        cloud.xyz,
        cell_of_point,
        model,
        planes,
        step_disc=discs.step_disc,
        plane_disc=discs.plane_disc,
        max_rise=max_rise,
    )
    hazard = _hazards(slope_rad, roughness_m, step_m, discs.footprint, config)
    return TerrainGrid(model, slope_rad, roughness_m, step_m, hazard)


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
        plane_disc=_disc(max(footprint_cells, MIN_RADIUS_CELLS)),
        step_disc=_disc(STEP_RADIUS_M / config.cell_m),
        footprint=_disc(footprint_cells),
    )


def _disc(radius_cells: float) -> IntArray:
    """Return the cells whose centres are within a radius: rows and columns relative to the centre `(K, 2)`."""
    squared_radius = radius_cells**2 + ROUNDING
    reach = int(np.sqrt(squared_radius))
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    inside = rows**2 + columns**2 <= squared_radius
    return np.column_stack((rows[inside], columns[inside])).astype(np.int64)


def _heights(
    cloud: PointCloud, config: TerrainConfig, poses: Sequence[Transform] | None, random_sigma: FloatArray32 | None
) -> tuple[ElevationModel, NDArray[np.int32]]:
    """Return the heights of the cells, and the cell `(N,)` of each point, -1 beyond the range of the cameras."""
    if poses is None:
        cells = CellGrid.over(cloud.xyz, config.cell_m)
        cell_of_point = cells.cell_of(cloud.xyz)
    else:
        x_m, y_m = np.mean([pose.translation[:2] for pose in poses], axis=0).tolist()
        square = Square(x_m, y_m, config.range_m)
        cells = CellGrid.over(cloud.xyz, config.cell_m, square)
        cell_of_point = np.where(square.contains(cloud.xyz), cells.cell_of(cloud.xyz), np.int32(-1))
    model = elevation_model(cloud, cells, cell_of_point, poses, random_sigma)
    return model, cell_of_point


def _hazards(
    slope_rad: FloatArray32, roughness_m: FloatArray32, step_m: FloatArray32, footprint: IntArray, config: TerrainConfig
) -> NDArray[np.int8]:
    """Return the hazard of each cell `(R, C)`: 100 for a hazard, otherwise 0 to 99, -1 where unknown.

    A cell is a hazard if a criterion reaches its limit for a rover whose centre is at this cell. A step counts anywhere
    in the footprint `(K, 2)`, even if other cells of the footprint are unknown. Otherwise the value is the largest
    ratio to a limit in percent. Slope, roughness and step are NaN where unknown.
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
