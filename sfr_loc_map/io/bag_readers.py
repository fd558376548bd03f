"""The readers of the library of bags, with bounds: whatever is compressed is bounded before it is unpacked.

Of mcap files that were not closed only the index at the end is missing (mcap.dev/spec, "Records", "Data Section").
Messages of ROS 1 (format 2.0) are given as CDR, without the sequence number of their headers.
"""

from __future__ import annotations

import bz2
import sys
from collections.abc import Callable, Collection, Generator, Sequence
from functools import lru_cache
from io import BytesIO
from pathlib import Path, PurePath
from types import MappingProxyType, SimpleNamespace
from typing import Any, TypeAlias

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags import rosbag1
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1.reader import ChunkInfo, decompressors
from rosbags.rosbag1.reader import ReaderError as Ros1Error
from rosbags.rosbag2 import Reader, metadata, reader, storage_mcap
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, McapReader, Statistics, decompress
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import check_regular, expansion_limit, parse_yaml, read_text
from sfr_loc_map.io.bag_files import MCAP_MAGIC, is_ros1_bag, is_unfinished

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

HEADER, CHUNK, DATA_END = 0x01, 0x06, 0x0F  #: Opcodes of mcap.
RECORD_HEAD = 9  #: Opcode and length of a record of mcap.
NEVER = 2**63 - 1
CDR, ROS1 = "cdr", "ros1"  #: How messages of ROS 2 and ROS 1 are written; channels of other kinds are skipped.
FOOTER = b"\x02\x14" + bytes(7)  #: Opcode and length of the footer of mcap.
FOOTER_SIZE = len(FOOTER) + 20 + len(MCAP_MAGIC)
METADATA = "rosbag2_bagfile_information"
OLD_TYPES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}  #: Older names of types of ROS 1 that are read.
_ROS1, _ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)


def unpack(data: bytes, new: Callable[[], Any], size: int | None = None) -> bytes:
    """Return what compressed frames hold; `new` makes a decompressor of one, `size` is how many bytes are announced."""
    most = expansion_limit(len(data))
    if size is not None and size > most:  # before memory is taken
        raise ValueError(f"compressed data of {len(data)} bytes claims to hold {size}: up to {most} are read")
    limit, parts, total, rest = most if size is None else size, [], 0, data
    while rest:
        decompressor = new()
        parts.append(bytes(decompressor.decompress(rest, max_length=limit - total + 1)))
        total += len(parts[-1])
        if total > limit:
            raise ValueError(f"compressed data of {len(data)} bytes holds more than {limit}")
        if not decompressor.eof:
            raise ValueError("compressed data ends within a frame")
        rest = decompressor.unused_data
    return parts[0] if len(parts) == 1 else b"".join(parts)


def check_zstd_file(path: Path) -> None:
    """Check how much a zstd file holds, without keeping it."""
    limit, total = expansion_limit(path.stat().st_size), 0
    with path.open("rb") as raw, zstd.open(raw, "rb") as stream:
        while part := stream.read(2**20):
            total += len(part)
            if total > limit:
                raise ValueError(f"'{path.name}' holds more than {limit} bytes once decompressed")


# the library's own take any amount of memory
DECOMPRESSORS.update(
    zstd=lambda data, size: unpack(data, zstd.ZstdDecompressor, size),
    lz4=lambda data, size: unpack(data, LZ4FrameDecompressor, size),
)
decompressors.update(
    bz2=lambda data: unpack(data, bz2.BZ2Decompressor), lz4=lambda data: unpack(data, LZ4FrameDecompressor)
)


def _definition(schema: Any, read: Callable[[Any], MessageDefinition] = storage_mcap.get_msgdef) -> MessageDefinition:  # noqa: ANN401
    """Return the definition of a schema; of one that is not of ROS (protobuf, JSON) none, where the library raises."""
    try:
        return read(schema)
    except KeyError:
        return MessageDefinition(MessageDefinitionFormat.NONE, "")


storage_mcap.get_msgdef = _definition
# the library's own parser takes 0.04 s for each pass through a bag, and any depth
_parsed = lru_cache(maxsize=256)(parse_yaml)
_YAML = SimpleNamespace(load=_parsed, dump=vars(metadata)["YAML"](typ="safe").dump)
vars(reader).update(YAML=lambda **_: _YAML)
vars(metadata).update(YAML=lambda **_: _YAML)


def _encoding(connection: Connection) -> str:
    return str(getattr(connection.ext, "serialization_format", ""))


def _of_ros2(connection: Connection) -> Connection:
    """Return a connection with its type named as in ROS 2: `sensor_msgs/Image` becomes `sensor_msgs/msg/Image`."""
    package, _, name = connection.msgtype.rpartition("/")
    if _encoding(connection) != ROS1 or not package:
        return connection
    msgtype = f"{package.removesuffix('/msg')}/msg/{name}"
    return connection._replace(msgtype=OLD_TYPES.get(msgtype, msgtype))


def readable(connections: Sequence[Connection]) -> list[Connection]:
    """Return the connections whose messages are of ROS 2 or ROS 1; InputError if all are written in another way."""
    found = [_of_ros2(each) for each in connections if _encoding(each) in (CDR, ROS1, "")]
    if connections and not found:
        written = ", ".join(sorted({_encoding(each) for each in connections}))
        raise InputError(
            f"its messages are encoded as {written}: messages of ROS 2 (cdr) or ROS 1 (ros1) are required; record or "
            "convert it as a ROS bag"
        )
    return found


class _BoundedMcapReader(McapReader):
    """Reads a file whose chunks fit the memory, also where their times overlap: these are unpacked at the same time.

    Its channels say what its messages are, not its profile, which merged and converted files have of another kind.
    Messages of ROS 1 are given as CDR.
    """

    def _open(self) -> None:
        self._read_summary()
        self.connections = readable(self.connections)
        self._count()
        edges = [(c.message_start_time, c.uncompressed_size) for c in self.chunks]
        edges += [(c.message_end_time, -c.uncompressed_size) for c in self.chunks]
        at_once, limit = 0, max([2 * expansion_limit(0), *(c.uncompressed_size for c in self.chunks)])
        for _, size in sorted(edges):
            at_once += size
            if at_once > limit:
                raise ReaderError(f"chunks of more than {limit} bytes overlap in time")

    def _read_summary(self) -> None:
        """Read header, footer and summary, whatever the profile."""
        assert self.bio
        size = self.bio.seek(0, 2)
        self.bio.seek(0)
        head = self.bio.read(len(MCAP_MAGIC) + RECORD_HEAD)
        footer_start = size - FOOTER_SIZE
        self.data_start = len(head) + int.from_bytes(head[len(MCAP_MAGIC) + 1 :], "little")
        if not head.startswith(MCAP_MAGIC) or head[len(MCAP_MAGIC)] != HEADER or footer_start < self.data_start:
            raise ReaderError("File magic or header is invalid.")
        self.bio.seek(footer_start)
        footer = self.bio.read()
        if not footer.endswith(MCAP_MAGIC) or not footer.startswith(FOOTER):
            raise ReaderError("Invalid MCAP footer.")
        summary_start = int.from_bytes(footer[len(FOOTER) : len(FOOTER) + 8], "little")
        if summary_start and not self.data_start <= summary_start <= footer_start:
            raise ReaderError("Invalid MCAP summary offset.")
        self.data_end = summary_start or footer_start
        if summary_start:
            self.read_index()
        if self.statistics is None and self.chunks:
            counts: dict[int, int] = {}
            for channel, count in (item for chunk in self.chunks for item in chunk.channel_count.items()):
                counts[channel] = counts.get(channel, 0) + count
            times = [chunk.message_start_time for chunk in self.chunks], [c.message_end_time for c in self.chunks]
            sizes = (sum(counts.values()), len(self.schemas), len(self.channels), 0, 0, len(self.chunks))
            self.statistics = Statistics(*sizes, min(times[0]), max(times[1]), counts)
        elif self.statistics is None or not self.schemas:
            self.meta_scan()

    def _count(self) -> None:
        """Take the numbers of messages and the times of the statistics."""
        assert self.statistics
        counts, count = self.statistics.channel_message_counts, self.statistics.message_count
        start, end = (self.statistics.start_time, self.statistics.end_time + 1) if count else (NEVER, 0)
        self.connections = [each._replace(msgcount=counts.get(each.id, 0)) for each in self.connections]
        self.metadata = self.metadata._replace(
            duration=end - start if count else 0, start_time=start, end_time=end, message_count=count
        )

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        for connection, time_ns, data in super().messages(connections, start, stop):
            is_ros1 = _encoding(connection) == ROS1
            yield connection, time_ns, bytes(_ROS2.ros1_to_cdr(data, connection.msgtype)) if is_ros1 else data


class _RecoveringMcapReader(_BoundedMcapReader):
    """Reads a file without an end up to its last whole record."""

    def _open(self) -> None:
        if not is_unfinished(Path(str(self.path))):
            super()._open()
            return
        assert self.bio
        size = self.bio.seek(0, 2)
        self.data_end = len(MCAP_MAGIC)
        while (following := self._after(self.data_end, size)) is not None:
            self.data_start = self.data_start or following
            self.data_end = following
        if not self.data_start:
            raise ReaderError("it ends within its first record")
        self.meta_scan()
        self.connections = readable(self.connections)
        self._count()

    def _after(self, offset: int, size: int) -> int | None:
        """Return where the record at an offset ends, None where there is no whole one of the data."""
        assert self.bio
        self.bio.seek(offset)
        head = self.bio.read(RECORD_HEAD)
        if len(head) < RECORD_HEAD or not HEADER <= head[0] < DATA_END:
            return None
        end = offset + RECORD_HEAD + int.from_bytes(head[1:], "little")
        if end > size or (head[0] == CHUNK and not _is_whole(BytesIO(self.bio.read(end - offset - RECORD_HEAD)))):
            return None
        return end


def _is_whole(chunk: BytesIO) -> bool:
    """Tell whether what a chunk holds can be unpacked and has its checksum."""
    try:
        chunk.seek(16)
        size, crc, length = (int.from_bytes(chunk.read(count), "little") for count in (8, 4, 4))
        compression = chunk.read(length).decode()
        decompress(chunk.read(int.from_bytes(chunk.read(8), "little")), compression, size, crc)
    except Exception:  # whatever a decompressor says of broken data
        return False
    return True


class _BoundedDirectoryReader(DirectoryReader):
    """Reads the folder of a bag: its metadata and compressed parts are bounded."""

    STORAGE_PLUGINS = MappingProxyType({**DirectoryReader.STORAGE_PLUGINS, "mcap": _BoundedMcapReader})
    _messages_compressed = False

    def open(self) -> None:
        """Check the metadata and the files before they are read."""
        path = Path(str(self.path))
        content = _parsed(read_text(path / "metadata.yaml"))
        information = content.get(METADATA) if isinstance(content, dict) else None
        if not isinstance(information, dict) or not isinstance(information.get("relative_file_paths"), list):
            raise ReaderError("metadata.yaml does not name the files of the bag")
        mode = str(information.get("compression_mode", "")).lower()
        for name in information["relative_file_paths"]:
            file = path / PurePath(str(name)).name
            if file.exists():  # the library says which are missing
                check_regular(file)
                if mode == "file":
                    check_zstd_file(file)
        super().open()
        self._messages_compressed = self.metadata.compression_mode == "message"
        self.metadata = self.metadata._replace(compression_mode=None)

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        for connection, time_ns, data in super().messages(connections, start, stop):
            yield connection, time_ns, unpack(data, zstd.ZstdDecompressor) if self._messages_compressed else data


class Ros2Reader(Reader):
    """Reader of a ROS 2 bag; a context manager."""

    STORAGE_PLUGINS = MappingProxyType(
        {**Reader.STORAGE_PLUGINS, "dir": _BoundedDirectoryReader, ".mcap": _RecoveringMcapReader}
    )


class Ros1Reader(rosbag1.Reader):
    """Reader of a ROS 1 bag; a context manager."""

    def open(self) -> None:
        """Read the index."""
        self._places: set[int] = set()
        super().open()
        self.connections = [c._replace(msgtype=OLD_TYPES.get(c.msgtype, c.msgtype)) for c in self.connections]

    def read_chunk_info(self) -> ChunkInfo:
        """Read the place of a chunk; a chunk that is listed twice would be read twice."""
        info = super().read_chunk_info()
        if info.pos in self._places:
            raise Ros1Error(f"the chunk at byte {info.pos} is listed twice.")
        self._places.add(info.pos)
        return info

    def messages(
        self, connections: Collection[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield connection, time and the message as CDR."""
        wanted = {each.id: each for each in connections or self.connections}
        for each in wanted.values():
            if not _has_known_fields(each):
                raise Ros1Error(f"{each.msgtype} of '{each.topic}' has other fields than that of ROS Noetic.")
        for each, time_ns, data in super().messages(connections, start, stop):
            connection = wanted[each.id]
            yield connection, time_ns, bytes(_ROS2.ros1_to_cdr(data, connection.msgtype))


def _has_known_fields(connection: Connection) -> bool:
    """Tell whether the messages are laid out as in ROS Noetic; rosbags-convert names fields as ROS 2 does, `k`."""
    msgtype = connection.msgtype
    if msgtype not in _ROS1.fielddefs:
        return True
    if connection.digest in ("*", _ROS1.generate_msgdef(msgtype, ros_version=1)[1]):
        return True
    given = get_types_from_msg(connection.msgdef.data, msgtype)
    return all(_fields(item) == _fields(_ROS1.fielddefs.get(name, ([], []))) for name, item in given.items())


def _fields(definition: Any) -> list[tuple[str, Any]]:  # noqa: ANN401 - a definition of the library
    return [(name.lower(), kind) for name, kind in definition[1]]


BagReader: TypeAlias = Ros2Reader | Ros1Reader


def reader_of(file: Path) -> BagReader:
    """Return what reads a file or folder of `bag_files.reader_paths`."""
    return Ros1Reader(file) if is_ros1_bag(file) else Ros2Reader(file)
