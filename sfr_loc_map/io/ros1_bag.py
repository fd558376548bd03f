"""Reader of ROS 1 bags (format 2.0): what it gives is like the messages of a ROS 2 bag, serialised as CDR.

The messages that are read here have the same fields in both; a header of ROS 1 has a sequence number besides, which is
dropped. What is compressed is bounded before it is unpacked, and no chunk is listed twice.
"""

from __future__ import annotations

import bz2
from collections.abc import Collection, Generator, Sequence
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import ChunkInfo, ReaderError, decompressors
from rosbags.typesys import Stores, get_typestore

from sfr_loc_map.io.decompression import decompress_lz4, expansion_limit

TYPES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
"""Older names of types that are read."""
_ROS1 = get_typestore(Stores.ROS1_NOETIC)
_ROS2 = get_typestore(Stores.ROS2_JAZZY)


def _decompress_bz2(data: bytes) -> bytes:
    limit, decompressor = expansion_limit(len(data)), bz2.BZ2Decompressor()
    found = decompressor.decompress(data, max_length=limit + 1)
    if len(found) > limit:
        raise ValueError(f"compressed data of {len(data)} bytes holds more than {limit}")
    if not decompressor.eof:
        raise ValueError("compressed data ends within a stream")
    return found


decompressors.update(  # the library's own take any amount of memory
    bz2=_decompress_bz2, lz4=lambda data: decompress_lz4(data, expansion_limit(len(data)))
)


class Ros1Reader(Reader):
    """Reader of a ROS 1 bag; a context manager."""

    def __init__(self, path: Path) -> None:
        """Prepare a file."""
        super().__init__(path)
        self._places: set[int] = set()

    def open(self) -> None:
        """Read the index.

        Raises:
            rosbags.rosbag1.ReaderError: If it is missing or broken.
        """
        self._places.clear()
        super().open()
        self.connections = [each._replace(msgtype=TYPES.get(each.msgtype, each.msgtype)) for each in self.connections]

    def read_chunk_info(self) -> ChunkInfo:
        """Read the place of a chunk; a chunk that is listed twice would be read twice."""
        info = super().read_chunk_info()
        if info.pos in self._places:
            raise ReaderError(f"the chunk at byte {info.pos} is listed twice.")
        self._places.add(info.pos)
        return info

    def messages(
        self, connections: Collection[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield connection, time and the message as CDR.

        Raises:
            rosbags.rosbag1.ReaderError: If the file is broken, or a type has other fields than those of ROS Noetic.
        """
        wanted = {each.id: each for each in connections or self.connections}
        _check_definitions(list(wanted.values()))
        for each, time_ns, data in super().messages(connections, start, stop):
            connection = wanted[each.id]
            yield connection, time_ns, bytes(_ROS2.ros1_to_cdr(data, connection.msgtype))


def _check_definitions(connections: Sequence[Connection]) -> None:
    for each in connections:
        known = each.msgtype in _ROS1.fielddefs
        if known and each.digest not in ("*", _ROS1.generate_msgdef(each.msgtype, ros_version=1)[1]):
            raise ReaderError(f"{each.msgtype} of '{each.topic}' has other fields than that of ROS Noetic.")
