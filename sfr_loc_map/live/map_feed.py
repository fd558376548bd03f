"""Maps for the live page: the grid of the mapper if published, otherwise a grid made from its cloud."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import PointCloud2

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.io.clouds.point_image import points_image
from sfr_loc_map.latest import Latest
from sfr_loc_map.live import media, updates
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.ros.grid_messages import ELEVATION_FIELDS, elevation_from_msg, hazard_from_msg
from sfr_loc_map.ros.point_messages import cloud_from_msg
from sfr_loc_map.topics import ELEVATION, TRUE_POINTS

LAYERS = ("height", *ELEVATION_FIELDS[3:])  #: Layers of an elevation message, after x and y.
MAX_FUSIONS = 8  #: Number of fusions whose pair stamps are kept for clouds that are received later.


class MapFeed:
    """Passes maps to a state: the grid of the mapper if published, otherwise a grid made from its cloud.

    Invalid messages raise an `SfrError`.
    """

    def __init__(self, state: LiveState, has_grid: Callable[[], bool]) -> None:
        """Start without a map; `has_grid` returns whether the mapper publishes a grid."""
        self._has_grid = has_grid
        self._state, self._truth = state, media.CloudTruth()
        self._fusions = Latest[int, tuple[int, ...]](MAX_FUSIONS)  # stamps of the pairs by stamp of the cloud
        self._cloud: tuple[int, PointCloud, float] | None = None  # stamp, cloud, publication time
        self._points: tuple[int, FloatArray32, FloatArray32] | None = None
        self._hazard: tuple[int, FloatArray32] | None = None
        self._grid: updates.ElevationSample | None = None

    def add_true_points(self, message: PointCloud2, published_s: float) -> None:
        """Add the true points of a pair."""
        size = int(message.width), int(message.height)
        check_image_size(*size, TRUE_POINTS)
        self._truth.add(stamp_of(message), points_image(message, size))

    def add_call(self, call: CallRecord) -> None:
        """Add a call of the mapper.

        The call of a fusion names the pairs of its cloud and may arrive after the cloud.
        """
        if call.state != MappingState.FUSED or not call.pair_stamps_ns:
            return
        self._fusions[call.stamp_ns] = call.pair_stamps_ns
        if self._cloud is not None and self._cloud[0] == call.stamp_ns:
            self._take_cloud()
            self._put()

    def add_cloud(self, message: PointCloud2, published_s: float) -> None:
        """Add a cloud."""
        self._cloud = stamp_of(message), cloud_from_msg(message), published_s
        self._take_cloud()

    def _take_cloud(self) -> None:
        """Record the errors of the cloud, which require the call of its fusion.

        If the mapper publishes no grid, pass on a grid made from the cloud.
        """
        if self._cloud is None:
            return
        stamp_ns, cloud, published_s = self._cloud
        error = self._truth.errors(cloud, self._fusions.get(stamp_ns, ()))
        self._points = None if error is None else (stamp_ns, np.asarray(cloud.xyz[:, :2], np.float32), error)
        if self._has_grid():
            return
        grid = media.grid_of_cloud(stamp_ns, cloud.xyz, cloud.sigma, published_s, error)
        if grid is not None:
            self._state.put(grid)

    def add_elevation(self, message: PointCloud2, published_s: float) -> None:
        """Add an elevation grid."""
        cells, stamp_ns = elevation_from_msg(message), stamp_of(message)
        rows, columns = cells.shape[:2]
        axis, steps = (0, columns - 1) if columns > 1 else (1, rows - 1)
        with np.errstate(over="ignore", invalid="ignore"):  # infinite coordinates are refused below
            # a single cell has the default size
            cell_m = float(cells[-1, -1, axis] - cells[0, 0, axis]) / steps if steps else media.CELL_M
            corner = cells[0, 0, :2] - 0.5 * cell_m
        origin = float(corner[0]), float(corner[1])
        if not (0.0 < cell_m < math.inf and all(map(math.isfinite, origin))):
            raise InputError(
                f"elevation with cells of {cell_m:g} m: an x that grows along the columns and a y that grows along "
                "the rows are required"
            )
        self._grid = updates.ElevationSample(ELEVATION, stamp_ns, origin, cell_m, LAYERS, cells[..., 2:], published_s)
        self._put()

    def add_hazard(self, message: OccupancyGrid, published_s: float) -> None:
        """Add a hazard grid, which is displayed with the elevation grid of the same stamp."""
        self._hazard = stamp_of(message), hazard_from_msg(message)
        self._put()

    def _put(self) -> None:
        """Pass on the grid, with the errors and the hazard if they were received."""
        grid = self._grid
        hazard = self._hazard
        points = self._points
        if grid is None:
            return
        shape = grid.layers.shape[:2]
        if points is not None and points[0] == grid.stamp_ns:
            _, xy, error = points
            means = media.means_of(media.cells_of(xy, grid.origin_m, grid.cell_m, shape), error, math.prod(shape))
            has_height = np.isfinite(grid.layers[..., grid.names.index("height")])
            grid = media.with_layer(grid, "error", np.where(has_height, means.reshape(shape), np.nan))
        if hazard is not None and hazard[0] == grid.stamp_ns and hazard[1].shape == shape:
            grid = media.with_layer(grid, "hazard", hazard[1])
        self._state.put(media.thinned(grid))
