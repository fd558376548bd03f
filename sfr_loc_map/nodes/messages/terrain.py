"""Elevation and hazard grids as messages, and back."""

from __future__ import annotations

from array import array

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from nav_msgs.msg import MapMetaData, OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.plausibility import check_image_size
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


def elevation_from_msg(message: PointCloud2) -> NDArray[np.float32]:
    """Return the cells `(R, C, 8)` of a message as `elevation_msg` makes it, in the order of `ELEVATION_FIELDS`.

    Raises:
        InputError: If it is another message, has no cell, or its data is too short.
        GeometryError: If its size is absurd.
    """
    rows, columns, step = int(message.height), int(message.width), 4 * len(ELEVATION_FIELDS)
    check_image_size(columns, rows, "the elevation grid")
    names = tuple(field.name for field in message.fields)
    data = np.frombuffer(message.data, np.uint8)
    if names != ELEVATION_FIELDS or message.point_step != step or message.is_bigendian:
        raise InputError(f"no elevation: fields {', '.join(ELEVATION_FIELDS)} are needed, found {', '.join(names)}")
    if message.row_step != step * columns or len(data) < step * columns * rows:
        raise InputError(f"elevation of {columns} x {rows} cells has {len(data)} bytes: too few")
    cells = data[: step * columns * rows].view("<f4").reshape(rows, columns, len(ELEVATION_FIELDS))
    if not np.isfinite(cells[..., :2]).all():
        raise InputError("elevation with cells of no place: x and y must be numbers everywhere")
    return np.asarray(cells, np.float32)


def hazard_from_msg(message: OccupancyGrid) -> NDArray[np.float32]:
    """Return the hazard `(R, C)` from 0 to 100, NaN where not known.

    Raises:
        InputError: If its data does not fit its size.
    """
    rows, columns = int(message.info.height), int(message.info.width)
    data = np.frombuffer(message.data, np.int8)
    if len(data) != rows * columns:
        raise InputError(f"hazard of {columns} x {rows} cells has {len(data)}")
    return np.where(data < 0, np.nan, data).astype(np.float32).reshape(rows, columns)
