"""Grids as messages; GridMap has no wheels: a stand-in has the fields of grid_map_msgs for ROS 2."""

# ruff: noqa: E402 - ROS may be absent
import sys
from dataclasses import dataclass, field
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from geometry_msgs.msg import Pose
from scenes import sent
from std_msgs.msg import Float32MultiArray, Header

from sfr_loc_map.mapping.terrain.elevation import ElevationModel
from sfr_loc_map.mapping.terrain.grid import TerrainGrid
from sfr_loc_map.nodes import mapping_node
from sfr_loc_map.nodes.mapping_node import MapPublisher
from sfr_loc_map.nodes.messages.terrain import (
    ELEVATION_FIELDS,
    elevation_from_msg,
    elevation_msg,
    grid_map_msg,
    grid_map_type,
    hazard_from_msg,
    hazard_msg,
)

CELL_M = 0.25


@dataclass(slots=True)
class GridMapInfo:
    resolution: float = 0.0
    length_x: float = 0.0
    length_y: float = 0.0
    pose: Pose = field(default_factory=Pose)


@dataclass(slots=True)
class GridMap:
    header: Header = field(default_factory=Header)
    info: GridMapInfo = field(default_factory=GridMapInfo)
    layers: list[str] = field(default_factory=list)
    basic_layers: list[str] = field(default_factory=list)
    data: list[Float32MultiArray] = field(default_factory=list)
    outer_start_index: int = 0
    inner_start_index: int = 0


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("grid_map_msgs.msg")
    module.GridMap = GridMap  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "grid_map_msgs", ModuleType("grid_map_msgs"))
    monkeypatch.setitem(sys.modules, "grid_map_msgs.msg", module)


def terrain() -> TerrainGrid:
    layers = np.random.default_rng(2).normal(size=(5, 3, 4)).astype(np.float32)
    layers[:, 1, 2] = np.nan
    count, hazard = np.arange(12, dtype=np.int32).reshape(3, 4), np.arange(-1, 11, dtype=np.int8).reshape(3, 4)
    model = ElevationModel(layers[0], layers[1], count, (-0.5, 1.25), CELL_M)
    return TerrainGrid(model, layers[2], layers[3], layers[4], hazard)


def test_grids_come_out_as_they_went_in() -> None:
    grid = terrain()
    cloud = sent(elevation_msg(grid, 5, "lm"))
    assert [field.name for field in cloud.fields] == list(ELEVATION_FIELDS)
    assert (cloud.height, cloud.width, cloud.header.frame_id, cloud.is_dense) == (3, 4, "lm", False)
    found = elevation_from_msg(cloud)
    np.testing.assert_allclose(found[0, :, 0], -0.375 + CELL_M * np.arange(4), atol=1e-6)
    np.testing.assert_allclose(found[:, 0, 1], 1.375 + CELL_M * np.arange(3), atol=1e-6)
    layers = (grid.elevation.height_m, grid.elevation.sigma_m, grid.slope_rad, grid.roughness_m, grid.step_m)
    assert np.array_equal(found[..., 2:7], np.moveaxis(layers, 0, -1), equal_nan=True)
    assert np.array_equal(found[..., 7], grid.elevation.count)
    message = sent(hazard_msg(grid, 5, "lm"))
    info = message.info
    assert (info.height, info.width, info.resolution) == (3, 4, CELL_M)
    assert (info.origin.position.x, info.origin.position.y) == (-0.5, 1.25)
    assert np.array_equal(hazard_from_msg(message), np.where(grid.hazard < 0, np.nan, grid.hazard), equal_nan=True)


def at(message: GridMap, layer: str, x: float, y: float) -> float:
    """Return a layer's value at a place, by the rules of grid_map: indices fall from the largest x and y."""
    info = message.info
    row = int((info.pose.position.x + info.length_x / 2 - x) / info.resolution)
    column = int((info.pose.position.y + info.length_y / 2 - y) / info.resolution)
    values = sent(message.data[message.layers.index(layer)])
    outer, inner = values.layout.dim
    assert (outer.label, inner.label) == ("column_index", "row_index")  # Eigen's order, column by column
    assert (outer.size, outer.stride, inner.size, inner.stride) == (3, 12, 4, 4)
    return float(values.data[column * inner.stride + row])


def test_each_cell_has_its_place_in_each_layer(installed: None) -> None:
    kind, grid = grid_map_type(), terrain()
    assert kind is GridMap
    message = grid_map_msg(kind, grid, 5, "lm")
    assert (message.header.frame_id, message.header.stamp.nanosec, message.basic_layers) == ("lm", 5, ["elevation"])
    assert (message.info.length_x, message.info.length_y) == (1.0, 0.75)
    hazard = np.where(grid.hazard < 0, np.nan, grid.hazard)
    layers = (grid.elevation.height_m, grid.elevation.sigma_m, grid.slope_rad, grid.roughness_m, grid.step_m)
    assert len(message.layers) == len(message.data) == 7
    for name, values in zip(message.layers, (*layers, grid.elevation.count, hazard), strict=True):
        found = [[at(message, name, -0.375 + CELL_M * c, 1.375 + CELL_M * r) for c in range(4)] for r in range(3)]
        np.testing.assert_array_equal(found, values.astype(np.float32))


def published(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[Any]]:
    """Return what a map publishes, by topic."""
    topics: dict[str, list[Any]] = {}

    def add_publisher(_kind: type[Any], topic: str, _depth: int, *, latched: bool) -> SimpleNamespace:
        assert latched
        return SimpleNamespace(publish=topics.setdefault(topic, []).append)

    monkeypatch.setattr(mapping_node, "elevation_grid", lambda *_: terrain())
    publisher = MapPublisher(SimpleNamespace(add_publisher=add_publisher), "lm", pytest.fail)  # type: ignore[arg-type]
    fused: Any = SimpleNamespace(cloud=None, T_lm_left=None, random_sigma=None)
    publisher.publish_terrain(fused, 5, None)  # type: ignore[arg-type]
    return topics


def test_it_is_published_where_it_can_be_imported(installed: None, monkeypatch: pytest.MonkeyPatch) -> None:
    topics = published(monkeypatch)
    assert isinstance(topics["mapping/grid_map"][0], GridMap)
    assert len(topics["mapping/elevation"]) == len(topics["mapping/hazard"]) == 1


def test_without_its_package_there_is_no_such_topic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "grid_map_msgs.msg", None)
    assert set(published(monkeypatch)) == {"mapping/points", "mapping/elevation", "mapping/hazard"}
