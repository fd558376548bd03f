"""The reader of MCAP gives what the library gives, even without an index, without chunks and in no order."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader

from helpers.made_worlds import World, write_bag
from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import expansion_limit
from sfr_loc_map.io.bag.files import MCAP_MAGIC
from sfr_loc_map.io.bag.mcap_file import FOOTER_SIZE, Chunk, McapFile, _check_overlaps

Message = tuple[str, int, bytes]


def messages_of(path: Path, *, recovers: bool = False, start: int | None = None) -> list[Message]:
    file = McapFile(path, recovers=recovers)
    file.open()
    try:
        counts = {each.id: each.msgcount for each in file.connections}
        assert sum(counts.values()) == file.metadata.message_count
        return [(each.topic, time_ns, data) for each, time_ns, data in file.messages(file.connections, start)]
    finally:
        file.close()


@pytest.fixture(params=[False, True], ids=["plain", "zstd"])
def path(request: pytest.FixtureRequest, tmp_path: Path, world: World) -> Path:
    return next(write_bag(tmp_path / "bag.mcap", world, zstd=request.param).glob("*.mcap"))


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(words: str) -> bytes:
    return struct.pack("<I", len(words)) + words.encode()


def test_messages_are_those_of_the_library_with_and_without_an_index(path: Path) -> None:
    with Reader(path) as reader:
        expected = [(each.topic, time_ns, bytes(data)) for each, time_ns, data in reader.messages()]
    assert len(expected) > 10
    assert messages_of(path) == expected
    middle = expected[len(expected) // 2][1]
    assert messages_of(path, start=middle) == [each for each in expected if each[1] >= middle]
    content = bytearray(path.read_bytes())
    place = len(content) - len(MCAP_MAGIC) - FOOTER_SIZE + 9
    content[place : place + 8] = bytes(8)  # the footer names no summary
    path.write_bytes(content)
    assert messages_of(path) == expected


def test_chunks_of_one_time_are_held_at_the_same_time() -> None:
    size = expansion_limit(0)
    chunks = [Chunk(5, 5, offset, size, frozenset()) for offset in range(3)]
    _check_overlaps(chunks[:2])
    with pytest.raises(InputError, match="chunks that overlap in time"):
        _check_overlaps(chunks)


def test_a_file_that_was_not_closed_gives_its_complete_chunks(path: Path) -> None:
    expected = messages_of(path)
    content = path.read_bytes()
    found: set[int] = set()
    for size in range(len(content) - 1, len(content) // 2, -(len(content) // 40)):
        path.write_bytes(content[:size])
        some = messages_of(path, recovers=True)
        assert some == expected[: len(some)]
        found.add(len(some))
        with pytest.raises(Exception, match="footer"):
            messages_of(path)
    assert max(found) == len(expected)


def test_messages_outside_of_chunks_come_in_order_of_time(tmp_path: Path) -> None:
    schema = record(3, struct.pack("<H", 1) + text("std_msgs/msg/String") + text("ros2msg") + text("string data"))
    channel = record(4, struct.pack("<HH", 1, 1) + text("/a") + text("cdr") + struct.pack("<I", 0))
    times = [30, 10, 20]
    messages = b"".join(record(5, struct.pack("<HIQQ", 1, 0, time, time) + bytes([time])) for time in times)
    end = record(15, bytes(4)) + record(2, bytes(20)) + MCAP_MAGIC
    path = tmp_path / "a.mcap"
    path.write_bytes(MCAP_MAGIC + record(1, text("ros2") + text("")) + schema + channel + messages + end)
    assert messages_of(path) == [("/a", time, bytes([time])) for time in sorted(times)]


def test_a_chunk_with_another_content_than_its_checksum_is_refused(tmp_path: Path) -> None:
    inner = record(5, struct.pack("<HIQQ", 1, 0, 5, 5) + b"x")
    chunk = struct.pack("<QQQI", 5, 5, len(inner), 1234) + text("") + struct.pack("<Q", len(inner)) + inner
    end = record(15, bytes(4)) + record(2, bytes(20)) + MCAP_MAGIC
    path = tmp_path / "a.mcap"
    path.write_bytes(MCAP_MAGIC + record(1, text("ros2") + text("")) + record(6, chunk) + end)
    with pytest.raises(Exception, match="checksum"):
        messages_of(path)
