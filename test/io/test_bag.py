"""Bags: round trips, bags of others, corrupt bags."""

from __future__ import annotations

import json
import logging
import re
import resource
import sqlite3
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_worlds import (
    START_NS,
    World,
    assert_is_world,
    assert_same_pairs,
    make_world,
    write_bag,
)
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from sfr_loc_map.errors import ConfigError, InputError, OutputError, SfrError
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io import bag_messages as messages
from sfr_loc_map.io.bag import TYPESTORE, Bag
from sfr_loc_map.io.bag_sequence import open_bag
from sfr_loc_map.io.bag_writer import CheckedWriter
from sfr_loc_map.io.rectification import rectified_rig
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.pipeline.message_stream import messages_of


def write_messages(path: Path, entries: list[tuple[str, int, Any]], *, mcap: bool = True) -> Path:
    """Write any messages as another program would, by the bag library alone."""
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, recorded_ns, message in entries:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=TYPESTORE)
            writer.write(connections[topic], recorded_ns, TYPESTORE.serialize_cdr(message, kind))
    return path


def loc_entries(world: World, prefix: str = "/") -> list[tuple[str, int, Any]]:
    """Return the messages of a drive: recorded times a little after the stamps, as in life."""
    entries: list[tuple[str, int, Any]] = []
    for pair in world.pairs:
        stamp = pair.stamp_ns
        for side, image in (("left", pair.left), ("right", pair.right)):
            entries += [
                (f"{prefix}loc/{side}/image_rect", stamp + 5000, messages.image(stamp, image, "loc", side)),
                (
                    f"{prefix}loc/{side}/camera_info",
                    stamp + 6000,
                    messages.camera_info(stamp, world.loc_rig, "loc", side),
                ),
            ]
    return entries


@pytest.mark.parametrize("name", ["x.mcap", "x.db3", "x.bag"])
def test_round_trip_is_exact(tmp_path: Path, world: World, name: str) -> None:
    assert_is_world(open_source(write_bag(tmp_path / name, world)), world)


def test_a_full_disk_is_an_error_of_the_system(tmp_path: Path, world: World) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, hard))
    try:
        with pytest.raises(OSError, match=r"disk|full"):
            write_bag(tmp_path / "x.db3", world)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_zstd_round_trip_is_exact_and_smaller(tmp_path: Path) -> None:
    world = make_world()
    flat = replace(world, pairs=tuple(replace(p, left=p.left * 0, right=p.right * 0) for p in world.pairs))
    plain, packed = (write_bag(tmp_path / f"{z}.mcap", flat, zstd=z) for z in (False, True))
    assert_is_world(open_source(packed), flat)
    sizes = [sum(f.stat().st_size for f in bag.glob("*.mcap")) for bag in (plain, packed)]
    assert sizes[1] < 0.7 * sizes[0]


def test_rosbags_own_reader_opens_what_is_written(tmp_path: Path, world: World) -> None:
    with AnyReader([write_bag(tmp_path / "x.db3", world)]) as reader:
        topics = {name: (info.msgtype, info.msgcount) for name, info in reader.topics.items()}
    assert topics["/loc/left/image_rect"] == ("sensor_msgs/msg/Image", 4)
    assert topics["/loc/right/camera_info"] == ("sensor_msgs/msg/CameraInfo", 4)
    assert topics["/nav/pose"] == ("geometry_msgs/msg/PoseStamped", 2)
    assert topics["/ground_truth/points"] == ("sensor_msgs/msg/PointCloud2", 1)
    assert topics["/ground_truth/odometry"] == ("nav_msgs/msg/Odometry", 4)
    assert topics["/tf_static"] == ("tf2_msgs/msg/TFMessage", 1)


def test_jpeg_is_close_and_needs_no_other_topic(tmp_path: Path) -> None:
    world = make_world(count=2)
    smooth = np.add.outer(np.arange(16) * 4, np.arange(24) * 6).astype(np.uint8)
    world = replace(world, pairs=tuple(replace(p, left=smooth, right=smooth) for p in world.pairs))
    source = open_source(write_bag(tmp_path / "x.mcap", world, nav=False, jpeg_quality=95))
    for pair in source.loc.pairs():
        assert np.abs(pair.left.astype(int) - smooth).max() <= 4


def test_truth_grid_rounds_to_its_half(tmp_path: Path, world: World) -> None:
    source = open_source(write_bag(tmp_path / "x.mcap", world, loc=False, truth_grid_m=2.0**-10))
    found = next(source.nav.pairs()).truth
    np.testing.assert_allclose(found, world.navs[0].truth, atol=2.0**-11 * 1.001, rtol=0)
    assert np.array_equal(np.mod(found[1:], 2.0**-10), np.zeros_like(found[1:]))
    with pytest.raises(OutputError, match="power of two"):
        write_bag(tmp_path / "y.mcap", world, loc=False, truth_grid_m=0.001)


def test_topics_of_others_by_remap_and_namespace(tmp_path: Path, world: World) -> None:
    entries = [(topic.replace("/loc/left/image_rect", "/front_l/pic"), *rest) for topic, *rest in loc_entries(world)]
    bag = write_messages(tmp_path / "others", entries)
    with pytest.raises(InputError, match=r"no topic 'loc/left/image_rect'.*/front_l/pic.*--remap"):
        open_source(bag)
    for old, new in (("/front_l/pic", "/loc/left/image_rect"), ("front_l/pic", "loc/left/image_rect")):
        loc = open_source(bag, {old: new}).loc
        assert_same_pairs(loc.pairs(), world.pairs)
        assert loc.ground_truth is None
        assert loc.rig.T_rb_sb is None
    spaced = open_source(write_messages(tmp_path / "spaced", loc_entries(world, "/rover_1/"))).loc
    assert_same_pairs(spaced.pairs(), world.pairs)
    two = write_messages(tmp_path / "two", loc_entries(world, "/a/") + loc_entries(world, "/b/"))
    with pytest.raises(InputError, match=r"several topics.*/a/loc.*/b/loc"):
        open_source(two)


def test_a_recording_without_tf_has_the_extrinsics_of_the_node_that_was_recorded(tmp_path: Path, world: World) -> None:
    expected = world.loc_rig.T_rb_sb
    values = {
        "T_rb_locsb.translation_m": expected.translation.tolist(),
        "T_rb_locsb.quat_xyzw": expected.file_quat_xyzw.tolist(),
    }
    entries = [entry for entry in loc_entries(world, "/rover1/") if not entry[0].endswith("tf_static")]

    def opened(name: str, *texts: str) -> Any:
        string = TYPESTORE.types["std_msgs/msg/String"]
        extra = [(f"/rover{i + 1}/localisation/configuration", 0, string(data=text)) for i, text in enumerate(texts)]
        return open_bag(write_messages(tmp_path / name, [*entries, *extra])).loc.rig.T_rb_sb

    assert opened("none.mcap") is None
    assert np.array_equal(opened("given.mcap", json.dumps(values)).matrix, expected.matrix)
    assert opened("open.mcap", json.dumps(values | {"T_rb_locsb.quat_xyzw": [0.0, 0.0, 0.0, 0.0]})) is None
    assert opened("two.mcap", json.dumps(values), json.dumps(values)) is None  # of which rover is not known
    for text in ("{", "[]", json.dumps(values | {"T_rb_locsb.quat_xyzw": ["a", 0, 0, 1]})):
        with pytest.raises(InputError, match="T_rb_locsb cannot be read"):
            opened(f"{len(text)}.mcap", text)


def test_a_topic_that_is_renamed_to_what_nothing_reads_is_not_left_out_in_silence(tmp_path: Path, world: World) -> None:
    """Also within a namespace; without the check the drive would be gone and the panorama read alone."""
    bag = write_bag(tmp_path / "x.mcap", world)
    for name in ("/loc/left/image_rct", "image", "rover/loc/left/pose"):
        with pytest.raises(ConfigError, match=r"no topic is read as .*there are loc/left/image_rect"):
            open_source(bag, {"/loc/left/image_rect": name})
    assert open_source(bag, {"/loc/left/image_rect": "/rover/loc/left/image_rect"}).loc is not None


def test_bag_without_metadata_or_as_storage_file(tmp_path: Path, world: World) -> None:
    for name in ("x.mcap", "x.db3"):
        bag = write_bag(tmp_path / name, world)
        (storage,) = (f for f in bag.iterdir() if f.name != "metadata.yaml")
        assert_is_world(open_source(storage), world)
        (bag / "metadata.yaml").unlink()
        assert_is_world(open_source(bag), world)


def test_single_images_are_left_out_with_a_warning(
    tmp_path: Path, world: World, caplog: pytest.LogCaptureFixture
) -> None:
    entries = [e for i, e in enumerate(loc_entries(world)) if i != 4]  # the left image of the second pair
    loc = open_source(write_messages(tmp_path / "b", entries)).loc
    with caplog.at_level(logging.WARNING):
        assert len(loc) == 3
    assert "1 images" in caplog.text
    assert_same_pairs(loc.pairs(), (world.pairs[0], *world.pairs[2:]))


def change(entries: list[tuple[str, int, Any]], topic: str, **changes: Any) -> list[tuple[str, int, Any]]:
    return [(t, s, replace(m, **changes) if t == topic else m) for t, s, m in entries]


def with_p3(world: World, value: float) -> Any:
    p = messages.camera_info(START_NS, world.loc_rig, "loc", "right").p.copy()
    p[3] = value
    return p


@pytest.mark.parametrize(
    ("topic", "make", "words"),
    [
        ("loc/left/camera_info", lambda w: {"d": np.array([0.1, 0, 0, 0, 0])}, "non-rectified .*distortion"),
        ("loc/left/camera_info", lambda w: {"r": np.eye(3)[[1, 0, 2]].reshape(-1)}, "non-rectified .*rotation"),
        ("loc/right/camera_info", lambda w: {"p": np.zeros(12)}, "non-rectified .*projection"),
        ("loc/right/camera_info", lambda w: {"k": 2 * w.loc_rig.camera_matrix.reshape(-1)}, "non-rectified .*k and p"),
        ("loc/right/camera_info", lambda w: {"p": with_p3(w, 2.4)}, "swapped"),
        ("loc/right/camera_info", lambda w: {"p": with_p3(w, 0.0)}, "baseline"),
        ("loc/right/camera_info", lambda w: {"width": 25}, "24 x 16 and 25 x 16"),
    ],
)
def test_camera_info_that_is_not_of_a_rectified_pair(
    tmp_path: Path, world: World, topic: str, make: Any, words: str
) -> None:
    bag = write_messages(tmp_path / "b", change(loc_entries(world), "/" + topic, **make(world)))
    with pytest.raises(InputError, match=f"(?s){bag}.*{words}"):
        open_source(bag)


def test_a_bag_of_raw_images_is_rectified_as_it_is_read(tmp_path: Path, world: World) -> None:
    d = np.array([-0.1, 0.02, 0.001, -0.001, 0.0])
    raw = [(t.replace("image_rect", "image_raw"), s, m) for t, s, m in loc_entries(world)]
    raw = change(change(raw, "/loc/left/camera_info", d=d), "/loc/right/camera_info", d=d)
    bag = write_messages(tmp_path / "b", raw)
    source = open_source(bag)
    assert source.loc.rig.same_cameras(world.loc_rig)
    infos = [replace(messages.camera_info(START_NS, world.loc_rig, "loc", side), d=d) for side in SIDES]
    _, rectifier = rectified_rig(infos, "loc")
    for found, pair in zip(source.loc.pairs(), world.pairs, strict=True):
        left, right = rectifier.rectify(pair.left, pair.right)
        assert np.array_equal(found.left, left)
        assert np.array_equal(found.right, right)
        assert not np.array_equal(found.left, pair.left)
    played = [item.topic for item in messages_of(source, {})]
    assert "loc/left/image_rect" in played  # a replay sends them as the nodes expect them


def test_no_equal_stamps(tmp_path: Path, world: World) -> None:
    entries = [
        (t, s, messages.image(s + 1, world.pairs[0].right, "loc", "right") if t == "/loc/right/image_rect" else m)
        for t, s, m in loc_entries(world)
    ]
    loc = open_source(write_messages(tmp_path / "b", entries)).loc
    with pytest.raises(InputError, match="4 left and 4 right"):
        len(loc)


def read_all(path: Path) -> None:
    """Read everything that a bag has."""
    source = open_bag(path)
    len(source.loc), list(source.loc.pairs()), list(source.nav.pairs())
    _ = source.loc.ground_truth


@pytest.mark.parametrize("name", ["x.mcap", "x.db3"])
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.999])
@pytest.mark.parametrize("metadata", [True, False])
def test_truncated_bag_is_one_error(tmp_path: Path, world: World, name: str, keep: float, metadata: bool) -> None:
    bag = write_bag(tmp_path / name, world)
    (storage,) = (f for f in bag.iterdir() if f.name != "metadata.yaml")
    data = storage.read_bytes()
    storage.write_bytes(data[: int(keep * len(data))])
    if not metadata:
        (bag / "metadata.yaml").unlink()
    if name == "x.mcap" and not metadata and keep >= 0.3:
        return  # as a recording that broke off: see the next test
    with pytest.raises(InputError, match=str(bag)) as caught:
        read_all(bag)
    assert "\n" not in str(caught.value)


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
        topics = [topic for name in names if (topic := whole.find(name))]
        connections = {t.name: writer.add_connection(t.bag_name, t.msgtype, typestore=TYPESTORE) for t in topics}
        for number, (name, raw) in enumerate(everything):
            writer.write(connections[name], number, raw)
            writer.storage.close_chunk()
    (storage,) = bag.glob("*.mcap")
    data = storage.read_bytes()
    (bag / "metadata.yaml").unlink()
    assert not Bag(bag).unfinished
    counts = []
    for keep in np.linspace(0.3, 0.95, 12):
        storage.write_bytes(data[: int(keep * len(data))] + bytes(200))  # a file system may leave zeros at the end
        part = Bag(bag)
        assert part.unfinished
        assert "was not finished" in caplog.text
        read = [(name, raw) for name, _, _, raw in part.raw_messages(names)]
        assert read == everything[: len(read)]
        counts.append(len(read))
    assert counts == sorted(counts)
    assert 0 < counts[0] < counts[-1]
    storage.write_bytes(data[:20])
    with pytest.raises(InputError, match="it ends within its first record"):
        Bag(bag)


def test_flipped_bytes_in_mcap_are_noticed_wherever_they_are(tmp_path: Path, world: World) -> None:
    bag = write_bag(tmp_path / "x.mcap", world)
    (storage,) = bag.glob("*.mcap")
    data = storage.read_bytes()
    chunk_end = data.index(b"serialized_metadata")  # what follows is an index and statistics
    for place in np.random.default_rng(1).integers(60, chunk_end - 2000, 25):
        broken = bytearray(data)
        broken[place] ^= 0x55
        storage.write_bytes(broken)
        with pytest.raises(InputError, match=str(bag)):
            read_all(bag)


HOSTILE_SQL = (
    "UPDATE topics SET name = x'ff00'",
    "UPDATE topics SET name = 'same'",
    "UPDATE topics SET type = 'a/msg/B'",
    "UPDATE topics SET serialization_format = 'json'",
    "UPDATE messages SET data = 'text'",
    "UPDATE messages SET data = x''",
    "UPDATE messages SET timestamp = 'soon'",
    "UPDATE messages SET topic_id = 99",
    "DELETE FROM topics",
    "DROP TABLE messages",
)


@pytest.mark.parametrize("statement", HOSTILE_SQL)
def test_a_database_of_other_values_is_one_error(statement: str, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "x.db3", make_world(1), nav=False)
    (storage,) = bag.glob("*.db3")
    with sqlite3.connect(storage) as connection:
        connection.execute(statement)
    connection.close()
    with pytest.raises(SfrError, match=re.escape(str(bag))):
        read_all(bag)


def test_memory_does_not_grow_with_length(tmp_path: Path) -> None:
    def peak(count: int, name: str) -> int:
        world = make_world(count=count, width=256, height=256)
        path = write_bag(tmp_path / name, world, nav=False)
        del world
        loc = open_source(path).loc
        tracemalloc.start()
        assert sum(1 for _ in loc.pairs()) == count
        value = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return value

    for suffix in ("mcap", "db3"):
        assert peak(120, f"long.{suffix}") < peak(20, f"short.{suffix}") + 2_000_000  # the long bag holds 15 MB more
