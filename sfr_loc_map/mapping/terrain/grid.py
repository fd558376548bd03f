"""The elevation grid: height, slope, roughness, step and hazard of square cells in LM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.terrain.cells import CellGrid, outer_heights, sorted_by_cell
from sfr_loc_map.mapping.terrain.config import TerrainConfig
from sfr_loc_map.mapping.terrain.elevation import ElevationModel, elevation_of_cells
from sfr_loc_map.mapping.terrain.hazard import NEIGHBOURS, Window, fit_planes, hazards, steps


@dataclass(frozen=True, slots=True, eq=False)
class TerrainGrid:
    """What a rover needs to know of the ground, over a grid whose rows go along y and columns along x of LM.

    Attributes:
        elevation: Heights, their sigma, points of each cell, place and size of the cells. Cells with too few points
            have no height.
        slope_rad: `(R, C)` float32, angle of the plane fitted to the heights within the rover's footprint.
        roughness_m: `(R, C)` float32, root of the mean squared difference of these heights from the plane.
        step_m: `(R, C)` float32, largest difference of heights above that plane around the cell (`hazard.steps`).
        hazard: `(R, C)` int8, 100 where a criterion reaches its limit, 0 to 99 the largest share of a limit in
            percent, -1 where not known.
    """

    elevation: ElevationModel
    slope_rad: NDArray[np.float32]
    roughness_m: NDArray[np.float32]
    step_m: NDArray[np.float32]
    hazard: NDArray[np.int8]


def elevation_grid(
    cloud: PointCloud,
    config: TerrainConfig,
    T_lm_left: Sequence[Transform] | None = None,
    random_sigma: NDArray[np.float32] | None = None,
) -> TerrainGrid:
    """Return the terrain of a cloud, with z of LM upwards.

    Args:
        cloud: Points in LM.
        config: Size of the cells, the rover's footprint, what it can bear.
        T_lm_left: Pose of the left camera of each pair, in the order of the points' `pair`; None where they are not
            known: then all points count, whatever their range, and the sigma of heights is overstated.
        random_sigma: `(N,)`, metres, the part of sigma that differs from point to point; None for all of it.

    Raises:
        MappingError: If no point counts or there would be too many cells.
    """
    within: tuple[float, float, float] | None = None
    if T_lm_left:
        x, y = np.mean([pose.translation[:2] for pose in T_lm_left], axis=0).tolist()
        within = (x, y, config.range_m)
    grid = CellGrid.over(cloud.xyz, config.cell_m, within)
    cell = grid.cell_of(cloud.xyz)
    model = elevation_of_cells(cloud, T_lm_left or None, grid, cell, random_sigma)
    few = model.count < config.min_points
    height_m, sigma_m = model.height_m.copy(), model.sigma_m.copy()
    height_m[few] = sigma_m[few] = np.nan
    begin, heights = sorted_by_cell(
        cell, model.count.astype(np.int64).reshape(-1), np.ascontiguousarray(cloud.xyz[:, 2])
    )
    low, high = outer_heights(begin, heights, config.min_points).reshape(2, grid.rows, grid.columns)
    return _terrain(replace(model, height_m=height_m, sigma_m=sigma_m), low, high, config)


def _terrain(elevation: ElevationModel, low: FloatArray, high: FloatArray, config: TerrainConfig) -> TerrainGrid:
    cell_m = config.cell_m
    footprint = Window.disc(config.footprint_radius_m / cell_m)
    around = Window.disc(max(config.footprint_radius_m / cell_m, NEIGHBOURS))
    planes = fit_planes(elevation.height_m.astype(np.float64), around, cell_m)
    slope_rad = np.arctan(np.hypot(planes.slope_x, planes.slope_y)).astype(np.float32)
    step_m = steps(low, high, planes, Window.disc(config.step_radius_m / cell_m), cell_m).astype(np.float32)
    roughness_m = planes.residual_m.astype(np.float32)
    shares = np.maximum(slope_rad / np.radians(config.max_slope_deg), roughness_m / config.max_roughness_m)
    step_share = step_m / np.float32(config.max_step_m)
    hazard = hazards(shares.astype(np.float32), step_share, footprint)
    return TerrainGrid(elevation, slope_rad, roughness_m, step_m, hazard)


def warm_up() -> None:
    """Load or compile all kernels, so that no later call pays for it."""
    xyz = np.random.default_rng(0).uniform(0.0, 1.0, (1000, 3)).astype(np.float32)
    zeros = np.zeros(len(xyz), np.uint16)
    ones = np.ones(len(xyz), np.float32)
    cloud = PointCloud(xyz, ones, ones, zeros, zeros, zeros.astype(np.uint8))
    elevation_grid(cloud, TerrainConfig(), [Transform.identity()], ones)
