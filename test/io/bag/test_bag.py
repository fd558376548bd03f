"""Bags: round trips, bags of others, corrupt bags."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from helpers.made_worlds import START_NS, World, assert_is_world, assert_same_pairs, write_bag
from helpers.message_bags import write_messages
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.io.bag import messages
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.bag.poses import read_frame_tree, read_odometry
from sfr_loc_map.io.bag.writer import BagWriter, CheckedWriter
from sfr_loc_map.io.calibration.rectification import rig_of_infos
from sfr_loc_map.io.layouts.bag_source import open_bag
from sfr_loc_map.io.message_stream import messages_of
from sfr_loc_map.io.registry import open_source, read_truth
from sfr_loc_map.io.source_config import CalibrationConfig, FramesConfig, SourceConfig, SyncConfig
from sfr_loc_map.message_types import ODOMETRY
from sfr_loc_map.suite_names import SIDES

Entry = tuple[str, int, Any]


def loc_entries(world: World, prefix: str = "/", image: str = "image_rect", **changes: Any) -> list[Entry]:
    """Return the messages of a drive, recorded a little after their stamps as in life; `changes` are of camera_info."""
    entries: list[Entry] = []
    for pair in world.pairs:
        for side, pixels in zip(SIDES, (pair.left, pair.right), strict=True):
            stamp, name = pair.stamp_ns, f"{prefix}loc/{side}"
            info = replace(messages.camera_info(stamp, world.loc_rig, "loc", side), **changes)
            entries.append((f"{name}/{image}", stamp + 5000, messages.image(stamp, pixels, "loc", side)))
            entries.append((f"{name}/camera_info", stamp + 6000, info))
    return entries


def storage_of(bag: Path) -> Path:
    (storage,) = (file for file in bag.iterdir() if file.name != "metadata.yaml")
    return storage


@pytest.mark.parametrize(("name", "zstd"), [("x.mcap", False), ("x.mcap", True), ("x.db3", False)])
def test_round_trip_is_exact_as_folder_as_file_and_without_metadata(
    tmp_path: Path, world: World, name: str, zstd: bool
) -> None:
    bag = write_bag(tmp_path / name, world, zstd=zstd)
    assert_is_world(open_source(bag), world)
    assert_is_world(open_source(storage_of(bag)), world)
    (bag / "metadata.yaml").write_bytes(b"\xff")
    with pytest.raises(InputError, match=r"cannot be read: line 1 is not text in UTF-8; it is corrupt"):
        open_source(bag)
    (bag / "metadata.yaml").unlink()
    assert_is_world(open_source(bag), world)


def test_a_repeated_and_a_late_image_are_ignored_and_counted(
    tmp_path: Path, world: World, caplog: pytest.LogCaptureFixture
) -> None:
    pairs = [replace(world.pairs[0], stamp_ns=START_NS + k * 10**8) for k in range(12)]
    entries = loc_entries(replace(world, pairs=pairs))
    repeated = [(topic, stamp + 10**9, message) for topic, stamp, message in entries[4:8]]
    source = open_source(write_messages(tmp_path / "repeated", entries + repeated))
    assert source.loc is not None
    assert [pair.stamp_ns for pair in source.loc.pairs()] == [pair.stamp_ns for pair in pairs]
    assert "image_rect': 1 of 13 messages ignored" in caplog.text
    twice = open_source(write_messages(tmp_path / "twice", entries + [(t, s + 10**10, m) for t, s, m in entries]))
    assert twice.loc is not None
    with pytest.raises(InputError, match="stamps in increasing order are required"):
        len(twice.loc)


def test_a_baseline_that_contradicts_camera_info_is_refused(tmp_path: Path, world: World) -> None:
    bag = write_messages(tmp_path / "b", loc_entries(world))
    with pytest.raises(InputError, match=r"calibration.baseline_m is 9 m, but P of .* states 0\."):
        open_source(bag, SourceConfig(calibration=CalibrationConfig(baseline_m=9.0)))


def test_frames_that_do_not_apply_are_reported(tmp_path: Path, world: World, caplog: pytest.LogCaptureFixture) -> None:
    bag = write_bag(tmp_path / "x.mcap", world)
    source = open_source(bag, SourceConfig(frames=FramesConfig(base="nothing", pan_joint="neck")))
    assert source.loc is not None
    assert source.loc.rig.T_rb_sb is None
    assert "frames.base is 'nothing', but /tf_static does not connect this frame" in caplog.text
    assert "frames.pan_joint ignored" in caplog.text


def test_a_frame_with_two_parents_is_reported(tmp_path: Path, world: World, caplog: pytest.LogCaptureFixture) -> None:
    first = messages.static_transforms(1, world.loc_rig)
    item = first.transforms[0]
    header = replace(item.header, frame_id="other")
    other = replace(first, transforms=[replace(item, header=header, child_frame_id=f"/{item.child_frame_id}")])
    header = replace(item.header, frame_id=f"/{item.header.frame_id}")
    slashed = replace(first, transforms=[replace(item, header=header)])
    bag = Bag(write_messages(tmp_path / "b", [("/tf_static", 1, first), ("/tf_static", 2, slashed)]))
    read_frame_tree(bag)
    assert "parents" not in caplog.text
    read_frame_tree(Bag(write_messages(tmp_path / "c", [("/tf_static", 1, first), ("/tf_static", 2, other)])))
    assert f"'{item.child_frame_id}' has the parents '{item.header.frame_id}' and 'other'" in caplog.text


def test_a_file_that_the_metadata_do_not_name_is_reported(
    tmp_path: Path, world: World, caplog: pytest.LogCaptureFixture
) -> None:
    bag = write_bag(tmp_path / "x.mcap", world)
    open_source(bag)
    assert "ignored" not in caplog.text
    (bag / "second_1.mcap").write_bytes(storage_of(bag).read_bytes())
    open_source(bag)
    assert "second_1.mcap ignored" in caplog.text


def test_topics_that_the_calibration_calls_the_other_side_are_refused(tmp_path: Path, world: World) -> None:
    """cam0 of the chain is the right camera, so that its images are those of loc/right."""
    rig = world.loc_rig
    camera = {"camera_model": "pinhole", "intrinsics": [rig.fx, rig.fy, rig.cx, rig.cy]}
    camera |= {"distortion_model": "none", "distortion_coeffs": [], "resolution": [rig.width, rig.height]}
    T_cam1_cam0 = np.eye(4)
    T_cam1_cam0[0, 3] = rig.baseline_m
    chain = tmp_path / "camchain.yaml"
    chain.write_text(json.dumps({"cam0": camera, "cam1": camera | {"T_cn_cnm1": T_cam1_cam0.tolist()}}))
    calibration = CalibrationConfig(file=str(chain))
    for left, right in (("cam1", "cam0"), ("cam0", "cam1")):
        names = {f"/loc/{side}/image_rect": f"/{name}/image" for side, name in zip(SIDES, (left, right), strict=True)}
        entries = [(names.get(topic, topic), *rest) for topic, *rest in loc_entries(world)]
        bag = write_messages(tmp_path / left, entries)
        config = SourceConfig(topics=names, calibration=calibration)
        if left == "cam1":
            assert open_source(bag, config).loc.rig.baseline_m == pytest.approx(rig.baseline_m)
        else:
            with pytest.raises(InputError, match=r"left and right swapped\? Exchange the topics"):
                open_source(bag, config)


def test_mapping_pairs_without_a_pose_are_skipped_and_of_two_poses_the_first_is_used(
    tmp_path: Path, world: World, caplog: pytest.LogCaptureFixture
) -> None:
    whole = Bag(write_bag(tmp_path / "whole.mcap", world, loc=False))
    topics = [topic for topic in (whole.find(name.strip("/")) for name in whole.topics) if topic is not None]
    entries: list[Entry] = []
    for topic, stamp_ns, message in whole.messages(topics):
        is_pose = topic.name == "nav/pose"
        if not is_pose or stamp_ns != world.navs[1].pair.stamp_ns:
            entries.append((topic.bag_name, stamp_ns, message))
        if is_pose and stamp_ns == world.navs[0].pair.stamp_ns:
            other = messages.pose(stamp_ns, world.navs[1].T_lm_navsb)
            entries.append((topic.bag_name, stamp_ns, other))
    source = open_source(write_messages(tmp_path / "b", entries))
    assert source.nav is not None
    found = list(source.nav.pairs())
    assert [item.pair.stamp_ns for item in found] == list(source.nav.stamps_ns)
    assert source.missing_nav_ns == (world.navs[1].pair.stamp_ns,)
    assert len(found) == len(world.navs) - 1
    np.testing.assert_array_equal(found[0].T_lm_navsb.matrix, world.navs[0].T_lm_navsb.matrix)
    assert "1 of 2 messages ignored" in caplog.text
    assert "these pairs are skipped" in caplog.text


def test_a_drive_is_read_although_the_poses_of_mapping_pairs_are_unknown(tmp_path: Path, world: World) -> None:
    whole = Bag(write_bag(tmp_path / "whole.mcap", world))
    topics = [topic for topic in (whole.find(name.strip("/")) for name in whole.topics) if topic is not None]
    entries: list[Entry] = [
        (topic.bag_name, stamp_ns, message)
        for topic, stamp_ns, message in whole.messages(topics)
        if topic.name != "nav/pose"
    ]
    source = open_source(write_messages(tmp_path / "b", entries))
    assert source.loc is not None
    assert_same_pairs(source.loc.pairs(), world.pairs)
    assert source.nav is not None
    with pytest.raises(InputError, match="no transforms from the rover"):
        len(source.nav)


def test_camera_info_that_differs_by_rounding_is_one_calibration(tmp_path: Path, world: World) -> None:
    one = loc_entries(world)
    p = np.asarray(messages.camera_info(START_NS, world.loc_rig, "loc", "left").p)
    other = loc_entries(world, p=p)
    other = [
        (topic, stamp, replace(message, p=np.asarray(message.p) + 1e-9) if topic.endswith("info") else message)
        for topic, stamp, message in one
    ]
    half = len(one) // 2
    source = open_source(write_messages(tmp_path / "b", one[:half] + other[half:]))
    assert source.loc is not None
    assert len(source.loc) == len(world.pairs)


def test_a_calibration_that_changes_within_a_bag_is_refused(tmp_path: Path, world: World) -> None:
    one = loc_entries(world)
    p = messages.camera_info(START_NS, world.loc_rig, "loc", "left").p
    other = loc_entries(world, p=np.asarray(p) * np.repeat((1.25, 1.0), (8, 4)))
    half = len(one) // 2
    source = open_source(write_messages(tmp_path / "b", one[:half] + other[half:]))
    assert source.loc is not None
    with pytest.raises(InputError, match="the calibration changes"):
        len(source.loc)


def test_topics_of_others_by_remap_and_namespace(tmp_path: Path, world: World) -> None:
    entries = [(topic.replace("/loc/left/image_rect", "/front_l/pic"), *rest) for topic, *rest in loc_entries(world)]
    bag = write_messages(tmp_path / "others", entries)
    with pytest.raises(InputError, match=r"no topic 'loc/left/image_rect'.*/front_l/pic.*--remap"):
        open_source(bag)
    for old, new in (("/front_l/pic", "/loc/left/image_rect"), ("front_l/pic", "rover/loc/left/image_rect")):
        loc = open_source(bag, SourceConfig(topics={new: old})).loc
        assert_same_pairs(loc.pairs(), world.pairs)
        assert (loc.ground_truth, loc.rig.T_rb_sb) == (None, None)
    with pytest.raises(ConfigError, match="--remap front_l/pic:=loc/left/image_rect"):
        open_source(bag, SourceConfig(topics={"/front_l/pic": "/loc/left/image_rect"}))  # in the order of ros2 run -r
    spaced = open_source(write_messages(tmp_path / "spaced", loc_entries(world, "/rover_1/"))).loc
    assert_same_pairs(spaced.pairs(), world.pairs)
    with pytest.raises(InputError, match=r"several topics.*/a/loc.*/b/loc"):
        open_source(write_messages(tmp_path / "two", loc_entries(world, "/a/") + loc_entries(world, "/b/")))


@pytest.mark.parametrize(("namespace", "is_reported"), [("/rover1", False), ("", False), ("/rover2", True)])
def test_a_truth_in_the_namespace_of_another_rover_is_reported(
    tmp_path: Path, world: World, caplog: pytest.LogCaptureFixture, namespace: str, is_reported: bool
) -> None:
    pose = messages.odometry(START_NS, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    entries = [*loc_entries(world, "/rover1/"), (f"{namespace}/ground_truth/odometry", START_NS, pose)]
    open_source(write_messages(tmp_path / "bag", entries))
    assert ("/rover2: ground_truth/odometry" in caplog.text) == is_reported


def test_a_recording_without_tf_has_the_extrinsics_of_the_node_that_was_recorded(tmp_path: Path, world: World) -> None:
    pose = world.loc_rig.T_rb_sb
    translation, quat = "T_rb_locsb.translation_m", "T_rb_locsb.quat_xyzw"
    given = {translation: pose.translation.tolist(), quat: pose.file_quat_xyzw.tolist()}

    def opened(*values: Any) -> Any:
        string = TYPESTORE.types["std_msgs/msg/String"]
        name = "localisation/configuration"
        extra = [(f"/rover{i + 1}/{name}", 0, string(json.dumps(each))) for i, each in enumerate(values)]
        path = tmp_path / str(len(list(tmp_path.iterdir())))
        return open_bag(write_messages(path, [*loc_entries(world, "/rover1/"), *extra])).loc.rig.T_rb_sb

    assert np.array_equal(opened(given).matrix, pose.matrix)
    assert opened() is opened(given | {quat: [0.0] * 4}) is opened(given, given) is None  # of which rover is not known
    for values in ([], given | {quat: ["a", 0, 0, 1]}):
        with pytest.raises(InputError, match="T_rb_locsb cannot be read"):
            opened(values)


def test_a_bag_of_raw_images_is_rectified_as_it_is_read(tmp_path: Path, world: World) -> None:
    d = np.array([-0.1, 0.02, 0.001, -0.001, 0.0])
    source = open_source(write_messages(tmp_path / "b", loc_entries(world, image="image_raw", d=d)))
    assert source.loc.rig.same_cameras(world.loc_rig)
    infos = [replace(messages.camera_info(START_NS, world.loc_rig, "loc", side), d=d) for side in SIDES]
    _, rectifier = rig_of_infos(infos, "loc", raw=True)
    for found, pair in zip(source.loc.pairs(), world.pairs, strict=True):
        np.testing.assert_array_equal((found.left, found.right), rectifier.rectify(pair.left, pair.right))
        assert not np.array_equal(found.left, pair.left)
    assert "loc/left/image_rect" in [item.topic for item in messages_of(source)]  # as nodes expect them


def read_all(path: Path) -> None:
    source = open_bag(path)
    len(source.loc), list(source.loc.pairs()), list(source.nav.pairs() if source.nav else ())
    _ = source.loc.ground_truth


@pytest.mark.parametrize("zstd", [False, True])
def test_a_recording_that_broke_off_is_read_up_to_its_last_whole_chunk(
    tmp_path: Path, world: World, caplog: pytest.LogCaptureFixture, zstd: bool
) -> None:
    whole = Bag(write_bag(tmp_path / "whole.mcap", world))
    bag = tmp_path / "x.mcap"
    names = ["loc/left/image_rect", "nav/pose"]
    everything = [(name, raw) for name, _, _, raw in whole.raw_messages(names)]
    writer = CheckedWriter(bag, version=9, storage_plugin=StoragePlugin.MCAP)
    if zstd:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        topics = [whole.find(name) for name in names]
        connections = {t.name: writer.add_connection(t.bag_name, t.msgtype, typestore=TYPESTORE) for t in topics}
        for number, (name, raw) in enumerate(everything):
            writer.write(connections[name], number, raw)
            writer.storage.close_chunk()
    (bag / "metadata.yaml").unlink()
    storage = storage_of(bag)
    data = storage.read_bytes()
    assert not Bag(bag).unfinished
    counts = []
    for keep in np.linspace(0.3, 0.95, 12):
        storage.write_bytes(data[: int(keep * len(data))] + bytes(200))  # a file system may leave zeros at the end
        part = Bag(bag)
        assert part.unfinished
        assert "was not closed" in caplog.text
        read = [(name, raw) for name, _, _, raw in part.raw_messages(names)]
        assert read == everything[: len(read)]
        counts.append(len(read))
    assert counts == sorted(counts)
    assert 0 < counts[0] < counts[-1]
    storage.write_bytes(data[:20])
    with pytest.raises(InputError, match="its first record is incomplete"):
        Bag(bag)


def test_flipped_bytes_in_mcap_are_noticed_wherever_they_are(tmp_path: Path, world: World) -> None:
    bag = write_bag(tmp_path / "x.mcap", world)
    storage = storage_of(bag)
    data = storage.read_bytes()
    chunk_end = data.index(b"serialized_metadata")  # what follows is an index and statistics
    for place in np.random.default_rng(1).integers(60, chunk_end - 2000, 25):
        broken = bytearray(data)
        broken[place] ^= 0x55
        storage.write_bytes(broken)
        with pytest.raises(InputError, match=str(bag)):
            read_all(bag)


@pytest.mark.parametrize("images_by", ["header", "record"])
def test_a_source_and_a_score_read_the_same_truth_of_a_bag(tmp_path: Path, world: World, images_by: str) -> None:
    """The noise of the truth is that in its messages, and its stamps do not depend on those of the images."""
    entries = loc_entries(world)
    rows = zip(world.truth.stamps_ns.tolist(), world.truth.positions, world.truth.quats_xyzw, strict=True)
    for stamp, *row in rows:
        message = messages.odometry(stamp, *row)
        message.pose.covariance[:] = np.diag([4e-4] * 3 + [1e-6] * 3).ravel()
        entries.append(("/ground_truth/odometry", stamp + 70_000, message))
    bag = write_messages(tmp_path / "x", entries)
    of_source = open_source(bag, SourceConfig(sync=SyncConfig(stamps=images_by))).truth
    alone = read_truth(bag)
    assert of_source.sigma_m == alone.sigma_m == pytest.approx(0.02)
    assert of_source.sigma_deg == alone.sigma_deg > 0.0
    assert of_source.read_from == alone.read_from
    assert of_source.stamps_ns.tolist() == alone.stamps_ns.tolist() == world.truth.stamps_ns.tolist()
    np.testing.assert_array_equal(of_source.positions, alone.positions)


def test_a_topic_of_the_truth_without_messages_is_no_truth(tmp_path: Path, world: World) -> None:
    path = tmp_path / "x"
    with BagWriter(path) as writer:
        writer.write_loc_rig(world.loc_rig)
        writer.write_loc_pair(world.pairs[0])
    assert open_source(path).truth is None


def test_poses_that_are_none_are_left_out_and_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    entries: list[Entry] = []
    for stamp in range(6):
        place, quat = (
            np.array([stamp, 0.0, np.nan if stamp == 2 else 0.0]),
            np.array([0.0, 0.0, 0.0, float(stamp != 4)]),
        )
        entries.append(("/localisation/odometry", stamp, messages.odometry(stamp, place, quat)))
    bag = Bag(write_messages(tmp_path / "poses", entries))
    topic = bag.find("localisation/odometry", ODOMETRY)
    assert topic is not None
    poses, covariances = read_odometry(bag, topic)
    assert poses.stamps_ns.tolist() == [0, 1, 3, 5]
    assert len(covariances) == 4
    assert "2 of 6 poses skipped" in caplog.text
