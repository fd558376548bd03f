"""Conversion of any source to bags and folders."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "io"))

from made_worlds import World, assert_is_world, assert_same_trajectory, make_world, write_folder

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.inputs import hash_path
from sfr_loc_map.io.bag import GROUND_TRUTH, Bag, read_trajectory
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.trajectory_file import load_trajectory
from sfr_loc_map.pipeline.convert import ConvertOptions, convert, convert_trajectory

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


def test_messages_are_in_the_order_of_stamps(tmp_path: Path, world: World) -> None:
    convert(open_source(write_folder(tmp_path / "a", world)), tmp_path / "x.mcap", EXACT)
    names = ["ground_truth/odometry", "loc/right/image_rect", "nav/left/image_rect"]
    found = [(stamp, name) for name, _, stamp, _ in Bag(tmp_path / "x.mcap").raw_messages(names)]
    assert [stamp for stamp, _ in found] == sorted(stamp for stamp, _ in found)
    assert len(found) == 4 + 4 + 2


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


def test_stamp_that_no_message_can_hold(tmp_path: Path, world: World) -> None:
    folder = write_folder(tmp_path / "a", world, nav=False)
    text = (folder / "pairs.csv").read_text().splitlines()
    text[-1] = str(2**31 * 10**9) + text[-1][19:]
    (folder / "pairs.csv").write_text("\n".join(text))
    with pytest.raises(OutputError, match="does not fit a ROS message"):
        convert(open_source(folder), tmp_path / "x.mcap", EXACT)
    assert not (tmp_path / "x.mcap").exists()


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "import sys; from sfr_loc_map.cli.main import main; sys.exit(main())", "convert"]
    return subprocess.run([*command, *map(str, words)], capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_command_line(tmp_path: Path, world: World) -> None:
    folder = write_folder(tmp_path / "a", world)
    made = run(
        folder, tmp_path / "x.mcap", "--compression", "zstd", "--jpeg-quality", "90", "--truth-grid", "0.0009765625"
    )
    assert (made.returncode, made.stdout) == (0, "")
    assert "/loc/left/image_rect/compressed" in Bag(tmp_path / "x.mcap").topics
    nav = open_source(tmp_path / "x.mcap").nav
    assert nav is not None
    truth = next(nav.pairs()).truth
    assert truth is not None
    assert not np.mod(truth[1:], 2.0**-10).any()
    wrong = run(tmp_path / "nope", tmp_path / "y")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert wrong.stderr.startswith("sfr: there is no '")
    assert wrong.stderr.count("\n") == 1
    wrong = run(tmp_path / "x.mcap", tmp_path / "y", "--remap", "a:=b")
    assert wrong.returncode == 2
    assert "no topic 'a'" in wrong.stderr


@pytest.mark.slow
def test_trajectories(tmp_path: Path, world: World) -> None:
    folder = write_folder(tmp_path / "a", world, nav=False)
    assert run(folder, tmp_path / "t.tum").returncode == 0
    assert_same_trajectory(load_trajectory(tmp_path / "t.tum"), world.truth)
    assert convert_trajectory(world.truth, tmp_path / "t.mcap") == 4
    assert_same_trajectory(read_trajectory(Bag(tmp_path / "t.mcap"), GROUND_TRUTH), world.truth)
    assert run(tmp_path / "t.tum", tmp_path / "t").returncode == 0
    assert_same_trajectory(load_trajectory(tmp_path / "t" / "groundtruth.csv"), world.truth)
    no_truth = run(write_folder(tmp_path / "n", world, loc=False), tmp_path / "n.txt")
    assert no_truth.returncode == 2
    assert "no true trajectory" in no_truth.stderr


@pytest.mark.slow
@pytest.mark.shared
def test_development_data_comes_back_equal(shared_data: Path, tmp_path: Path) -> None:
    for name, suffix in (("dev-nav", "mcap"), ("kitti-1", "db3")):
        first = shared_data / name
        convert(open_source(first), tmp_path / f"{name}.{suffix}", EXACT)
        convert(open_source(tmp_path / f"{name}.{suffix}"), tmp_path / name, EXACT)
        assert json.loads((tmp_path / name / "rig.json").read_text()) == json.loads((first / "rig.json").read_text())
        for file in first.rglob("*.*"):
            copy = tmp_path / name / file.relative_to(first)
            if file.suffix == ".png":
                assert np.array_equal(cv2.imread(str(copy), -1), cv2.imread(str(file), -1)), file
            elif file.suffix in (".npy", ".csv"):
                assert copy.read_bytes().replace(b"\r\n", b"\n") == file.read_bytes().replace(b"\r\n", b"\n"), file
