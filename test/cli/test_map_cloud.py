"""`sfr map` and what comes with the cloud."""

from pathlib import Path

import numpy as np
import pytest
from broken_sources import good_folder
from cli_result import Sfr

from sfr_loc_map.io.cloud_file import load_cloud
from sfr_loc_map.io.registry import open_source

rasterio = pytest.importorskip("rasterio", reason="extra dem")


def test_products_lie_beside_the_cloud(sfr: Sfr, tmp_path: Path) -> None:
    source = good_folder(tmp_path / "data")
    cloud = tmp_path / "c.ply"
    more = [word for name in ("x.tif", "x.html", "c.dem.npz", "c.dem.png") for word in ("--dem", tmp_path / name)]
    result = sfr("map", source, "-o", cloud, *more, "--covariance")
    assert (result.code, result.out) == (0, "")
    points = len(load_cloud(cloud).xyz)
    assert np.load(tmp_path / "c.covariance.npz")["covariance_m2"].shape == (points, 3, 3)
    assert int(np.load(tmp_path / "c.dem.npz")["count"].sum()) == points
    for name in ("c.dem.png", "x.tif", "x.html"):
        assert (tmp_path / name).stat().st_size > 0
        assert str(tmp_path / name) in result.err
    _same_heights(tmp_path / "x.tif", tmp_path / "c.dem.npz")
    for name in ("y.tif", "y.dem.npz", "y.png"):
        assert sfr("convert", cloud, tmp_path / name, "--cell", "0.2").code == 0
    _same_heights(tmp_path / "y.tif", tmp_path / "y.dem.npz")
    assert sfr("convert", cloud, tmp_path / "y.ply").code == 0
    np.testing.assert_allclose(load_cloud(tmp_path / "y.ply").xyz, load_cloud(cloud).xyz, atol=1e-6)


def test_a_drive_is_exported_without_its_mapping_pairs(sfr: Sfr, tmp_path: Path) -> None:
    source = good_folder(tmp_path / "data")
    result = sfr("convert", source, tmp_path / "k", "--to", "kitti")
    assert result.code == 0
    assert "mapping pairs" in result.err
    assert (tmp_path / "k" / "calib.txt").is_file()
    assert open_source(tmp_path / "k").format == "kitti"
    for words, said in (
        (("convert", source, tmp_path / "x.mcap", "--to", "euroc"), "is the name of a bag"),
        (("convert", source, tmp_path / "x", "--cell", "0.1"), "'--cell' is of the elevation model of a cloud"),
    ):
        refused = sfr(*words)
        assert (refused.code, said in refused.err) == (2, True)


def _same_heights(tif: Path, archive: Path) -> None:
    with rasterio.open(tif) as file:
        np.testing.assert_array_equal(file.read(1)[::-1], np.load(archive)["height_m"])
        assert file.res[0] == pytest.approx(float(np.load(archive)["cell_m"]))
