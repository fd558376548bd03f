"""Grids as messages; GridMap has no wheels: a stand-in has the fields of grid_map_msgs for ROS 2."""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Pose
from scenes import sent

from sfr_loc_map.mapping.config import TerrainConfig
from sfr_loc_map.mapping.terrain.elevation import ElevationModel
from sfr_loc_map.mapping.terrain.grid import TerrainGrid
from sfr_loc_map.nodes import mapping_node
from sfr_loc_map.nodes.mapping_node import MapPublisher
from sfr_loc_map.nodes.messages.terrain import (
    ELEVATION_FIELDS,
    elevation_from_msg,
    elevation_msg,
    hazard_from_msg,
    hazard_msg,
)

CELL_M = 0.25


def terrain() -> TerrainGrid:
    layers = np.random.default_rng(2).normal(size=(5, 3, 4)).astype(np.float32)
    layers[:, 1, 2] = np.nan
    count, hazard = np.arange(12, dtype=np.int32).reshape(3, 4), np.arange(-1, 11, dtype=np.int8).reshape(3, 4)
    model = ElevationModel(layers[0], layers[1], count, (-0.5, 1.25), CELL_M)
    return TerrainGrid(model, layers[2], layers[3], layers[4], hazard)


GRID = terrain()
HAZARD = np.where(GRID.hazard < 0, np.nan, GRID.hazard)
LAYERS = (GRID.elevation.height_m, GRID.elevation.sigma_m, GRID.slope_rad, GRID.roughness_m, GRID.step_m)


def test_grids_come_out_as_they_went_in() -> None:
    cloud = sent(elevation_msg(GRID, 5, "lm"))
    assert [field.name for field in cloud.fields] == list(ELEVATION_FIELDS)
    assert (cloud.height, cloud.width, cloud.header.frame_id, cloud.is_dense) == (3, 4, "lm", False)
    found = elevation_from_msg(cloud)
    np.testing.assert_allclose(found[0, :, 0], -0.375 + CELL_M * np.arange(4), atol=1e-6)
    np.testing.assert_allclose(found[:, 0, 1], 1.375 + CELL_M * np.arange(3), atol=1e-6)
    assert np.array_equal(found[..., 2:7], np.moveaxis(LAYERS, 0, -1), equal_nan=True)
    assert np.array_equal(found[..., 7], GRID.elevation.count)
    message = sent(hazard_msg(GRID, 5, "lm"))
    info = message.info
    assert (info.height, info.width, info.resolution) == (3, 4, CELL_M)
    assert (info.origin.position.x, info.origin.position.y) == (-0.5, 1.25)
    assert np.array_equal(hazard_from_msg(message), HAZARD, equal_nan=True)


def grid_map(header: Any) -> SimpleNamespace:
    return SimpleNamespace(header=header, info=SimpleNamespace(pose=Pose()))


def published(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[Any]]:
    """Return what a map publishes, by topic."""
    topics: dict[str, list[Any]] = {}

    def add_publisher(_kind: Any, topic: str, _depth: int, *, latched: bool) -> SimpleNamespace:
        assert latched
        return SimpleNamespace(publish=topics.setdefault(topic, []).append)

    monkeypatch.setattr(mapping_node, "elevation_grid", lambda *_: GRID)
    publisher = MapPublisher(SimpleNamespace(add_publisher=add_publisher), "lm", pytest.fail)
    publisher.publish_terrain(SimpleNamespace(cloud=None, T_lm_left=None, random_sigma=None), 5, TerrainConfig())
    return topics


def at(message: Any, layer: str, x: float, y: float) -> float:
    """Return a layer's value at a place, by the rules of grid_map: indices fall from the largest x and y."""
    info = message.info
    row = int((info.pose.position.x + info.length_x / 2 - x) / info.resolution)
    column = int((info.pose.position.y + info.length_y / 2 - y) / info.resolution)
    values = sent(message.data[message.layers.index(layer)])
    outer, inner = values.layout.dim
    assert (outer.label, inner.label) == ("column_index", "row_index")  # Eigen's order, column by column
    assert (outer.size, outer.stride, inner.size, inner.stride) == (3, 12, 4, 4)
    return float(values.data[column * inner.stride + row])


def test_where_its_package_is_installed_a_grid_map_has_each_cell_in_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("grid_map_msgs.msg")
    monkeypatch.setitem(sys.modules, "grid_map_msgs", ModuleType("grid_map_msgs"))
    monkeypatch.setitem(sys.modules, "grid_map_msgs.msg", module)
    module.GridMap = grid_map
    topics = published(monkeypatch)
    assert len(topics["mapping/elevation"]) == len(topics["mapping/hazard"]) == 1
    (message,) = topics["mapping/grid_map"]
    assert (message.header.frame_id, message.header.stamp.nanosec, message.basic_layers) == ("lm", 5, ["elevation"])
    assert (message.info.length_x, message.info.length_y) == (1.0, 0.75)
    assert len(message.layers) == len(message.data) == 7
    for name, values in zip(message.layers, (*LAYERS, GRID.elevation.count, HAZARD), strict=True):
        found = [[at(message, name, -0.375 + CELL_M * c, 1.375 + CELL_M * r) for c in range(4)] for r in range(3)]
        np.testing.assert_array_equal(found, values.astype(np.float32))


def test_without_its_package_there_is_no_such_topic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "grid_map_msgs.msg", None)
    assert set(published(monkeypatch)) == {"mapping/points", "mapping/elevation", "mapping/hazard"}
