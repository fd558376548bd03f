"""Grids as messages."""

import numpy as np
from scenes import sent

from sfr_loc_map.mapping.terrain.elevation import ElevationModel
from sfr_loc_map.mapping.terrain.grid import TerrainGrid
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
