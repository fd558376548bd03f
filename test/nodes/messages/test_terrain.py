# ruff: noqa: E402 - ROS may be absent
import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from scenes import sent

from sfr_loc_map.mapping.terrain.elevation import ElevationModel
from sfr_loc_map.mapping.terrain.grid import TerrainGrid
from sfr_loc_map.nodes.messages.terrain import ELEVATION_FIELDS, elevation_msg, hazard_msg

STAMP_NS = 1_700_000_000_123_456_789


def test_grids_come_out_as_they_went_in() -> None:
    rng = np.random.default_rng(2)
    layers = rng.normal(size=(5, 3, 4)).astype(np.float32)
    layers[:, 1, 2] = np.nan
    count, hazard = np.arange(12, dtype=np.int32).reshape(3, 4), np.arange(-1, 11, dtype=np.int8).reshape(3, 4)
    hazard[2, 3] = 100
    model = ElevationModel(layers[0], layers[1], count, (-0.4, 1.2), 0.2)
    grid = TerrainGrid(model, layers[2], layers[3], layers[4], hazard)
    cloud = sent(elevation_msg(grid, STAMP_NS, "lm"))
    assert [field.name for field in cloud.fields] == list(ELEVATION_FIELDS)
    assert (cloud.height, cloud.width, cloud.header.frame_id, cloud.is_dense) == (3, 4, "lm", False)
    found = np.frombuffer(cloud.data, "<f4").reshape(3, 4, 8)
    np.testing.assert_allclose(found[0, :, 0], [-0.3, -0.1, 0.1, 0.3], atol=1e-6)
    np.testing.assert_allclose(found[:, 0, 1], [1.3, 1.5, 1.7], atol=1e-6)
    assert np.array_equal(found[..., 2:7], np.moveaxis(layers, 0, -1), equal_nan=True)
    assert np.array_equal(found[..., 7], count)
    message = sent(hazard_msg(grid, STAMP_NS, "lm"))
    assert (message.info.height, message.info.width) == (3, 4)
    assert message.info.resolution == pytest.approx(0.2)
    assert (message.info.origin.position.x, message.info.origin.position.y) == pytest.approx((-0.4, 1.2))
    assert list(message.data) == hazard.reshape(-1).tolist()
