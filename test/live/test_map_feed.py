"""Maps as the page is given them: the mapper's own grid with hazard and error."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.node_scenes import sent
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.live.map_feed import MapFeed
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import ElevationSample
from sfr_loc_map.mapping.terrain.cells import CellGrid
from sfr_loc_map.mapping.terrain.elevation import ElevationModel
from sfr_loc_map.mapping.terrain.terrain_grid import TerrainGrid
from sfr_loc_map.ros.grid_messages import elevation_from_msg, elevation_msg, hazard_msg
from sfr_loc_map.ros.messages import byte_array
from sfr_loc_map.ros.point_messages import cloud_msg

STAMP_NS = 1_700_000_000_000_000_000
SIDE, CELL_M = 48, 0.5


def ground() -> np.ndarray:
    """True points of an image of 48 x 48 pixels: a plane of 12 m, four pixels a metre."""
    v, u = np.mgrid[:SIDE, :SIDE].astype(np.float32)
    return np.stack([0.25 * u, 0.25 * v, np.zeros_like(u)], axis=-1)


def estimated(truth: np.ndarray) -> PointCloud:
    """A cloud that lies 0.01 m above the truth, 0.03 m where x is above 6 m."""
    v, u = np.mgrid[:SIDE, :SIDE].astype(np.uint16)
    xyz = truth.reshape(-1, 3).copy()
    xyz[:, 2] += np.where(xyz[:, 0] >= 6.0, 0.03, 0.01)
    flat, floats = SIDE * SIDE, np.full(SIDE * SIDE, 0.02, np.float32)
    return PointCloud(xyz, floats, floats, u.reshape(-1), v.reshape(-1), np.zeros(flat, np.uint8))


def fusion(*pair_stamps_ns: int) -> CallRecord:
    return CallRecord(pair_stamps_ns[-1], 0.1, "fused", pair_stamps_ns=pair_stamps_ns)


def terrain() -> TerrainGrid:
    layers = np.zeros((5, 24, 24), np.float32)
    layers[0, :, 3] = np.nan  # cells whose height is not known
    hazard = np.zeros((24, 24), np.int8)
    hazard[2, 5], hazard[:, 3] = 100, -1
    model = ElevationModel(layers[0], layers[1], np.ones((24, 24), np.int32), CellGrid(0, 0, 24, 24, CELL_M))
    return TerrainGrid(model, layers[2], layers[3], layers[4], hazard)


def test_map_has_its_errors_and_hazards() -> None:
    state, truth = LiveState(), ground()
    feed = MapFeed(state, lambda: True)
    feed.add_true_points(bag_messages.points(STAMP_NS, truth, None), 0.0)
    feed.add_cloud(sent(cloud_msg(estimated(truth), STAMP_NS, "lm")), 0.0)
    feed.add_call(fusion(STAMP_NS))
    feed.add_hazard(sent(hazard_msg(terrain(), STAMP_NS, "lm")), 0.0)
    feed.add_elevation(sent(elevation_msg(terrain(), STAMP_NS, "lm")), 0.0)
    grid = state.media["mapping/elevation"]
    assert isinstance(grid, ElevationSample)
    error = grid.layers[..., grid.names.index("error")]
    at = (np.array([[3.0, 1.0], [9.0, 1.0]]) - grid.origin_m) / grid.cell_m
    (column, row), (far, _) = np.floor(at + 1e-3).astype(int)
    assert [error[row, column], error[row, far]] == pytest.approx([0.01, 0.03], abs=1e-6)
    hazard = grid.layers[..., grid.names.index("hazard")]
    assert hazard[2, 5] == 100.0
    assert np.isnan(hazard[:, 3]).all()
    assert np.isnan(error[:, 3]).all(), "what has no height has no error of it"


@pytest.mark.parametrize("order", ["call cloud", "cloud call", "call cloud grid", "cloud call grid", "cloud grid call"])
def test_errors_are_those_of_the_pairs_that_the_fusion_names(order: str) -> None:
    """Two pairs of a map before are received first: the cloud of the third pair alone is compared with its own."""
    state, truth = LiveState(), ground()
    feed = MapFeed(state, lambda: "grid" in order)
    for number, height_m in enumerate((5.0, 7.0, 0.0)):
        feed.add_true_points(bag_messages.points(STAMP_NS + number, truth + np.float32([0, 0, height_m]), None), 0.0)
    stamp_ns = STAMP_NS + 2
    messages = {
        "call": lambda: feed.add_call(fusion(stamp_ns)),
        "cloud": lambda: feed.add_cloud(sent(cloud_msg(estimated(truth), stamp_ns, "lm")), 0.0),
        "grid": lambda: feed.add_elevation(sent(elevation_msg(terrain(), stamp_ns, "lm")), 0.0),
    }
    for name in order.split():
        messages[name]()
    grid = state.media["mapping/elevation"]
    assert isinstance(grid, ElevationSample)
    assert 0.0 < np.nanmax(grid.layers[..., grid.names.index("error")]) < 0.04


def test_the_map_of_a_cloud_has_no_error_before_its_pairs_are_named() -> None:
    state, truth = LiveState(), ground()
    feed = MapFeed(state, lambda: False)
    feed.add_true_points(bag_messages.points(STAMP_NS, truth, None), 0.0)
    feed.add_cloud(sent(cloud_msg(estimated(truth), STAMP_NS, "lm")), 0.0)
    feed.add_call(fusion(STAMP_NS + 1))
    grid = state.media["mapping/elevation"]
    assert isinstance(grid, ElevationSample)
    assert np.isnan(grid.layers[..., grid.names.index("error")]).all()


def test_broken_grids_are_refused() -> None:
    message = elevation_msg(terrain(), STAMP_NS, "lm")
    for name, value in (("width", 25), ("point_step", 16), ("fields", []), ("height", 10**6)):
        broken = sent(message)
        setattr(broken, name, value)
        with pytest.raises(SfrError):
            elevation_from_msg(broken)
    for last in (0.0, 3e38):
        cells = np.zeros((24, 24, 8), np.float32)
        cells[:, :12, 0], cells[:, 12:, 0] = -last, last
        message.data = byte_array(cells)
        with pytest.raises(InputError, match="are required"):
            MapFeed(LiveState(), lambda: True).add_elevation(sent(message), 0.0)
