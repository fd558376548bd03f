"""Elevation and hazard grids as messages, and back; the same as grid_map_msgs/GridMap, where that is installed."""

from __future__ import annotations

import importlib
from array import array
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from nav_msgs.msg import MapMetaData, OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float32MultiArray, MultiArrayDimension, MultiArrayLayout

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.mapping.terrain.grid import TerrainGrid
from sfr_loc_map.nodes.messages.fields import float_points_msg, floats_of, header_msg, time_msg

ELEVATION_FIELDS = ("x", "y", "z", "sigma", "slope", "roughness", "step", "count")
"""Fields of a cell, all float32: its centre and height, metres; slope, radians; roughness and step, metres; points."""


def _layers(grid: TerrainGrid) -> dict[str, NDArray[Any]]:
    model = grid.elevation
    return {
        "elevation": model.height_m,
        "sigma": model.sigma_m,
        "slope": grid.slope_rad,
        "roughness": grid.roughness_m,
        "step": grid.step_m,
        "count": model.count,
    }


def elevation_msg(grid: TerrainGrid, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a grid as an organised cloud: one point a cell, rows along y, columns along x, NaN where not known."""
    (rows, columns), (x0, y0), cell_m = grid.hazard.shape, grid.elevation.origin_m, grid.elevation.cell_m
    cells = np.empty((rows, columns, len(ELEVATION_FIELDS)), np.float32)
    cells[..., 0] = x0 + (np.arange(columns) + 0.5) * cell_m
    cells[..., 1] = (y0 + (np.arange(rows) + 0.5) * cell_m)[:, None]
    for index, layer in enumerate(_layers(grid).values(), 2):
        cells[..., index] = layer
    message = float_points_msg(cells, ELEVATION_FIELDS, header_msg(stamp_ns, frame_id))
    return message


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


def grid_map_type() -> type[Any] | None:
    """Return the type of grid_map_msgs/GridMap, None where its package is not installed."""
    try:
        found: type[Any] = importlib.import_module("grid_map_msgs.msg").GridMap
    except ImportError:
        return None
    return found


def grid_map_msg(kind: type[Any], grid: TerrainGrid, stamp_ns: int, frame_id: str) -> Any:  # noqa: ANN401 - of `kind`
    """Return the layers elevation, sigma, slope, roughness, step, count and hazard; NaN where not known."""
    rows, columns = grid.hazard.shape
    cell_m = float(grid.elevation.cell_m)
    message = kind(header=header_msg(stamp_ns, frame_id))
    info, position = message.info, message.info.pose.position
    info.resolution, info.length_x, info.length_y = cell_m, columns * cell_m, rows * cell_m
    position.x = float(grid.elevation.origin_m[0]) + 0.5 * info.length_x
    position.y = float(grid.elevation.origin_m[1]) + 0.5 * info.length_y
    info.pose.orientation.w = 1.0
    layers = _layers(grid) | {"hazard": np.where(grid.hazard < 0, np.nan, grid.hazard)}
    message.layers, message.basic_layers = list(layers), ["elevation"]
    # grid_map's row index falls along x and its column index along y, from the corner of largest x and y; a layer is
    # stored column by column.
    outer = MultiArrayDimension(label="column_index", size=rows, stride=rows * columns)
    inner = MultiArrayDimension(label="row_index", size=columns, stride=columns)
    message.data = [
        Float32MultiArray(
            layout=MultiArrayLayout(dim=[outer, inner]),
            data=array("f", np.ascontiguousarray(values[::-1, ::-1], np.float32).tobytes()),
        )
        for values in layers.values()
    ]
    return message
