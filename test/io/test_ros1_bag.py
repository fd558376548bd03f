"""ROS 1 bags are read as the ROS 2 bag of the same messages."""

from __future__ import annotations

import bz2
from collections.abc import Mapping
from pathlib import Path

import pytest
from made_ros1 import NOETIC, write_ros1
from made_worlds import World, assert_is_world, assert_same_pairs, write_bag
from rosbags.rosbag1.reader import decompressors

from sfr_loc_map import inputs
from sfr_loc_map.errors import InputError
from sfr_loc_map.io.bag import Bag
from sfr_loc_map.io.bag_files import is_bag
from sfr_loc_map.io.registry import open_source


def write_world(path: Path, world: World, names: Mapping[str, str] | None = None, compression: str = "") -> Path:
    """Write a world as a ROS 1 bag."""
    write_bag(path.with_suffix(".mcap"), world)
    return write_ros1(path, path.with_suffix(".mcap"), names, compression)


@pytest.mark.parametrize("compression", ["", "BZ2", "LZ4"])
def test_it_holds_the_same_world(tmp_path: Path, world: World, compression: str) -> None:
    path = write_world(tmp_path / "a.bag", world, compression=compression)
    assert is_bag(path)
    source = open_source(path)
    assert source.format == "bag"
    assert_is_world(source, world)


def test_topics_are_renamed_as_in_other_bags(tmp_path: Path, world: World) -> None:
    names = {f"/loc/{side}/image_rect": f"/cam{i}/image" for i, side in enumerate(("left", "right"))}
    path = write_world(tmp_path / "a.bag", world, names)
    source = open_source(path, {new: old for old, new in names.items()})
    assert source.loc is not None
    assert_same_pairs(source.loc.pairs(), world.pairs)
    with pytest.raises(InputError, match="has no topic 'cam0/imag' to remap"):
        open_source(path, {"/cam0/imag": "loc/left/image_rect"})


@pytest.mark.parametrize("keep", [0, 5, 2000, 0.3, 0.9, 0.999])
def test_truncated_bag_is_one_line(tmp_path: Path, world: World, keep: float) -> None:
    path = write_world(tmp_path / "a.bag", world)
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data)) if keep < 1 else int(keep)])
    with pytest.raises(InputError) as caught:
        for _ in (open_source(path).loc or pytest.fail("no drive")).pairs():
            pass
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_recording_that_was_killed_says_what_to_do(tmp_path: Path, world: World) -> None:
    path = write_world(tmp_path / "a.bag", world).rename(tmp_path / "a.bag.active")
    data = bytearray(path.read_bytes())
    place = data.index(b"index_pos=") + len(b"index_pos=")
    data[place : place + 8] = bytes(8)
    path.write_bytes(data)
    with pytest.raises(InputError, match="not indexed, reindex before reading"):
        Bag(path)


def test_what_would_fill_the_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inputs, "FREE_BYTES", 1000)
    with pytest.raises(ValueError, match="holds more than"):
        decompressors["bz2"](bz2.compress(bytes(1_000_000)))
    with pytest.raises(ValueError, match="ends within"):
        decompressors["bz2"](bz2.compress(bytes(1000))[:-5])


def test_another_definition_of_a_type_is_noticed(tmp_path: Path, world: World) -> None:
    path = write_world(tmp_path / "a.bag", world)
    digest = NOETIC.generate_msgdef("sensor_msgs/msg/Image", ros_version=1)[1].encode()
    path.write_bytes(path.read_bytes().replace(digest, digest[::-1]))
    with pytest.raises(InputError, match="has other fields than that of ROS Noetic"):
        len(open_source(path).loc or ())
