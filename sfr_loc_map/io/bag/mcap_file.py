"""Reads MCAP files (mcap.dev/spec) of any profile, and limits the data that are decompressed at the same time.

A complete file is read by the index in its summary. A file without an index, or one that was not closed, is read
record by record. A file that was not closed is read up to the last complete record, if the caller permits this.
"""

from __future__ import annotations

import heapq
import struct
from binascii import crc32
from collections import Counter
from collections.abc import Collection, Generator, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.metadata import ReaderMetadata, parse_qos

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import expansion_limit
from sfr_loc_map.io.bag.encoding import cdr_of_ros1, is_ros1, readable
from sfr_loc_map.io.bag.files import MCAP_MAGIC, is_unfinished
from sfr_loc_map.io.bag.unpacking import unpack_lz4, unpack_zstd
from sfr_loc_map.json_yaml import parse_yaml

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06  #: Opcodes of records.
CHUNK_INDEX, STATISTICS, DATA_END = 0x08, 0x0B, 0x0F
RECORD_HEAD = struct.Struct("<BQ")  #: Opcode and length of a record.
MESSAGE_HEAD = struct.Struct("<HIQQ")  #: Channel, sequence, time of recording, time of publishing.
CHUNK_HEAD = struct.Struct("<QQQI")  #: First and last time, size and checksum (CRC-32) of the content.
CHECKSUM_BYTES = 4
FOOTER_BYTES = 20  #: Offset of the summary, offset of the list of its parts, and a checksum.
FOOTER_SIZE = RECORD_HEAD.size + FOOTER_BYTES
LATEST_NS = 2**63 - 1  #: Largest time of recording.
NO_MESSAGES = ReaderMetadata(
    duration=0,
    start_time=LATEST_NS,
    end_time=0,
    message_count=0,
    compression_format=None,
    compression_mode=None,
    ros_distro=None,
    custom=None,
)
DEFINITIONS = {
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
}
"""Formats of type definitions by schema encoding. ROS does not use other encodings (protobuf, JSON)."""


class Chunk(NamedTuple):
    """A chunk of messages."""

    start_ns: int  #: Time of its first message.
    end_ns: int  #: Time of its last message.
    offset: int  #: Offset of its record in the file, bytes.
    size: int  #: Size of its decompressed content, bytes.
    channels: frozenset[int]  #: Channels of its messages; empty if unknown.


class LooseMessage(NamedTuple):
    """A message outside of chunks."""

    time_ns: int
    channel: int
    offset: int  #: Offset of its data in the file, bytes.
    size: int  #: Size of its data, bytes.


class McapFile:
    """Connections, metadata and messages of one file: a storage plugin of `rosbags.rosbag2.Reader`."""

    def __init__(self, path: Path, *, recovers: bool = False) -> None:
        """Set the path of the file that `open` opens.

        `recovers`: a file that was not closed is read up to the last complete record. Otherwise `open` raises an error.
        """
        self.path = Path(str(path))
        self._recovers = recovers
        self.connections: list[Connection] = []
        self.metadata = NO_MESSAGES
        self._file: BinaryIO | None = None
        self._chunks: list[Chunk] = []
        self._loose: list[LooseMessage] = []

    def open(self) -> None:
        """Read the index, or the complete file without an index; raise ReaderError if it is corrupt or not MCAP."""
        self._file = self.path.open("rb")
        try:
            contents = self._contents(self._file)
            self._chunks = sorted(contents.chunks)
            self._loose = sorted(contents.loose)
            _check_overlaps(self._chunks)
            counts = contents.counts
            found = [each._replace(owner=self, msgcount=counts[each.id]) for each in contents.connections.values()]
            self.connections = readable(found)
            total = counts.total()
            if total:
                start_ns, end_ns = contents.start_ns, contents.end_ns + 1
                self.metadata = NO_MESSAGES._replace(
                    duration=end_ns - start_ns, start_time=start_ns, end_time=end_ns, message_count=total
                )
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
        self._file = None
        self.connections = []
        self.metadata = NO_MESSAGES
        self._chunks = []
        self._loose = []

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield connection, time and CDR of the messages from `start` until before `stop` (ns), in order of time."""
        wanted = {each.id: each for each in connections}
        low = 0 if start is None else start
        high = LATEST_NS if stop is None else stop
        streams = (self._in_chunks(wanted.keys(), low, high), self._outside_chunks())
        for time_ns, channel, data in heapq.merge(*streams, key=lambda message: message[0]):
            connection = wanted.get(channel)
            if connection is None or not low <= time_ns < high:
                continue
            yield connection, time_ns, cdr_of_ros1(data, connection.msgtype) if is_ros1(connection) else data

    def _in_chunks(self, wanted: Collection[int], low: int, high: int) -> Iterator[tuple[int, int, bytes]]:
        """Yield time, channel and data of the wanted channels' messages inside chunks, in order of time."""
        assert self._file
        pending: list[tuple[int, int, int, bytes]] = []
        count = 0
        for chunk in self._chunks:
            if chunk.start_ns >= high or chunk.end_ns < low:
                continue
            if chunk.channels and chunk.channels.isdisjoint(wanted):
                continue
            while pending and pending[0][0] < chunk.start_ns:
                time_ns, _, channel, data = heapq.heappop(pending)
                yield time_ns, channel, data
            content = _chunk_content(self._file, chunk.offset)
            for time_ns, channel, data in _messages_in(content, wanted):
                heapq.heappush(pending, (time_ns, count, channel, data))
                count += 1
        while pending:
            time_ns, _, channel, data = heapq.heappop(pending)
            yield time_ns, channel, data

    def _outside_chunks(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield time, channel and data of the messages outside of chunks, in order of time."""
        assert self._file
        for message in self._loose:
            self._file.seek(message.offset)
            yield message.time_ns, message.channel, _exactly(self._file, message.size)

    def _contents(self, file: BinaryIO) -> _Contents:
        size = file.seek(0, 2)
        file.seek(0)
        if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            raise ReaderError("it does not begin as an MCAP file")
        head = _record_head(file, size)
        if head is None or head[0] != HEADER:
            raise ReaderError("its first record is incomplete or is not the header")
        start = head[1] + head[2]
        if self._recovers and is_unfinished(self.path):
            return _scanned(file, start, size, is_cut_off=True)
        end = size - len(MCAP_MAGIC) - FOOTER_SIZE
        summary_start = _summary_start(file, start, end)
        by_summary = _summary(file, summary_start, end) if summary_start else None
        return by_summary or _scanned(file, start, summary_start or end, is_cut_off=False)


class _Contents:
    """The contents of a file, which are collected record by record."""

    def __init__(self) -> None:
        self.definitions: dict[int, tuple[str, MessageDefinition]] = {}  # type name and definition by schema
        self.connections: dict[int, Connection] = {}
        self.chunks: list[Chunk] = []
        self.loose: list[LooseMessage] = []
        self.counts: Counter[int] = Counter()
        self.start_ns = LATEST_NS
        self.end_ns = 0

    def define(self, opcode: int, content: bytes) -> None:
        """Add the schema or the channel that a record defines; other records are ignored."""
        if opcode == SCHEMA:
            fields = _Fields(content)
            schema, name, encoding = fields.number("<H"), fields.text(), fields.text()
            data = fields.sized()
            kind = DEFINITIONS.get(encoding)
            definition = MessageDefinition(MessageDefinitionFormat.NONE, "")
            if kind is not None:
                definition = MessageDefinition(kind, data.decode())
            self.definitions[schema] = name, definition
        elif opcode == CHANNEL:
            fields = _Fields(content)
            channel, schema, topic, encoding = fields.number("<H"), fields.number("<H"), fields.text(), fields.text()
            no_schema = "__schemaless__", MessageDefinition(MessageDefinitionFormat.NONE, "")
            msgtype, definition = self.definitions.get(schema, no_schema)
            offers = ConnectionExtRosbag2(encoding, _qos(fields.sized()))
            self.connections.setdefault(channel, Connection(channel, topic, msgtype, definition, "", 0, offers, None))

    def count(self, channel: int, time_ns: int) -> None:
        """Count a message."""
        self.counts[channel] += 1
        self.start_ns = min(self.start_ns, time_ns)
        self.end_ns = max(self.end_ns, time_ns)


# ---- complete files: footer and summary


def _summary_start(file: BinaryIO, start: int, end: int) -> int:
    """Return the offset of the summary, 0 without a summary; the records before the footer are in `start` to `end`."""
    if end < start:
        raise ReaderError("it is too short for the footer of an MCAP file")
    file.seek(end)
    footer = _exactly(file, FOOTER_SIZE)
    if RECORD_HEAD.unpack_from(footer) != (FOOTER, FOOTER_BYTES) or file.read() != MCAP_MAGIC:
        raise ReaderError("it does not end with the footer of an MCAP file")
    (summary_start,) = struct.unpack_from("<Q", footer, RECORD_HEAD.size)
    if summary_start and not start <= summary_start <= end:
        raise ReaderError(f"its footer places the summary at byte {summary_start}: {start} to {end} is required")
    return int(summary_start)


def _summary(file: BinaryIO, start: int, end: int) -> _Contents | None:
    """Return the contents of the file from its summary; None if the summary is incomplete."""
    contents = _Contents()
    chunk_count = message_count = schema_count = channel_count = -1
    for opcode, content in _records(_at(file, start, end - start)):
        if opcode == CHUNK_INDEX:
            contents.chunks.append(_chunk_of_index(content))
        elif opcode == STATISTICS:
            fields = _Fields(content)
            message_count, schema_count, channel_count = fields.number("<Q"), fields.number("<H"), fields.number("<I")
            _, _, chunk_count = fields.number("<I"), fields.number("<I"), fields.number("<I")
            contents.start_ns, contents.end_ns = fields.number("<Q"), fields.number("<Q")
            contents.counts = Counter(dict(struct.iter_unpack("<HQ", fields.sized())))
        else:
            contents.define(opcode, content)
    has_definitions = (len(contents.definitions), len(contents.connections)) == (schema_count, channel_count)
    has_index = len(contents.chunks) == chunk_count and (chunk_count > 0 or message_count == 0)
    has_counts = contents.counts.total() == message_count
    return contents if has_definitions and has_index and has_counts else None


def _chunk_of_index(content: bytes) -> Chunk:
    fields = _Fields(content)
    start_ns, end_ns, offset, _ = (fields.number("<Q") for _ in range(4))
    channels = frozenset(channel for channel, _ in struct.iter_unpack("<HQ", fields.sized()))
    fields.number("<Q")  # length of the message indexes
    fields.text()  # compression, which the chunk repeats
    fields.number("<Q")  # compressed size, which the chunk repeats
    return Chunk(start_ns, end_ns, offset, fields.number("<Q"), channels)


# ---- files without an index


def _scanned(file: BinaryIO, start: int, end: int, *, is_cut_off: bool) -> _Contents:
    """Return the contents of the records from `start` to `end`; with `is_cut_off`, up to the last complete record."""
    contents = _Contents()
    offset = start
    while offset < end:
        file.seek(offset)
        head = _record_head(file, end)
        if head is None or head[0] == 0:
            if is_cut_off:
                break
            raise ReaderError(f"the record at byte {offset} is incomplete")
        opcode, begin, size = head
        if opcode in (FOOTER, DATA_END):
            break
        if opcode == MESSAGE:
            if size < MESSAGE_HEAD.size:
                raise ReaderError(
                    f"the message at byte {offset} has {size} bytes: at least {MESSAGE_HEAD.size} are required"
                )
            channel, _, time_ns, _ = MESSAGE_HEAD.unpack(_exactly(file, MESSAGE_HEAD.size))
            contents.count(channel, time_ns)
            place = begin + MESSAGE_HEAD.size
            contents.loose.append(LooseMessage(time_ns, channel, place, size - MESSAGE_HEAD.size))
        elif opcode == CHUNK:
            try:
                unpacked = _chunk_content(file, offset)
            except Exception:  # decompressors raise various exceptions for corrupt data
                if is_cut_off:
                    break
                raise
            contents.chunks.append(_scanned_chunk(contents, offset, unpacked))
        elif opcode in (SCHEMA, CHANNEL):
            contents.define(opcode, _exactly(file, size))
        offset = begin + size
    return contents


def _scanned_chunk(contents: _Contents, offset: int, unpacked: bytes) -> Chunk:
    """Add the records of a chunk to the contents, and return the chunk."""
    times: list[int] = []
    channels: set[int] = set()
    for opcode, content in _records(unpacked):
        if opcode == MESSAGE:
            channel, _, time_ns, _ = MESSAGE_HEAD.unpack_from(content)
            contents.count(channel, time_ns)
            times.append(time_ns)
            channels.add(channel)
        else:
            contents.define(opcode, content)
    return Chunk(min(times, default=0), max(times, default=0), offset, len(unpacked), frozenset(channels))


# ---- records


class _Fields:
    """Reads the fields of a record one after the other."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._place = 0

    @property
    def is_left(self) -> bool:
        """Whether there are more fields."""
        return self._place < len(self._content)

    def number(self, layout: str) -> int:
        """Return a number of a layout of `struct`."""
        (value,) = self.numbers(struct.Struct(layout))
        return int(value)

    def numbers(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Return several numbers."""
        return layout.unpack(self._bytes(layout.size))

    def sized(self, length: str = "<I") -> bytes:
        """Return the bytes of a field that begins with its length, a number of the layout `length`."""
        return self._bytes(self.number(length))

    def text(self) -> str:
        return self.sized().decode()

    def _bytes(self, size: int) -> bytes:
        data = self._content[self._place : self._place + size]
        if len(data) < size:
            raise ReaderError(f"a field of {size} bytes is longer than its record")
        self._place += size
        return data


def _record_head(file: BinaryIO, end: int) -> tuple[int, int, int] | None:
    """Return opcode, content offset and content size of the record at the file position; None if it is incomplete."""
    head = file.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        return None
    opcode, size = RECORD_HEAD.unpack(head)
    begin = file.tell()
    return None if begin + size > end else (opcode, begin, size)


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record."""
    place = 0
    while place < len(data):
        if place + RECORD_HEAD.size > len(data):
            raise ReaderError("it ends within a record")
        opcode, size = RECORD_HEAD.unpack_from(data, place)
        place += RECORD_HEAD.size
        if place + size > len(data):
            raise ReaderError(f"a record of {size} bytes is longer than the record that contains it")
        yield opcode, data[place : place + size]
        place += size


def _messages_in(content: bytes, wanted: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
    """Yield time, channel and data of the wanted channels' messages in a chunk."""
    for opcode, record in _records(content):
        if opcode == MESSAGE:
            channel, _, time_ns, _ = MESSAGE_HEAD.unpack_from(record)
            if channel in wanted:
                yield time_ns, channel, record[MESSAGE_HEAD.size :]


def _chunk_content(file: BinaryIO, offset: int) -> bytes:
    """Return the decompressed chunk at an offset of a file.

    Raises ReaderError or ValueError if the chunk is corrupt or too large, and InputError if its compression is not
    supported.
    """
    size = file.seek(0, 2)
    file.seek(offset)
    head = _record_head(file, size)
    if head is None or head[0] != CHUNK:
        raise ReaderError(f"there is no complete chunk at byte {offset}")
    fields = _Fields(_exactly(file, head[2]))
    _, _, unpacked_size, checksum = fields.numbers(CHUNK_HEAD)
    compression, packed = fields.text(), fields.sized("<Q")
    if compression == "zstd":
        content = unpack_zstd(packed, unpacked_size)
    elif compression == "lz4":
        content = unpack_lz4(packed, unpacked_size)
    elif not compression:
        content = packed
    else:
        raise InputError(
            f"its chunks are compressed by '{compression}', which is not supported:",
            "compress them by zstd or lz4, or not at all",
        )
    if len(content) != unpacked_size:
        raise ReaderError(f"the chunk at byte {offset} contains {len(content)} bytes but declares {unpacked_size}")
    if checksum and crc32(content) != checksum:
        raise ReaderError(f"the checksum of the chunk at byte {offset} is wrong")
    return content


def _check_overlaps(chunks: Collection[Chunk]) -> None:
    """Raise InputError if chunks that overlap in time, and so are held at the same time, are too large in total."""
    edges = [(chunk.start_ns, chunk.size) for chunk in chunks]
    edges += [(chunk.end_ns, -chunk.size) for chunk in chunks]
    limit = max([2 * expansion_limit(0), *(chunk.size for chunk in chunks)])
    at_once = 0
    for _, size in sorted(edges, key=lambda edge: (edge[0], -edge[1])):  # a chunk may begin and end at the same time
        at_once += size
        if at_once > limit:
            raise InputError(
                f"chunks that overlap in time require more than {limit} bytes of memory:",
                "sort the messages of the bag by time, or record with smaller chunks",
            )


def _qos(metadata: bytes) -> list[Any]:
    """Return the offered QoS profiles of a channel; empty if its metadata have none."""
    fields = _Fields(metadata)
    entries: dict[str, str] = {}
    while fields.is_left:
        name = fields.text()
        entries[name] = fields.text()
    return list(_parsed_qos(entries.get("offered_qos_profiles", "")))


@lru_cache(maxsize=256)
def _parsed_qos(text: str) -> tuple[Any, ...]:
    return tuple(parse_qos(parse_yaml(text) or []))


def _at(file: BinaryIO, offset: int, size: int) -> bytes:
    file.seek(offset)
    return _exactly(file, size)


def _exactly(file: BinaryIO, size: int) -> bytes:
    """Return the next `size` bytes of a file; raise ReaderError if there are fewer."""
    data = file.read(size)
    if len(data) != size:
        raise ReaderError(f"it ends {len(data)} bytes into a block of {size} bytes")
    return data
