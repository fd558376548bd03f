"""A fused map on its topics: cloud, elevation and hazard, each latched."""

from __future__ import annotations

from collections.abc import Callable

from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import PointCloud2

from sfr_loc_map.errors import SfrError
from sfr_loc_map.mapping.mapper import FusedMap
from sfr_loc_map.mapping.terrain.config import TerrainConfig
from sfr_loc_map.mapping.terrain.grid import elevation_grid
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.nodes.messages.grid_map import grid_map_msg, grid_map_type
from sfr_loc_map.nodes.messages.point_cloud import cloud_msg
from sfr_loc_map.nodes.messages.terrain import elevation_msg, hazard_msg


class MapPublisher:
    """Publishes maps; who comes late gets the last one."""

    def __init__(self, endpoints: Endpoints, lm_frame: str, warn: Callable[[str], None]) -> None:
        """Create the publishers.

        Args:
            endpoints: Of the node.
            lm_frame: Name of LM.
            warn: Called where a map has no grids.
        """
        self._lm_frame, self._warn = lm_frame, warn
        self._cloud = endpoints.add_publisher(PointCloud2, "mapping/points", 1, latched=True)
        self._elevation = endpoints.add_publisher(PointCloud2, "mapping/elevation", 1, latched=True)
        self._hazard = endpoints.add_publisher(OccupancyGrid, "mapping/hazard", 1, latched=True)
        self._grid_map_type = grid_map_type()
        if self._grid_map_type is not None:
            self._grid_map = endpoints.add_publisher(self._grid_map_type, "mapping/grid_map", 1, latched=True)

    def publish_cloud(self, fused: FusedMap, stamp_ns: int) -> None:
        """Publish the points."""
        self._cloud.publish(cloud_msg(fused.cloud, stamp_ns, self._lm_frame))

    def publish_terrain(self, fused: FusedMap, stamp_ns: int, config: TerrainConfig) -> None:
        """Make and publish elevation and hazard."""
        try:
            grid = elevation_grid(fused.cloud, config, fused.T_lm_left, fused.random_sigma)
        except SfrError as error:
            self._warn(f"no elevation and no hazard of this map: {error}")
            return
        self._elevation.publish(elevation_msg(grid, stamp_ns, self._lm_frame))
        self._hazard.publish(hazard_msg(grid, stamp_ns, self._lm_frame))
        if self._grid_map_type is not None:
            self._grid_map.publish(grid_map_msg(self._grid_map_type, grid, stamp_ns, self._lm_frame))
