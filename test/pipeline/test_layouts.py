"""A drive written in the layout of another data set and read again is the same drive."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "io"))

from made_worlds import assert_same_pairs, assert_same_trajectory, make_world, write_folder

from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.kitti import poses_at
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.pipeline.convert import ConvertOptions, Layout, convert


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
def test_a_second_export_gives_the_same_files(tmp_path: Path, layout: Layout) -> None:
    exported(write_folder(tmp_path / "a", make_world()), tmp_path / "b", layout)
    exported(tmp_path / "b", tmp_path / "c", layout)
    files = sorted(path.relative_to(tmp_path / "b") for path in (tmp_path / "b").rglob("*") if path.is_file())
    assert len(files) > 10
    for file in files:
        one, other = ((tmp_path / name / file).read_bytes() for name in "bc")
        assert one == other or file.name in ("poses.txt", "sensor.yaml")  # products of poses: the last digit


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


def test_kitti_needs_a_pose_at_every_image(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    world = make_world()
    short = Trajectory(*(getattr(world.truth, name)[1:] for name in ("stamps_ns", "positions", "quats_xyzw")))
    loc = exported(write_folder(tmp_path / "a", replace(world, truth=short)), tmp_path / "b", Layout.KITTI)
    assert loc.ground_truth is None
    assert "poses.txt is left out" in caplog.text


def test_poses_between_others_are_interpolated() -> None:
    poses = [(t, Transform(np.eye(3), np.array([float(t), 0.0, 0.0]))) for t in (0, 10, 30)]
    found = poses_at([0, 5, 10, 20, 30], poses)
    assert found is not None
    assert [pose.translation[0] for pose in found] == [0.0, 5.0, 10.0, 20.0, 30.0]
    far = [(0, poses[0][1]), (10**9 + 1, poses[1][1])]
    assert poses_at([5], far) is None
    assert poses_at([31], poses) is None
    assert poses_at([-1], poses) is None


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
