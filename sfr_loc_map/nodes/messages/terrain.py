"""Elevation and hazard grids as messages."""

from __future__ import annotations

from array import array

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from nav_msgs.msg import MapMetaData, OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from sfr_loc_map.mapping.terrain.grid import TerrainGrid
from sfr_loc_map.nodes.messages.fields import byte_array, header_msg, time_msg

ELEVATION_FIELDS = ("x", "y", "z", "sigma", "slope", "roughness", "step", "count")
"""Fields of a cell, all float32: its centre and height, metres; slope, radians; roughness and step, metres; points."""


def elevation_msg(grid: TerrainGrid, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a grid as an organised cloud: one point a cell, rows along y, columns along x, NaN where not known."""
    rows, columns = grid.hazard.shape
    layers = np.empty((rows, columns, len(ELEVATION_FIELDS)), np.float32)
    x0, y0 = grid.elevation.origin_m
    cell_m = grid.elevation.cell_m
    layers[..., 0] = x0 + (np.arange(columns) + 0.5) * cell_m
    layers[..., 1] = (y0 + (np.arange(rows) + 0.5) * cell_m)[:, None]
    values: tuple[NDArray[np.float32] | NDArray[np.int32], ...] = (
        grid.elevation.height_m,
        grid.elevation.sigma_m,
        grid.slope_rad,
        grid.roughness_m,
        grid.step_m,
        grid.elevation.count,
    )
    for index, layer in enumerate(values, 2):
        layers[..., index] = layer
    step = 4 * len(ELEVATION_FIELDS)
    message = PointCloud2(header=header_msg(stamp_ns, frame_id), height=rows, width=columns)
    message.fields = [
        PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
        for index, name in enumerate(ELEVATION_FIELDS)
    ]
    message.point_step, message.row_step, message.is_dense = step, step * columns, False
    message.data = byte_array(layers.astype("<f4", copy=False))
    return message


def hazard_msg(grid: TerrainGrid, stamp_ns: int, frame_id: str) -> OccupancyGrid:
    """Return the hazard of the cells: 100 for one, 0 to 99 for none, -1 where not known."""
    rows, columns = grid.hazard.shape
    message = OccupancyGrid(header=header_msg(stamp_ns, frame_id))
    x0, y0 = grid.elevation.origin_m
    origin = Pose(position=Point(x=float(x0), y=float(y0), z=0.0), orientation=Quaternion(w=1.0))
    resolution = float(np.float32(grid.elevation.cell_m))
    message.info = MapMetaData(
        map_load_time=time_msg(stamp_ns), resolution=resolution, width=columns, height=rows, origin=origin
    )
    data = array("b")
    data.frombytes(np.ascontiguousarray(grid.hazard).reshape(-1).data)
    message.data = data
    return message
