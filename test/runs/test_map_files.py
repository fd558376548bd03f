"""Files of maps are read back by independent readers: every format holds the same grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.mapping.config import TerrainConfig
from sfr_loc_map.mapping.terrain.terrain_grid import terrain_grid
from sfr_loc_map.runs import map_files

rasterio = pytest.importorskip("rasterio", reason="extra dem")

LAYERS = {"height": "height_m", "sigma": "sigma_m", "count": "count", "slope": "slope_rad"}
LAYERS |= {"roughness": "roughness_m", "step": "step_m", "hazard": "hazard"}


def made_cloud() -> PointCloud:
    """Return a ramp that rises along x with a block on it and a hole, in LM."""
    rng = np.random.default_rng(2)
    xy = rng.uniform((-1.0, 2.0), (2.0, 4.0), (20000, 2))
    xy = xy[~((np.abs(xy[:, 0] - 1.0) < 0.3) & (np.abs(xy[:, 1] - 3.0) < 0.3))]
    z = 0.2 * xy[:, 0] + 0.4 * ((xy[:, 0] > 0.0) & (xy[:, 0] < 0.3))
    xyz = np.column_stack((xy, z)).astype(np.float32)
    pixel, sigma = np.zeros(len(xyz), np.uint16), np.full(len(xyz), 0.01, np.float32)
    return PointCloud(xyz, sigma, 100 * sigma, pixel, pixel, np.zeros(len(xyz), np.uint8))


@pytest.mark.parametrize("names", [("a.tif", "a.npz"), ("A.TIFF", "A.NPZ")])
def test_geotiff_and_archive_hold_the_grid_itself(tmp_path: Path, names: tuple[str, str]) -> None:
    grid = terrain_grid(made_cloud(), TerrainConfig())
    for name in names:
        map_files.save_dem(tmp_path / name, grid)
    read = np.load(tmp_path / names[1])
    with rasterio.open(tmp_path / names[0]) as file:
        assert (file.driver, file.descriptions, set(file.dtypes)) == ("GTiff", tuple(LAYERS), {"float32"})
        assert np.isnan(file.nodata)
        assert 'LOCAL_CS["lm"' in file.crs.to_wkt()
        assert file.units[:4] == ("m", "m", "points", "rad")
        bands = {name: file.read(index + 1)[::-1] for index, name in enumerate(LAYERS)}
        assert file.index(-0.95, 2.05) == (grid.hazard.shape[0] - 1, 0)  # the cell with the least x and y
    bands["hazard"][np.isnan(bands["hazard"])] = -1
    for name, array in LAYERS.items():
        np.testing.assert_array_equal(bands[name], read[array].astype(np.float32))
    np.testing.assert_array_equal(read["height_m"], grid.elevation.height_m)
    np.testing.assert_array_equal(read["hazard"], grid.hazard)
    assert (grid.hazard == 100).any()
    assert np.isnan(bands["height"]).any()
    assert read["origin_m"].tolist() == pytest.approx([-1.0, 2.0])
