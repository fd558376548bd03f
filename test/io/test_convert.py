"""Conversion of any source to bags, folders and layouts of others, and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.made_worlds import (
    World,
    assert_is_world,
    assert_same_pairs,
    assert_same_trajectory,
    make_world,
    write_folder,
)
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.convert import ConvertOptions, Layout, convert, convert_trajectory
from sfr_loc_map.io.registry import open_source, read_truth
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import trajectory_text


@pytest.fixture
def world() -> World:
    return make_world()


@pytest.mark.parametrize("name", ["x.mcap", "x.db3", "x.bag"])
def test_folder_to_bag_to_folder_gives_the_same_files(tmp_path: Path, world: World, name: str) -> None:
    folder = write_folder(tmp_path / "a", world)
    done: list[int] = []
    assert convert(open_source(folder), tmp_path / name, progress=done.append) == 6
    assert (done[-1], done) == (6, sorted(done))
    assert convert(open_source(tmp_path / name), tmp_path / "b") == 6
    assert_is_world(open_source(tmp_path / "b"), world)
    assert hash_path(tmp_path / "a") == hash_path(tmp_path / "b")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["a", "b", name])


def test_nothing_is_left_when_the_source_breaks(tmp_path: Path, world: World) -> None:
    folder = write_folder(tmp_path / "a", world, nav=False)
    (folder / "left" / "000002.png").write_bytes(b"broken")
    for name in ("x.mcap", "x.db3", "copy"):
        with pytest.raises(InputError, match=r"000002\.png"):
            convert(open_source(folder), tmp_path / name)
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("x.db3", ConvertOptions(zstd=True), "mcap"),
        ("x.mcap", ConvertOptions(jpeg_quality=0), "1 to 100"),
        ("x.mcap", ConvertOptions(truth_grid_m=0.1), "power of two"),
        ("folder", ConvertOptions(jpeg_quality=90), "apply only to bags"),
        ("k", ConvertOptions(layout=Layout.KITTI, jpeg_quality=90), "apply only to bags"),
        ("k.mcap", ConvertOptions(layout=Layout.EUROC), "the name of a bag"),
        ("nav", ConvertOptions(layout=Layout.KITTI), "has no drive"),
        *((f"x{end}", ConvertOptions(), f"no file that ends in {end} is written") for end in (".ply", ".zip", ".json")),
        ("x.ply", ConvertOptions(layout=Layout.KITTI), "no file that ends in .ply is written"),
    ],
)
def test_options_that_do_not_fit(tmp_path: Path, world: World, name: str, options: ConvertOptions, words: str) -> None:
    source = open_source(write_folder(tmp_path / "a", world, loc=name != "nav"))
    with pytest.raises(OutputError, match=words):
        convert(source, tmp_path / name, options)
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_options_of_the_command_and_trajectories(tmp_path: Path, world: World, sfr: Sfr) -> None:
    folder, bag, tum = write_folder(tmp_path / "a", world), tmp_path / "x.mcap", tmp_path / "t.tum"
    options = ("--compression", "zstd", "--jpeg-quality", "90", "--truth-grid", "0.0009765625")
    assert sfr("convert", folder, bag, *options).code == 0
    assert "/loc/left/image_rect/compressed" in Bag(bag).topics
    nav = open_source(bag).nav
    truth = next(nav.pairs()).truth
    assert not np.mod(truth[1:], 2.0**-10).any()
    wrong = sfr("convert", bag, tmp_path / "y", "--remap", "a:=b")
    assert (wrong.code, "no topic 'a'" in wrong.err) == (2, True)

    assert sfr("convert", folder, tum).code == sfr("convert", tum, tmp_path / "t").code == 0
    assert_same_trajectory(read_trajectory_file(tum).trajectory, world.truth)
    assert_same_trajectory(read_trajectory_file(tmp_path / "t" / "groundtruth.csv").trajectory, world.truth)
    assert convert_trajectory(world.truth, tmp_path / "t.mcap") == 4
    assert_same_trajectory(read_truth(tmp_path / "t.mcap"), world.truth)
    no_table = sfr("convert", tum, tmp_path / "t.gz")
    assert (no_table.code, "no file that ends in .gz is written" in no_table.err) == (2, True)
    no_truth = sfr("convert", write_folder(tmp_path / "n", world, loc=False), tmp_path / "n.txt")
    assert (no_truth.code, "has no true poses" in no_truth.err) == (2, True)


def exported(world: World, folder: Path, layout: Layout) -> LocSequence:
    convert(open_source(write_folder(folder / "a", world)), folder / "b", ConvertOptions(layout=layout))
    source = open_source(folder / "b")
    assert (source.format, source.nav) == (layout.value, None)
    assert_same_pairs(source.loc.pairs(), world.pairs)
    assert source.loc.rig.same_cameras(world.loc_rig)
    return source.loc


@pytest.mark.parametrize("layout", list(Layout))
@pytest.mark.parametrize("seed", range(3))
def test_other_layouts_keep_images_stamps_rig_and_the_motion_of_the_rig(
    tmp_path: Path, seed: int, layout: Layout
) -> None:
    world = make_world(seed=seed)
    loc, T_rb_sb = exported(world, tmp_path, layout), world.loc_rig.T_rb_sb
    truth = loc.ground_truth
    if layout is Layout.EUROC:
        np.testing.assert_allclose(loc.rig.T_rb_sb.matrix, T_rb_sb.matrix, atol=1e-14)
        assert_same_trajectory(truth, world.truth)
        return
    assert truth.stamps_ns.tolist() == world.truth.stamps_ns.tolist()
    rigs = [world.truth.pose(i) @ T_rb_sb for i in range(len(truth))]
    for i, rig in enumerate(rigs):  # DS of KITTI is the rig at its first pose
        np.testing.assert_allclose(truth.pose(i).matrix, (rigs[0].inverse() @ rig).matrix, atol=1e-12)


@pytest.mark.parametrize("layout", list(Layout))
def test_without_extrinsics_the_truth_is_left_out(
    tmp_path: Path, world: World, caplog: pytest.LogCaptureFixture, layout: Layout
) -> None:
    world = replace(world, loc_rig=replace(world.loc_rig, T_rb_sb=None))
    assert exported(world, tmp_path, layout).ground_truth is None
    (record,) = caplog.records
    assert "T_rb_locsb" in record.getMessage()


def test_the_lever_arm_of_a_truth_without_attitudes_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    prism = Truth(np.array([0, 10**9]), np.eye(3)[:2], np.zeros((2, 4)), lever_arm_m=(0.3, 0.0, 1.1))
    convert_trajectory(prism, tmp_path / "prism.csv")
    assert "a body at [0.3, 0.0, 1.1] m in the frame of the rover" in caplog.text


def test_the_accuracy_and_unknown_components_of_a_truth_are_reported(
    tmp_path: Path, world: World, caplog: pytest.LogCaptureFixture
) -> None:
    exact = world.truth
    poses = exact.stamps_ns, exact.positions, exact.quats_xyzw
    convert_trajectory(Truth(*poses), tmp_path / "exact.csv")
    assert not caplog.records
    convert_trajectory(Truth(*poses, sigma_m=0.02, has_height=False), tmp_path / "planar.csv")
    assert "truth.sigma_m=0.02 and truth.unknown=height" in caplog.text


def test_a_truth_file_in_any_order_is_written_in_order(tmp_path: Path, world: World) -> None:
    header, *rows = trajectory_text(world.truth).splitlines()
    (tmp_path / "t.csv").write_text("\n".join([header, *reversed(rows)]) + "\n")
    config = SourceConfig.of(Configuration(None, {"truth": {"source": str(tmp_path / "t.csv")}}))
    convert(open_source(write_folder(tmp_path / "a", world), config), tmp_path / "b")
    assert_same_trajectory(open_source(tmp_path / "b").loc.ground_truth, world.truth)


@pytest.mark.parametrize("layout", [None, Layout.EUROC])
def test_a_stray_stamp_in_the_truth_of_a_folder_is_ignored(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, layout: Layout | None
) -> None:
    source = open_source(write_folder(tmp_path / "a", make_world(count=12), nav=False))
    convert(source, tmp_path / "b", ConvertOptions(layout=layout))
    (file,) = [file for file in (tmp_path / "b").rglob("*.csv") if "groundtruth" in str(file.relative_to(tmp_path))]
    lines = file.read_text().splitlines()
    lines[6] = "0," + lines[6].partition(",")[2]
    file.write_text("\n".join(lines) + "\n")
    assert len(open_source(tmp_path / "b").loc.ground_truth) == 11
    assert "1 of 12 poses have stamps that are 0" in caplog.text


def test_kitti_poses_are_omitted_if_the_truth_has_no_attitudes(
    tmp_path: Path, world: World, caplog: pytest.LogCaptureFixture
) -> None:
    truth = world.truth
    positions = Trajectory(truth.stamps_ns, truth.positions, np.zeros((len(truth), 4)))
    assert exported(replace(world, truth=positions), tmp_path, Layout.KITTI).ground_truth is None
    assert "poses.txt is omitted: the truth has no attitudes" in caplog.text
