"""Clouds, elevation and hazard for the page, with their errors where the truth is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import PointCloud2

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.media import (
    CELL_M,
    CloudTruth,
    cells_of,
    cloud_sample,
    grid_of_cloud,
    means_of,
    thinned,
    with_layer,
)
from sfr_loc_map.live.updates import ELEVATION, POINTS, ElevationSample
from sfr_loc_map.nodes.messages.point_cloud import cloud_from_msg
from sfr_loc_map.nodes.messages.terrain import ELEVATION_FIELDS, elevation_from_msg, hazard_from_msg

ENOUGH_POINTS = 100_000
"""Points of a cloud that are read where the mapper publishes its grid."""
NAMES = ("height", *ELEVATION_FIELDS[3:])
"""Layers of an elevation message, after x and y."""


class MapFeed:
    """Gives maps to a hub: the mapper's own grid where it publishes one, else one that is made of its cloud."""

    def __init__(self, hub: Hub, has_grid: Callable[[], bool]) -> None:
        """Start without a map.

        Args:
            hub: Takes clouds and grids.
            has_grid: Tells whether the mapper publishes a grid of its own.
        """
        self._has_grid = has_grid
        self._hub, self._truth = hub, CloudTruth()
        self._points: tuple[int, FloatArray32, FloatArray32] | None = None
        self._hazard: tuple[int, FloatArray32] | None = None
        self._grid: ElevationSample | None = None

    def add_true_points(self, message: PointCloud2, published_s: float) -> None:
        """Take the true points of a pair in.

        Raises:
            SfrError: If they are none.
        """
        self._truth.add(stamp_of(message), message)

    def add_cloud(self, message: PointCloud2, published_s: float) -> None:
        """Take a cloud in.

        Raises:
            InputError: If it is none.
        """
        has_grid, count, stamp_ns = self._has_grid(), int(message.width) * int(message.height), stamp_of(message)
        every = max(count // ENOUGH_POINTS, 1) if has_grid else 1
        cloud = cloud_from_msg(message, every)
        error = self._truth.errors(cloud)
        sample = cloud_sample(POINTS, stamp_ns, cloud.xyz, cloud.sigma, published_s, error)
        self._hub.put(sample if every == 1 else replace(sample, total=count))
        self._points = None if error is None else (stamp_ns, np.asarray(cloud.xyz[:, :2], np.float32), error)
        if not has_grid:
            grid = grid_of_cloud(stamp_ns, cloud.xyz, cloud.sigma, published_s, error)
            if grid is not None:
                self._hub.put(grid)

    def add_elevation(self, message: PointCloud2, published_s: float) -> None:
        """Take an elevation grid in.

        Raises:
            InputError: If it is none.
        """
        cells, stamp_ns = elevation_from_msg(message), stamp_of(message)
        with np.errstate(over="ignore", invalid="ignore"):  # infinite ones are refused
            cell_m = _cell_m(cells)
            corner = cells[0, 0, :2] - 0.5 * cell_m
        origin = float(corner[0]), float(corner[1])
        if not (0.0 < cell_m < math.inf and all(map(math.isfinite, origin))):
            raise InputError(f"elevation with cells of {cell_m:g} m: x must grow along the columns, y along the rows")
        grid = ElevationSample(ELEVATION, stamp_ns, origin, cell_m, NAMES, cells[..., 2:], published_s)
        if self._points is not None and self._points[0] == stamp_ns:
            _, xy, error = self._points
            shape = cells.shape[0], cells.shape[1]
            means = means_of(cells_of(xy, origin, cell_m, shape), error, shape[0] * shape[1])
            known = np.where(np.isfinite(cells[..., 2]), means.reshape(shape), np.nan)
            grid = with_layer(grid, "error", known)
        self._points, self._grid = None, grid
        self._put()

    def add_hazard(self, message: OccupancyGrid, published_s: float) -> None:
        """Take a hazard grid in; it is shown with the elevation of its stamp.

        Raises:
            InputError: If its data does not fit its size.
        """
        self._hazard = stamp_of(message), hazard_from_msg(message)
        self._put()

    def _put(self) -> None:
        """Show the grid with its hazard, whichever comes first."""
        grid, hazard = self._grid, self._hazard
        if grid is None:
            return
        if hazard is not None and hazard[0] == grid.stamp_ns and hazard[1].shape == grid.layers.shape[:2]:
            grid = with_layer(grid, "hazard", hazard[1])
        self._hub.put(thinned(grid))


def _cell_m(cells: FloatArray32) -> float:
    """Return the side of a cell; one alone has the side that is usual."""
    rows, columns, _ = cells.shape
    if columns > 1:
        return float(cells[0, -1, 0] - cells[0, 0, 0]) / (columns - 1)
    return float(cells[-1, 0, 1] - cells[0, 0, 1]) / (rows - 1) if rows > 1 else CELL_M
