"""Maps for the live page: the mapper's own grid where it publishes one, else one that is made of its cloud."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import PointCloud2

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.inputs import stamp_of
from sfr_loc_map.io.images.codec import points_image
from sfr_loc_map.live import media, updates
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.nodes import messages
from sfr_loc_map.topics import ELEVATION, TRUE_POINTS

LAYERS = ("height", *messages.ELEVATION_FIELDS[3:])  #: Layers of an elevation message, after x and y.


class MapFeed:
    """Gives maps to a state: the mapper's own grid where it publishes one, else one that is made of its cloud.

    Messages that are none raise an `SfrError`.
    """

    def __init__(self, state: LiveState, has_grid: Callable[[], bool]) -> None:
        """Start without a map; `has_grid` tells whether the mapper publishes a grid of its own."""
        self._has_grid = has_grid
        self._state, self._truth = state, media.CloudTruth()
        self._points: tuple[int, FloatArray32, FloatArray32] | None = None
        self._hazard: tuple[int, FloatArray32] | None = None
        self._grid: updates.ElevationSample | None = None

    def add_true_points(self, message: PointCloud2, published_s: float) -> None:
        """Take the true points of a pair in."""
        size = int(message.width), int(message.height)
        check_image_size(*size, TRUE_POINTS)
        self._truth.add(stamp_of(message), points_image(message, size))

    def add_cloud(self, message: PointCloud2, published_s: float) -> None:
        """Take a cloud in."""
        stamp_ns, cloud = stamp_of(message), messages.cloud_from_msg(message)
        error = self._truth.errors(cloud)
        shown = cloud.xyz, cloud.sigma, published_s, error
        sample, grid = media.cloud_samples(stamp_ns, *shown, with_grid=not self._has_grid())
        self._state.put(sample)
        self._points = None if error is None else (stamp_ns, np.asarray(cloud.xyz[:, :2], np.float32), error)
        if grid is not None:
            self._state.put(grid)

    def add_elevation(self, message: PointCloud2, published_s: float) -> None:
        """Take an elevation grid in."""
        cells, stamp_ns = messages.elevation_from_msg(message), stamp_of(message)
        rows, columns = cells.shape[:2]
        axis, steps = (0, columns - 1) if columns > 1 else (1, rows - 1)
        with np.errstate(over="ignore", invalid="ignore"):  # infinite ones are refused
            # one cell alone has the side that is usual
            cell_m = float(cells[-1, -1, axis] - cells[0, 0, axis]) / steps if steps else media.CELL_M
            corner = cells[0, 0, :2] - 0.5 * cell_m
        origin = float(corner[0]), float(corner[1])
        if not (0.0 < cell_m < math.inf and all(map(math.isfinite, origin))):
            raise InputError(f"elevation with cells of {cell_m:g} m: x must grow along the columns, y along the rows")
        grid = updates.ElevationSample(ELEVATION, stamp_ns, origin, cell_m, LAYERS, cells[..., 2:], published_s)
        if self._points is not None and self._points[0] == stamp_ns:
            _, xy, error = self._points
            means = media.means_of(media.cells_of(xy, origin, cell_m, (rows, columns)), error, rows * columns)
            known = np.where(np.isfinite(cells[..., 2]), means.reshape(rows, columns), np.nan)
            grid = media.with_layer(grid, "error", known)
        self._points, self._grid = None, grid
        self._put()

    def add_hazard(self, message: OccupancyGrid, published_s: float) -> None:
        """Take a hazard grid in; it is shown with the elevation of its stamp."""
        self._hazard = stamp_of(message), messages.hazard_from_msg(message)
        self._put()

    def _put(self) -> None:
        """Show the grid with its hazard, whichever comes first."""
        grid, hazard = self._grid, self._hazard
        if grid is None:
            return
        if hazard is not None and hazard[0] == grid.stamp_ns and hazard[1].shape == grid.layers.shape[:2]:
            grid = media.with_layer(grid, "hazard", hazard[1])
        self._state.put(media.thinned(grid))
