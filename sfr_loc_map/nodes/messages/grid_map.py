"""The elevation grid as grid_map_msgs/GridMap, where that package is installed."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import Float32MultiArray, MultiArrayDimension, MultiArrayLayout

from sfr_loc_map.errors import NodeError
from sfr_loc_map.mapping.terrain.grid import TerrainGrid
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.message_types import message_type


def grid_map_type() -> type[Any] | None:
    """Return the type of the message, None where its package is not installed."""
    try:
        return message_type("grid_map_msgs/msg/GridMap")
    except NodeError:
        return None


def grid_map_msg(kind: type[Any], grid: TerrainGrid, stamp_ns: int, frame_id: str) -> Any:  # noqa: ANN401 - of `kind`
    """Return the layers elevation, sigma, slope, roughness, step, count and hazard; NaN where not known.

    Args:
        kind: The type of the message.
        grid: The terrain.
        stamp_ns: Its stamp, nanoseconds.
        frame_id: Name of LM.
    """
    rows, columns = grid.hazard.shape
    cell_m = float(grid.elevation.cell_m)
    message = kind(header=header_msg(stamp_ns, frame_id))
    info, position = message.info, message.info.pose.position
    info.resolution, info.length_x, info.length_y = cell_m, columns * cell_m, rows * cell_m
    position.x, position.y = (
        float(origin) + 0.5 * length
        for origin, length in zip(grid.elevation.origin_m, (info.length_x, info.length_y), strict=True)
    )
    info.pose.orientation.w = 1.0
    layers = {
        "elevation": grid.elevation.height_m,
        "sigma": grid.elevation.sigma_m,
        "slope": grid.slope_rad,
        "roughness": grid.roughness_m,
        "step": grid.step_m,
        "count": grid.elevation.count,
        "hazard": np.where(grid.hazard < 0, np.nan, grid.hazard),
    }
    message.layers, message.basic_layers = list(layers), ["elevation"]
    message.data = [_layer(values) for values in layers.values()]
    return message


def _layer(values: NDArray[Any]) -> Float32MultiArray:
    """Return a layer `(R, C)`, rows along y, as grid_map stores it.

    Its row index falls along x and its column index along y, from the corner of largest x and y, and it is stored
    column by column.
    """
    rows, columns = values.shape
    outer = MultiArrayDimension(label="column_index", size=rows, stride=rows * columns)
    inner = MultiArrayDimension(label="row_index", size=columns, stride=columns)
    data = array("f", np.ascontiguousarray(values[::-1, ::-1], np.float32).tobytes())
    return Float32MultiArray(layout=MultiArrayLayout(dim=[outer, inner]), data=data)
