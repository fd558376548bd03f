"""Elevation and hazard grids as messages, and back."""

from __future__ import annotations

from array import array

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from nav_msgs.msg import MapMetaData, OccupancyGrid
from sensor_msgs.msg import PointCloud2

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.mapping.terrain.grid import TerrainGrid
from sfr_loc_map.nodes.messages.fields import float_points_msg, floats_of, header_msg, time_msg

ELEVATION_FIELDS = ("x", "y", "z", "sigma", "slope", "roughness", "step", "count")
"""Fields of a cell, all float32: its centre and height, metres; slope, radians; roughness and step, metres; points."""


def elevation_msg(grid: TerrainGrid, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a grid as an organised cloud: one point a cell, rows along y, columns along x, NaN where not known."""
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
    """Return the cells `(R, C, 8)` of a message as `elevation_msg` makes it, in the order of `ELEVATION_FIELDS`."""
    check_image_size(int(message.width), int(message.height), "the elevation grid")
    cells = floats_of(message, ELEVATION_FIELDS)
    if not np.isfinite(cells[..., :2]).all():
        raise InputError("elevation with cells of no place: x and y must be numbers everywhere")
    return cells


def hazard_msg(grid: TerrainGrid, stamp_ns: int, frame_id: str) -> OccupancyGrid:
    """Return the hazard of the cells: 100 for one, 0 to 99 for none, -1 where not known."""
    (rows, columns), (x0, y0) = grid.hazard.shape, grid.elevation.origin_m
    message = OccupancyGrid(header=header_msg(stamp_ns, frame_id))
    origin = Pose(position=Point(x=float(x0), y=float(y0), z=0.0), orientation=Quaternion(w=1.0))
    resolution = float(np.float32(grid.elevation.cell_m))
    message.info = MapMetaData(
        map_load_time=time_msg(stamp_ns), resolution=resolution, width=columns, height=rows, origin=origin
    )
    data = array("b")
    data.frombytes(np.ascontiguousarray(grid.hazard).reshape(-1).data)
    message.data = data
    return message


def hazard_from_msg(message: OccupancyGrid) -> FloatArray32:
    """Return the hazard `(R, C)` from 0 to 100, NaN where not known."""
    rows, columns = int(message.info.height), int(message.info.width)
    data = np.frombuffer(message.data, np.int8)
    if len(data) != rows * columns:
        raise InputError(f"hazard of {columns} x {rows} cells has {len(data)}")
    return np.where(data < 0, np.nan, data).astype(np.float32).reshape(rows, columns)
