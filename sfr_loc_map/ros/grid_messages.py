"""Convert elevation and hazard grids to messages and back."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from nav_msgs.msg import MapMetaData, OccupancyGrid
from sensor_msgs.msg import PointCloud2

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.ros.point_messages import float_points_msg, floats_of

if TYPE_CHECKING:  # nodes without kernels do not import numba
    from sfr_loc_map.mapping.terrain.terrain_grid import TerrainGrid


ELEVATION_FIELDS = ("x", "y", "z", "sigma", "slope", "roughness", "step", "count")
"""Float32 fields of a cell: centre, height and sigma, m; slope, rad; roughness and step, m; number of points."""


def elevation_msg(grid: TerrainGrid, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a grid as an organised cloud: one point per cell, rows along y, columns along x, NaN for unknown."""
    (rows, columns), (x0, y0), cell_m = grid.hazard.shape, grid.elevation.origin_m, grid.elevation.cell_m
    cells = np.empty((rows, columns, len(ELEVATION_FIELDS)), np.float32)
    cells[..., 0] = x0 + (np.arange(columns) + 0.5) * cell_m
    cells[..., 1] = (y0 + (np.arange(rows) + 0.5) * cell_m)[:, None]
    model = grid.elevation
    layers = (model.height_m, model.sigma_m, grid.slope_rad, grid.roughness_m, grid.step_m, model.count)
    for index, layer in enumerate(layers, 2):
        cells[..., index] = layer
    return float_points_msg(cells, ELEVATION_FIELDS, header_msg(stamp_ns, frame_id))


def elevation_from_msg(message: PointCloud2) -> FloatArray32:
    """Return the cells `(R, C, 8)` of a message of `elevation_msg`, in the order of `ELEVATION_FIELDS`."""
    check_image_size(int(message.width), int(message.height), "the elevation grid")
    cells = floats_of(message, ELEVATION_FIELDS)
    if not np.isfinite(cells[..., :2]).all():
        raise InputError("elevation has cells without a position: finite x and y are required")
    return cells


def hazard_msg(grid: TerrainGrid, stamp_ns: int, frame_id: str) -> OccupancyGrid:
    """Return the hazard of the cells: 100 for a hazard, 0 to 99 for traversable cells, -1 for unknown."""
    (rows, columns), (x0, y0) = grid.hazard.shape, grid.elevation.origin_m
    header = header_msg(stamp_ns, frame_id)
    origin = Pose(position=Point(x=float(x0), y=float(y0), z=0.0), orientation=Quaternion(w=1.0))
    resolution = float(np.float32(grid.elevation.cell_m))
    info = MapMetaData(map_load_time=header.stamp, resolution=resolution, width=columns, height=rows, origin=origin)
    return OccupancyGrid(header=header, info=info, data=array("b", grid.hazard.tobytes()))


def hazard_from_msg(message: OccupancyGrid) -> FloatArray32:
    """Return the hazard `(R, C)` from 0 to 100, NaN for unknown cells."""
    rows, columns = int(message.info.height), int(message.info.width)
    data = np.frombuffer(message.data, np.int8)
    if len(data) != rows * columns:
        raise InputError(f"hazard has {len(data)} values: one for each of {columns} x {rows} cells is required")
    return np.where(data < 0, np.nan, data).astype(np.float32).reshape(rows, columns)
