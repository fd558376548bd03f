"""The readers of the files of a bag: our reader of MCAP files, and those of rosbags for sqlite3 and ROS 1 files.

Decompressed sizes are checked before or during decompression. Messages of ROS 1 (format 2.0) are returned as CDR,
without the sequence number of their headers.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

from rosbags import rosbag1
from rosbags.interfaces import Connection
from rosbags.rosbag1.reader import Chunk, ChunkInfo, decompressors
from rosbags.rosbag1.reader import ReaderError as Ros1Error
from rosbags.rosbag2.metadata import ReaderMetadata
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.bag.encoding import OLD_TYPES, cdr_of_ros1
from sfr_loc_map.io.bag.files import BagFiles, is_ros1_bag
from sfr_loc_map.io.bag.mcap_file import NO_MESSAGES, McapFile
from sfr_loc_map.io.bag.unpacking import unpack_bz2, unpack_lz4, unpack_zstd, unpack_zstd_file
from sfr_loc_map.suffixes import suffix_of

BOUNDED = {decompressors["bz2"]: unpack_bz2, decompressors["lz4"]: unpack_lz4}
"""Decompressors of ROS 1 chunks with a size limit, by the decompressors of rosbags that they replace."""
_ROS1 = get_typestore(Stores.ROS1_NOETIC)


class Ros1Reader(rosbag1.Reader):
    """Reader of a ROS 1 bag; a context manager."""

    def open(self) -> None:
        """Read the index."""
        self._places: set[int] = set()
        super().open()
        self.connections = [c._replace(msgtype=OLD_TYPES.get(c.msgtype, c.msgtype)) for c in self.connections]

    @property
    def metadata(self) -> ReaderMetadata:
        """Times (ns) and number of the messages, as the other readers state them."""
        return NO_MESSAGES._replace(
            start_time=self.start_time, end_time=self.end_time, message_count=self.message_count
        )

    def read_chunk_info(self) -> ChunkInfo:
        """Read the offset of a chunk; a chunk that is listed twice is rejected."""
        info = super().read_chunk_info()
        if info.pos in self._places:
            raise Ros1Error(f"the chunk at byte {info.pos} is listed twice.")
        self._places.add(info.pos)
        return info

    def read_chunk(self) -> Chunk:
        """Read the head of a chunk, and select a decompressor with a size limit."""
        chunk = super().read_chunk()
        return chunk._replace(decompressor=BOUNDED.get(chunk.decompressor, chunk.decompressor))

    def messages(
        self, connections: Collection[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield connection, time and the message as CDR."""
        wanted = {each.id: each for each in connections or self.connections}
        for each in wanted.values():
            if not _has_known_fields(each):
                raise InputError(
                    f"the definition of {each.msgtype} on '{each.topic}' differs from ROS Noetic:",
                    "record the topic with the definition of Noetic",
                )
        for each, time_ns, data in super().messages(connections, start, stop):
            connection = wanted[each.id]
            yield connection, time_ns, cdr_of_ros1(data, connection.msgtype)


def _has_known_fields(connection: Connection) -> bool:
    """Return whether the fields are those of ROS Noetic, ignoring case, because rosbags-convert writes `k` for `K`."""
    msgtype = connection.msgtype
    if msgtype not in _ROS1.fielddefs:
        return True
    if connection.digest in ("*", _ROS1.generate_msgdef(msgtype, ros_version=1)[1]):
        return True
    given = get_types_from_msg(connection.msgdef.data, msgtype)
    return all(_fields(item) == _fields(_ROS1.fielddefs.get(name, ([], []))) for name, item in given.items())


def _fields(definition: Any) -> list[tuple[str, Any]]:  # noqa: ANN401 - a type definition of rosbags
    return [(name.lower(), kind) for name, kind in definition[1]]


BagReader: TypeAlias = McapFile | Sqlite3Reader | Ros1Reader


@contextmanager
def opened_readers(files: BagFiles) -> Iterator[list[BagReader]]:
    """Open the files of a bag; files that are compressed as a whole are decompressed to a temporary folder."""
    with ExitStack() as stack:
        paths = [*files.paths]
        if files.compression == "file":
            folder = Path(stack.enter_context(TemporaryDirectory()))
            paths = [unpack_zstd_file(path, folder) for path in paths]
        readers = [_reader_of(path, is_finished=files.has_metadata) for path in paths]
        for reader in readers:
            reader.open()
            stack.callback(reader.close)
        yield readers


def _reader_of(path: Path, *, is_finished: bool) -> BagReader:
    """Return the reader of a storage file; `is_finished`: its recording has ended, so that the file is complete."""
    if is_ros1_bag(path):
        return Ros1Reader(path)
    if suffix_of(path) == ".mcap":
        return McapFile(path, recovers=not is_finished)
    if suffix_of(path) == ".db3":
        return Sqlite3Reader(path)
    raise InputError(f"'{path.name}' ends in '{path.suffix}':", ".mcap, .db3 or .bag is required")


def messages_of_readers(
    readers: Sequence[BagReader], topics: Collection[str], *, are_compressed: bool
) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield connection, time (ns) and content of the messages on topics, in the order of time.

    `are_compressed`: each message is compressed by zstd. Files that do not overlap in time, as those of a split
    recording, are read one after the other, so that only one of them is in memory.
    """
    last_ns = -1
    groups: list[list[Iterator[tuple[Connection, int, bytes]]]] = []
    for reader in sorted(readers, key=lambda reader: reader.metadata.start_time):
        wanted = [each for each in reader.connections if each.topic in topics]
        if not wanted:
            continue
        if reader.metadata.start_time > last_ns:
            groups.append([])
        groups[-1].append(reader.messages(wanted))
        last_ns = max(last_ns, reader.metadata.end_time)
    for group in groups:
        for connection, time_ns, data in heapq.merge(*group, key=lambda message: message[1]):
            yield connection, time_ns, unpack_zstd(data) if are_compressed else data


def message_count(readers: Sequence[BagReader]) -> int:
    """Return the number of messages in files, with any encoding."""
    return sum(reader.metadata.message_count for reader in readers)
