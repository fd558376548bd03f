"""A few kilobytes that stand for gigabytes are refused before memory is taken."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import FREE_BYTES
from sfr_loc_map.io.bag import Bag
from sfr_loc_map.io.bag_files import MCAP_MAGIC as MAGIC
from sfr_loc_map.io.bag_readers import LZ4FrameDecompressor, check_zstd_file, unpack

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

TOO_MUCH = bytes(FREE_BYTES + 1)
PACKERS: dict[str, Callable[[bytes], bytes]] = {"zstd": zstd.compress, "lz4": lz4.frame.compress}


def decompress_zstd(data: bytes, size: int | None = None) -> bytes:
    return unpack(data, zstd.ZstdDecompressor, size)


UNPACKERS = {"zstd": decompress_zstd, "lz4": lambda data, size: unpack(data, LZ4FrameDecompressor, size)}


@pytest.fixture(scope="module")
def bombs() -> dict[str, bytes]:
    return {name: pack(TOO_MUCH) for name, pack in PACKERS.items()}


@pytest.mark.parametrize("name", PACKERS)
def test_what_is_not_too_much_comes_back(name: str) -> None:
    data = bytes(range(256)) * 1000
    packed = PACKERS[name](data)
    assert UNPACKERS[name](packed, len(data)) == data
    with pytest.raises(ValueError, match="ends within a frame"):
        UNPACKERS[name](packed[:-10], len(data))


def test_several_frames_are_read_as_one() -> None:
    assert decompress_zstd(zstd.compress(b"abc") + zstd.compress(b"def")) == b"abcdef"


@pytest.mark.parametrize("name", PACKERS)
def test_too_much_is_refused_whatever_is_claimed(bombs: dict[str, bytes], name: str) -> None:
    with pytest.raises(ValueError, match="claims to hold"):
        UNPACKERS[name](bombs[name], len(TOO_MUCH))
    with pytest.raises(ValueError, match="holds more than 1000"):
        UNPACKERS[name](bombs[name], 1000)


def test_zstd_without_a_claim_and_in_many_frames(bombs: dict[str, bytes], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds more than"):
        decompress_zstd(bombs["zstd"])
    with pytest.raises(ValueError, match="holds more than"):
        decompress_zstd(zstd.compress(bytes(2**20)) * 65)
    (tmp_path / "x.db3.zstd").write_bytes(bombs["zstd"])
    with pytest.raises(ValueError, match="once decompressed"):
        check_zstd_file(tmp_path / "x.db3.zstd")


def record(opcode: int, content: bytes) -> bytes:
    return bytes([opcode]) + len(content).to_bytes(8, "little") + content


def text(value: str) -> bytes:
    return len(value).to_bytes(4, "little") + value.encode()


def bag_of(compression: str, packed: bytes, size: int, *, finished: bool) -> bytes:
    """Return an mcap file of one compressed chunk, with an end or without; without an index."""
    times = bytes(8) + (1).to_bytes(8, "little")
    chunk = (
        times + size.to_bytes(8, "little") + bytes(4) + text(compression) + len(packed).to_bytes(8, "little") + packed
    )
    end = record(0x0F, bytes(4)) + record(0x02, bytes(20)) + MAGIC if finished else b""
    return MAGIC + record(0x01, text("ros2") + text("")) + record(0x06, chunk) + end


@pytest.mark.parametrize("finished", [False, True])
@pytest.mark.parametrize("size", [len(TOO_MUCH), 1000])
@pytest.mark.parametrize("name", PACKERS)
def test_a_bag_with_a_chunk_of_too_much_is_refused(
    tmp_path: Path, bombs: dict[str, bytes], name: str, size: int, finished: bool
) -> None:
    (tmp_path / "x.mcap").write_bytes(bag_of(name, bombs[name], size, finished=finished))
    with pytest.raises(InputError, match=r"claims to hold|holds more than|holds no message"):
        Bag(tmp_path / "x.mcap")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a: &a [*a]", "within its own anchor"),
        ("[" * 200, "nested too deeply"),
        ("rosbag2_bagfile_information: 3", "does not name the files"),
        ("- 1", "does not name the files"),
    ],
)
def test_metadata_of_a_bag_is_bounded(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "metadata.yaml").write_text(content)
    with pytest.raises(InputError, match=words):
        Bag(tmp_path)
