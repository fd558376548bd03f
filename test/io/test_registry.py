"""Broken sources of every layout of files are one error, in one line that names the file."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers import made_layouts as made
from helpers.made_worlds import make_world, write_bag, write_folder
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.calibration.rig_file import rig_json
from sfr_loc_map.io.registry import format_of, open_source
from sfr_loc_map.io.source_config import CalibrationConfig, ExtrinsicsConfig, FramesConfig, SourceConfig, SyncConfig
from sfr_loc_map.io.source_format import SourceFormat
from sfr_loc_map.io.truth.config import TruthConfig
from sfr_loc_map.suite_names import SIDES

LAYOUTS: dict[str, Callable[[Path], Path]] = {
    "folder": lambda path: write_folder(path, make_world()),
    "kitti": made.write_kitti,
    "euroc": made.write_euroc,
}
ALL = ""
"""The whole text is replaced."""
BASELINE = '"baseline_m": 0.12'
CAM0, CAM1 = "mav0/cam0/data.csv", "mav0/cam1/sensor.yaml"
BROKEN = [
    ("folder", "loc/rig.json", BASELINE, f'{BASELINE}, "baseline": 1', "unknown field `baseline`"),
    ("folder", "loc/rig.json", "20.1,", "", r"length 9 - at `\$.k`"),
    ("folder", "loc/rig.json", "7.9", "1e300", "principal point"),
    ("folder", "loc/rig.json", BASELINE, '"baseline_m": 12.0', "baseline is 12 m"),
    ("folder", "loc/pairs.csv", ",right/000003.png", "", "line 5 has 2 columns"),
    ("folder", "loc/pairs.csv", "1700000000000000001", "1700000000999999999", "in increasing order"),
    ("folder", "loc/pairs.csv", "\n17", "\n1_7", "line 2: stamp"),
    ("folder", "nav/pairs.csv", "-0.035", "1e308", "line 3: "),
    ("folder", "nav/pairs.csv", ALL, "stamp_ns,left,right\n1,left/000000.png,right/000000.png\n", "no poses of"),
    ("kitti", "times.txt", ALL, "0\nx\n", "line 2: stamp 'x' is not a number of seconds"),
    ("kitti", "poses.txt", ALL, "1 0 0 0 0 1 0 0 0 0 1 0\n", "1 poses for 3 times"),
    ("kitti", "calib.txt", "P1:", "Q1:", r"P0 and P1 are required"),
    ("kitti", "calib.txt", "-3.78", "3.78", "swapped"),
    ("kitti", "calib.txt", "-3.78e+02", "-3.78e+03", "baseline is 5.4 m"),
    ("euroc", CAM1, "0.16", "11.05", "baseline is 11 m"),
    ("euroc", CAM1, "radial-tangential", "equidistant", "equidistant"),
    ("euroc", CAM1, "0.16", "-0.16", "swapped"),
    ("euroc", CAM1, "0.16, 0.0, 1.0, 0.0, -0.02", "0.05, 0.0, 1.0, 0.0, 0.2", "one above the other"),
    ("euroc", CAM0, ALL, "#x\n12,a.png\n", "has a stamp within"),
    ("euroc", CAM0, ALL, "#x\n12,a.png\n12,b.png\n", "in increasing order"),
]


@pytest.mark.parametrize(("layout", "file", "old", "new", "words"), BROKEN)
def test_a_broken_text_is_one_error(tmp_path: Path, layout: str, file: str, old: str, new: str, words: str) -> None:
    folder = LAYOUTS[layout](tmp_path / "a")
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(new if old is ALL else text.replace(old, new, 1))
    with pytest.raises(InputError, match=f"^[^\n]*{tmp_path}[^\n]*{words}[^\n]*$"):
        open_source(folder)


@pytest.mark.parametrize("layout", [*LAYOUTS, "images"])
@pytest.mark.parametrize("name", ["truth.mcap", "truth.db3"])
def test_a_bag_in_the_folder_of_another_layout_does_not_make_it_a_bag(tmp_path: Path, layout: str, name: str) -> None:
    folder = tmp_path / "a"
    if layout in LAYOUTS:
        LAYOUTS[layout](folder)
    else:
        for side in ("left", "right"):
            (folder / side).mkdir(parents=True)
            (folder / side / "1700000000000000000.png").touch()
    expected = format_of(folder)
    (folder / name).write_bytes(b"")
    assert format_of(folder) is expected is not SourceFormat.BAG


@pytest.mark.parametrize("name", ["truth.mcap", "truth.db3"])
def test_a_folder_with_the_name_of_a_bag_is_not_a_bag(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir(parents=True)
    with pytest.raises(InputError, match="has no supported format"):
        format_of(tmp_path)


def test_images_of_other_formats_are_named(tmp_path: Path) -> None:
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        (tmp_path / side / "1700000000000000000.bmp").write_bytes(b"BM")
    with pytest.raises(InputError, match=r"left/ and right/ .*found \.bmp"):
        format_of(tmp_path)


def test_further_columns_of_a_list_of_euroc_are_ignored(tmp_path: Path) -> None:
    folder = LAYOUTS["euroc"](tmp_path / "a")
    count = len(open_source(folder).loc)
    file = folder / CAM0
    file.write_text("".join(f"{line},0.01\n" for line in file.read_text().splitlines()))
    assert len(open_source(folder).loc) == count


def test_blank_lines_of_a_list_of_pairs_are_ignored(tmp_path: Path) -> None:
    folder = LAYOUTS["folder"](tmp_path / "a")
    count = len(open_source(folder).loc)
    file = folder / "loc" / "pairs.csv"
    file.write_text(file.read_text().replace("\n", "\n\n") + " \n")
    assert len(open_source(folder).loc) == count


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_pair_without_its_image_is_left_out_and_counted(tmp_path: Path, layout: str) -> None:
    path = LAYOUTS[layout](tmp_path / "a")
    files = sorted(file for file in path.rglob("*.png") if "nav" not in file.parts)
    files[-1].unlink()
    source = open_source(path)
    assert source.skipped_pairs == 1
    assert len(list(source.loc.pairs())) == len(source.loc) > 0
    for file in files[:-1]:
        file.unlink()
    with pytest.raises(InputError, match=r"lists missing images: .*; restore them|has a stamp within|has no image"):
        open_source(path)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_settings_that_do_not_apply_to_a_layout_are_reported(
    tmp_path: Path, layout: str, caplog: pytest.LogCaptureFixture
) -> None:
    folder = LAYOUTS[layout](tmp_path / "a")
    open_source(folder, SourceConfig())
    assert "ignored" not in caplog.text
    sync = SyncConfig(stamps="record", stamp_tolerance_s=0.004)
    open_source(folder, SourceConfig(calibration=CalibrationConfig(baseline_m=0.2), sync=sync))
    names = {"euroc": "sync.stamps, calibration.baseline_m"}
    assert "ignored: " + names.get(layout, "sync.stamp_tolerance_s, sync.stamps, calibration.baseline_m") in caplog.text
    given = SourceConfig(
        topics={"loc/left/image_rect": "/a"},
        frames=FramesConfig(base="foo"),
        truth=TruthConfig(frame="map:base_link", stamps="record", columns="t,x,y,z"),
    )
    open_source(folder, given)
    assert "ignored: topics.loc/left/image_rect, frames.base, truth.frame, truth.stamps, truth.columns" in caplog.text


def test_settings_of_a_truth_in_another_file_are_those_of_its_kind(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = made.write_kitti(tmp_path / "a")
    (tmp_path / "truth.txt").write_text("0.0 1 2 3\n0.1 1 2 3\n0.2 1 2 3\n")
    truth = TruthConfig(source=str(tmp_path / "truth.txt"), frame="map:base_link", columns="t[s],x,y,z")
    open_source(folder, SourceConfig(truth=truth))
    assert "ignored: truth.frame" in caplog.text
    assert "columns" not in caplog.text


@pytest.mark.parametrize("factor", [0.5, 2.5])
def test_a_calibration_of_kitti_for_images_of_another_size_is_refused(tmp_path: Path, factor: float) -> None:
    folder = made.write_kitti(tmp_path / "a")
    for file in folder.rglob("*.png"):
        cv2.imwrite(str(file), cv2.resize(cv2.imread(str(file)), None, fx=factor, fy=factor))
    with pytest.raises(InputError, match=r"principal point is .* scale the calibration"):
        open_source(folder)


def write_images(path: Path, rig: StereoRig) -> tuple[Path, SourceConfig]:
    """Write a folder of images and a separate calibration; return the folder and its configuration."""
    for side in SIDES:
        (path / side).mkdir(parents=True)
        cv2.imwrite(str(path / side / "1700000000000000000.png"), np.zeros((rig.height, rig.width), np.uint8))
    file = path.with_suffix(".json")
    file.write_text(rig_json(rig))
    return path, SourceConfig(calibration=CalibrationConfig(file=str(file)))


SOURCES: dict[str, Callable[[Path], tuple[Path, SourceConfig]]] = {
    **{name: lambda path, write=write: (write(path), SourceConfig()) for name, write in LAYOUTS.items()},  # type: ignore[misc]
    "images": lambda path: write_images(path, make_world().loc_rig),
    "bag": lambda path: (write_bag(path.with_suffix(".mcap"), make_world()), SourceConfig()),
}


@pytest.mark.parametrize("layout", SOURCES)
def test_extrinsics_of_the_source_itself_are_no_changed_reading(tmp_path: Path, layout: str) -> None:
    path, config = SOURCES[layout](tmp_path / "a")
    source = open_source(path, config)
    assert source.config is config
    assert source.loc is not None
    own = source.loc.rig.T_rb_sb
    assert own is not None
    for turn, is_changed in ((0.0, False), (0.1, True)):
        pose = own @ Transform(matrix_from_rotvec([0.0, 0.0, turn]), np.zeros(3))
        extrinsics = ExtrinsicsConfig(tuple(pose.translation.tolist()), tuple(pose.quat_xyzw.tolist()))
        given = open_source(path, replace(config, extrinsics=extrinsics))
        assert any(name.startswith("extrinsics.") for name in given.changed_reading) == is_changed


@pytest.mark.parametrize("layout", ["folder", "images"])
@pytest.mark.parametrize(("baseline_m", "is_reported"), [(0.4, False), (1.2, True), (4.0, True)])
def test_a_baseline_that_may_be_in_another_unit_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, layout: str, baseline_m: float, is_reported: bool
) -> None:
    if layout == "images":
        open_source(*write_images(tmp_path / "a", StereoRig(64, 48, 60.0, 60.0, 31.5, 23.5, baseline_m)))
    else:
        folder = write_folder(tmp_path / "a", make_world(), nav=False)
        rig = json.loads((folder / "rig.json").read_text())
        (folder / "rig.json").write_text(json.dumps({**rig, "baseline_m": baseline_m}))
        open_source(folder)
    assert (f"baseline of the localisation cameras is {baseline_m:g} m" in caplog.text) == is_reported
