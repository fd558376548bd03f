"""`sfr map`: the files beside the cloud."""

from pathlib import Path

import numpy as np
import pytest

from helpers.broken_sources import good_folder
from helpers.cli_result import Sfr
from sfr_loc_map.io.clouds.cloud_file import load_cloud

rasterio = pytest.importorskip("rasterio", reason="extra dem")


def test_products_lie_beside_the_cloud(sfr: Sfr, tmp_path: Path) -> None:
    source = good_folder(tmp_path / "data")
    cloud = tmp_path / "c.ply"
    more = [word for name in ("x.tif", "c.dem.npz", "c.dem.png") for word in ("--dem", tmp_path / name)]
    result = sfr("map", source, "-o", cloud, *more, "--covariance")
    assert (result.code, result.out) == (0, "")
    points = len(load_cloud(cloud).xyz)
    assert np.load(tmp_path / "c.covariance.npz")["covariance_m2"].shape == (points, 3, 3)
    assert int(np.load(tmp_path / "c.dem.npz")["count"].sum()) == points
    for name in ("c.dem.png", "x.tif"):
        assert (tmp_path / name).stat().st_size > 0
        assert str(tmp_path / name) in result.err
    _same_heights(tmp_path / "x.tif", tmp_path / "c.dem.npz")
    assert sfr("convert", cloud, tmp_path / "y.ply").code == 0
    np.testing.assert_allclose(load_cloud(tmp_path / "y.ply").xyz, load_cloud(cloud).xyz, atol=1e-6)


def _same_heights(tif: Path, archive: Path) -> None:
    with rasterio.open(tif) as file:
        np.testing.assert_array_equal(file.read(1)[::-1], np.load(archive)["height_m"])
        assert file.res[0] == pytest.approx(float(np.load(archive)["cell_m"]))
