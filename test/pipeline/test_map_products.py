"""Files of maps are read back by independent readers."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.cloud_file import load_cloud
from sfr_loc_map.mapping.terrain.elevation import ElevationModel
from sfr_loc_map.pipeline import map_products


@pytest.fixture
def ramp() -> ElevationModel:
    """A ramp that rises along x, with a hole."""
    height = np.repeat(np.linspace(0.0, 1.0, 40, dtype=np.float32)[None], 30, axis=0)
    height[10:20, 10:20] = np.nan
    known = np.isfinite(height)
    return ElevationModel(height, np.full_like(height, 0.01), known.astype(np.int32), (-1.0, 2.0), 0.1)


def test_elevation_model_is_read_back(ramp: ElevationModel, tmp_path: Path) -> None:
    map_products.save_elevation(tmp_path / "a.npz", ramp)
    with np.load(tmp_path / "a.npz") as read:
        np.testing.assert_array_equal(read["height_m"], ramp.height_m)
        np.testing.assert_array_equal(read["sigma_m"], ramp.sigma_m)
        np.testing.assert_array_equal(read["count"], ramp.count)
        assert read["origin_m"].tolist() == [-1.0, 2.0]
        assert float(read["cell_m"]) == 0.1


def test_image_is_dark_in_holes_and_brighter_with_height(ramp: ElevationModel, tmp_path: Path) -> None:
    map_products.save_elevation_figure(tmp_path / "a.png", ramp)
    image = cv2.imread(str(tmp_path / "a.png"))
    assert image is not None
    assert image.shape[0] in range(28, 31)
    assert (image[image.shape[0] // 2, 15] == map_products.VOID).all()
    assert image[2, -3].sum() > image[2, 3].sum()


def test_coloured_ply_has_the_points_and_colours(tmp_path: Path) -> None:
    xyz = np.array([[0, 0, 0], [1, 0, 1], [2, 0, 2], [3, 1, 3]], np.float32)
    ones = np.ones(4, np.float32)
    pixel = np.zeros(4, np.uint16)
    cloud = PointCloud(xyz, 0.1 * ones, 100 * ones, pixel, pixel, np.zeros(4, np.uint8))
    path = tmp_path / "c.ply"
    map_products.save_coloured_ply(path, cloud)
    np.testing.assert_array_equal(load_cloud(path).xyz, xyz)
    data = path.read_bytes()
    assert b"property uchar red" in data
    body = np.frombuffer(data[data.index(b"end_header\n") + 11 :], map_products.COLOURED_TYPE)
    assert body["red"][3] > body["red"][1]  # the map of colours ends in yellow
    assert body["blue"][3] < body["blue"][1]
