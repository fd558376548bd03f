"""Conversion of any source to bags, folders and layouts of others, and back."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "io"))

from made_worlds import World, assert_is_world, assert_same_pairs, assert_same_trajectory, make_world, write_folder

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.inputs import hash_path
from sfr_loc_map.io.bag import GROUND_TRUTH, Bag, read_trajectory
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.io.trajectory_file import load_trajectory
from sfr_loc_map.pipeline.convert import ConvertOptions, Layout, convert, convert_trajectory

EXACT = ConvertOptions()


@pytest.fixture
def world() -> World:
    return make_world()


@pytest.mark.parametrize("name", ["x.mcap", "x.db3", "x.bag"])
def test_folder_to_bag_to_folder_gives_the_same_files(tmp_path: Path, world: World, name: str) -> None:
    folder = write_folder(tmp_path / "a", world)
    done: list[int] = []
    assert convert(open_source(folder), tmp_path / name, EXACT, done.append) == 6
    assert done[-1] == 6
    assert done == sorted(done)
    assert convert(open_source(tmp_path / name), tmp_path / "b", EXACT) == 6
    assert_is_world(open_source(tmp_path / "b"), world)
    assert hash_path(tmp_path / "a") == hash_path(tmp_path / "b")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["a", "b", name])


def test_nothing_is_left_when_the_source_breaks(tmp_path: Path, world: World) -> None:
    folder = write_folder(tmp_path / "a", world, nav=False)
    (folder / "left" / "000002.png").write_bytes(b"broken")
    for name in ("x.mcap", "x.db3", "copy"):
        with pytest.raises(InputError, match=r"000002\.png"):
            convert(open_source(folder), tmp_path / name, EXACT)
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_what_is_there_is_not_overwritten(tmp_path: Path, world: World) -> None:
    source = open_source(write_folder(tmp_path / "a", world))
    (tmp_path / "x.mcap").write_text("precious")
    for name in ("a", "x.mcap"):
        with pytest.raises(OutputError, match="cannot write"):
            convert(source, tmp_path / name, EXACT)
    assert (tmp_path / "x.mcap").read_text() == "precious"


def test_options_that_do_not_fit(tmp_path: Path, world: World) -> None:
    source = open_source(write_folder(tmp_path / "a", world))
    for name, options in (
        ("x.db3", ConvertOptions(zstd=True)),
        ("x.mcap", ConvertOptions(jpeg_quality=0)),
        ("folder", ConvertOptions(jpeg_quality=90)),
        ("x.mcap", ConvertOptions(truth_grid_m=0.1)),
    ):
        with pytest.raises(OutputError):
            convert(source, tmp_path / name, options)
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def convert_command(*words: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "import sys; from sfr_loc_map.cli.main import main; sys.exit(main())", "convert"]
    return subprocess.run([*command, *map(str, words)], capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_command_line(tmp_path: Path, world: World) -> None:
    folder = write_folder(tmp_path / "a", world)
    made = convert_command(
        folder, tmp_path / "x.mcap", "--compression", "zstd", "--jpeg-quality", "90", "--truth-grid", "0.0009765625"
    )
    assert (made.returncode, made.stdout) == (0, "")
    assert "/loc/left/image_rect/compressed" in Bag(tmp_path / "x.mcap").topics
    nav = open_source(tmp_path / "x.mcap").nav
    assert nav is not None
    truth = next(nav.pairs()).truth
    assert truth is not None
    assert not np.mod(truth[1:], 2.0**-10).any()
    wrong = convert_command(tmp_path / "nope", tmp_path / "y")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert wrong.stderr.startswith("sfr: there is no '")
    assert wrong.stderr.count("\n") == 1
    wrong = convert_command(tmp_path / "x.mcap", tmp_path / "y", "--remap", "a:=b")
    assert wrong.returncode == 2
    assert "no topic 'a'" in wrong.stderr


@pytest.mark.slow
def test_trajectories(tmp_path: Path, world: World) -> None:
    folder = write_folder(tmp_path / "a", world, nav=False)
    assert convert_command(folder, tmp_path / "t.tum").returncode == 0
    assert_same_trajectory(load_trajectory(tmp_path / "t.tum"), world.truth)
    assert convert_trajectory(world.truth, tmp_path / "t.mcap") == 4
    assert_same_trajectory(read_trajectory(Bag(tmp_path / "t.mcap"), GROUND_TRUTH), world.truth)
    assert convert_command(tmp_path / "t.tum", tmp_path / "t").returncode == 0
    assert_same_trajectory(load_trajectory(tmp_path / "t" / "groundtruth.csv"), world.truth)
    no_truth = convert_command(write_folder(tmp_path / "n", world, loc=False), tmp_path / "n.txt")
    assert no_truth.returncode == 2
    assert "no true trajectory" in no_truth.stderr


def exported(folder: Path, target: Path, layout: Layout) -> LocSequence:
    convert(open_source(folder), target, ConvertOptions(layout=layout))
    source = open_source(target)
    assert (source.format, source.nav) == (layout.value, None)
    assert source.loc is not None
    return source.loc


@pytest.mark.parametrize("seed", range(3))
def test_euroc_keeps_images_stamps_rig_and_poses(tmp_path: Path, seed: int) -> None:
    world = make_world(seed=seed)
    loc = exported(write_folder(tmp_path / "a", world), tmp_path / "b", Layout.EUROC)
    assert_same_pairs(loc.pairs(), world.pairs)
    assert loc.rig.same_cameras(world.loc_rig)
    assert loc.rig.T_rb_sb is not None
    assert world.loc_rig.T_rb_sb is not None
    np.testing.assert_allclose(loc.rig.T_rb_sb.matrix, world.loc_rig.T_rb_sb.matrix, atol=1e-14)
    assert_same_trajectory(loc.ground_truth, world.truth)


@pytest.mark.parametrize("seed", range(3))
def test_kitti_keeps_images_stamps_rig_and_the_motion_of_the_bench(tmp_path: Path, seed: int) -> None:
    world = make_world(seed=seed)
    loc = exported(write_folder(tmp_path / "a", world), tmp_path / "b", Layout.KITTI)
    assert_same_pairs(loc.pairs(), world.pairs)
    assert loc.rig.same_cameras(world.loc_rig)
    truth, T_rb_sb = loc.ground_truth, world.loc_rig.T_rb_sb
    assert truth is not None
    assert T_rb_sb is not None
    assert truth.stamps_ns.tolist() == world.truth.stamps_ns.tolist()
    benches = [world.truth.pose(i) @ T_rb_sb for i in range(len(truth))]
    for i, bench in enumerate(benches):  # DS of this layout is the bench at its first pose
        np.testing.assert_allclose(truth.pose(i).matrix, (benches[0].inverse() @ bench).matrix, atol=1e-12)


@pytest.mark.parametrize("layout", list(Layout))
def test_without_the_place_of_the_cameras_on_the_rover_the_truth_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, layout: Layout
) -> None:
    world = make_world()
    world = replace(world, loc_rig=replace(world.loc_rig, T_rb_sb=None))
    loc = exported(write_folder(tmp_path / "a", world), tmp_path / "b", layout)
    assert loc.ground_truth is None
    assert loc.rig.same_cameras(world.loc_rig)
    (record,) = caplog.records
    assert "T_rb_locsb" in record.getMessage()


def test_what_the_layouts_cannot_hold(tmp_path: Path) -> None:
    world = make_world()
    nav = open_source(write_folder(tmp_path / "nav", world, loc=False))
    whole = open_source(write_folder(tmp_path / "both", world))
    for source, name, options, words in (
        (nav, "k", ConvertOptions(layout=Layout.KITTI), "has no drive"),
        (whole, "k.mcap", ConvertOptions(layout=Layout.EUROC), "the name of a bag"),
        (whole, "k", ConvertOptions(layout=Layout.KITTI, jpeg_quality=90), "are for bags"),
    ):
        with pytest.raises(OutputError, match=words):
            convert(source, tmp_path / name, options)
        assert not (tmp_path / name).exists()
