"""Pairs whose images are not all there."""

from __future__ import annotations

from pathlib import Path

import pytest
from made_scene import write_folder
from test_euroc import write_euroc
from test_kitti import write_kitti

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.registry import open_source


@pytest.mark.parametrize("name", ["kitti", "euroc", "folder"])
def test_a_pair_without_its_image_is_left_out_and_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str
) -> None:
    path = {"kitti": write_kitti, "euroc": write_euroc, "folder": lambda folder: write_folder(folder, 3, 0)}[name](
        tmp_path / name
    )
    files = sorted(path.rglob("*.png"))
    files[0].unlink()
    source = open_source(path)
    assert source.left_out == 1
    (record,) = caplog.records
    assert f"1 of {len(source.loc) + 1} pairs left out, images are not there: {files[0]}" in record.getMessage()
    assert len(list(source.loc.pairs())) == len(source.loc) > 0
    for file in files[1:]:
        file.unlink()
    with pytest.raises(InputError, match=r"names images that are not there: .*; restore them"):
        open_source(path)
