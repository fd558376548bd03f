"""Files of maps are read back by independent readers."""

from pathlib import Path

import numpy as np

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.cloud_file import load_cloud
from sfr_loc_map.pipeline.map_files import COLOURED_TYPE, save_coloured_ply


def test_coloured_ply_has_the_points_and_colours(tmp_path: Path) -> None:
    xyz = np.array([[0, 0, 0], [1, 0, 1], [2, 0, 2], [3, 1, 3]], np.float32)
    ones = np.ones(4, np.float32)
    pixel = np.zeros(4, np.uint16)
    cloud = PointCloud(xyz, 0.1 * ones, 100 * ones, pixel, pixel, np.zeros(4, np.uint8))
    path = tmp_path / "c.ply"
    save_coloured_ply(path, cloud)
    np.testing.assert_array_equal(load_cloud(path).xyz, xyz)
    data = path.read_bytes()
    assert b"property uchar red" in data
    body = np.frombuffer(data[data.index(b"end_header\n") + 11 :], COLOURED_TYPE)
    assert body["red"][3] > body["red"][1]  # the map of colours ends in yellow
    assert body["blue"][3] < body["blue"][1]
