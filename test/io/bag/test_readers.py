"""The bounded readers of bags: a few kilobytes that stand for gigabytes, ROS 1, databases that were cut off."""

from __future__ import annotations

import bz2
import sys
from pathlib import Path

import lz4.frame
import pytest
from rosbags.rosbag1 import Writer

from helpers.made_ros1 import write_ros1
from helpers.made_worlds import World, assert_is_world, assert_same_pairs, write_bag
from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import FREE_BYTES
from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.bag.files import MCAP_MAGIC
from sfr_loc_map.io.bag.unpacking import LZ4FrameDecompressor, unpack
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.message_types import ODOMETRY

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

TOO_MUCH = bytes(FREE_BYTES + 1)
PACKERS = {
    "zstd": (zstd.compress, zstd.ZstdDecompressor),
    "lz4": (lz4.frame.compress, LZ4FrameDecompressor),
    "bz2": (bz2.compress, bz2.BZ2Decompressor),
}


@pytest.fixture(scope="module")
def bombs() -> dict[str, bytes]:
    return {name: pack(TOO_MUCH) for name, (pack, _) in PACKERS.items()}


@pytest.mark.parametrize("name", PACKERS)
def test_what_is_compressed_is_bounded_whatever_is_claimed(bombs: dict[str, bytes], name: str) -> None:
    pack, new = PACKERS[name]
    data = bytes(range(256)) * 1000
    assert unpack(pack(data), new, len(data)) == unpack(pack(data), new) == data
    assert unpack(pack(b"abc") + pack(b"def"), new) == b"abcdef"
    with pytest.raises(ValueError, match="ends within a frame"):
        unpack(pack(data)[:-10], new, len(data))
    for claimed, words in ((len(TOO_MUCH), "of content: at most"), (1000, "exceeds 1000"), (None, "exceeds")):
        with pytest.raises(ValueError, match=words):
            unpack(bombs[name], new, claimed)


@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize("size", [len(TOO_MUCH), 1000])
@pytest.mark.parametrize("name", ["zstd", "lz4"])
def test_a_bag_with_a_chunk_of_too_much_is_refused(
    tmp_path: Path, bombs: dict[str, bytes], name: str, size: int, finished: bool
) -> None:
    def record(opcode: int, content: bytes) -> bytes:
        return bytes([opcode]) + len(content).to_bytes(8, "little") + content

    sizes = bytes(8) + (1).to_bytes(8, "little") + size.to_bytes(8, "little") + bytes(4)
    compression = len(name).to_bytes(4, "little") + name.encode()
    chunk = sizes + compression + len(bombs[name]).to_bytes(8, "little") + bombs[name]
    header = record(0x01, b"\x04\0\0\0ros2" + bytes(4))
    end = record(0x0F, bytes(4)) + record(0x02, bytes(20)) + MCAP_MAGIC if finished else b""
    (tmp_path / "x.mcap").write_bytes(MCAP_MAGIC + header + record(0x06, chunk) + end)
    with pytest.raises(InputError, match=r"of content: at most|exceeds|has no messages"):
        Bag(tmp_path / "x.mcap")


@pytest.fixture
def ros2(tmp_path: Path, world: World) -> Path:
    return write_bag(tmp_path / "a.mcap", world)


@pytest.mark.parametrize("compression", ["", "BZ2", "LZ4"])
def test_a_ros_1_bag_holds_the_same_world(tmp_path: Path, ros2: Path, world: World, compression: str) -> None:
    assert_is_world(open_source(write_ros1(tmp_path / "a.bag", ros2, compression=compression)), world)
    names = {f"/loc/{side}/image_rect": f"/cam{i}/image" for i, side in enumerate(("left", "right"))}
    source = open_source(write_ros1(tmp_path / "b.bag", ros2, names), SourceConfig(topics=names))
    assert_same_pairs(source.loc.pairs(), world.pairs)


def test_a_definition_that_differs_from_noetic_is_not_called_corrupt(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    with Writer(path) as writer:
        other = writer.add_connection("/odom", ODOMETRY, msgdef="uint8 other\n", md5sum="0" * 32)
        writer.write(other, 1, b"\0")
    bag = Bag(path)
    with pytest.raises(InputError, match="definition") as refused:
        list(bag.messages([Topic("odom", "/odom", ODOMETRY)]))
    assert str(refused.value) == (
        f"'{path}': the definition of {ODOMETRY} on '/odom' differs from ROS Noetic: "
        "record the topic with the definition of Noetic"
    )


@pytest.mark.parametrize("keep", [0.0, 0.01, 0.3, 0.9])
@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
def test_a_truncated_bag_is_one_line(tmp_path: Path, ros2: Path, world: World, kind: str, keep: float) -> None:
    if kind == "ros1":
        path = write_ros1(tmp_path / "a.bag", ros2)
    else:
        path = next(write_bag(tmp_path / "b.db3", world).glob("*.db3"))
    path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
    with pytest.raises(InputError, match=f"^[^\n]*{path}[^\n]*$"):
        list(open_source(path).loc.pairs())
