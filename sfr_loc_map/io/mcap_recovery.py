"""Readers of bags that are bounded, and take mcap files that were not closed.

Of such a file what was written whole is there, only the index at the end is missing. Whatever is compressed is bounded
before it is unpacked.

Records and their order: the mcap specification (mcap.dev/spec), sections "Records" and "Data Section".
"""

from __future__ import annotations

from collections.abc import Collection, Generator
from io import BytesIO
from pathlib import Path, PurePath
from types import MappingProxyType

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, McapReader, decompress

from sfr_loc_map.inputs import check_regular, parse_yaml, read_text
from sfr_loc_map.io.decompression import check_zstd_file, decompress_lz4, decompress_zstd, expansion_limit

MAGIC = b"\x89MCAP0\r\n"
HEADER, CHUNK, DATA_END = 0x01, 0x06, 0x0F
RECORD_HEAD = 9
"""Opcode and length."""
NEVER = 2**63 - 1
METADATA = "rosbag2_bagfile_information"
DECOMPRESSORS.update(zstd=decompress_zstd, lz4=decompress_lz4)  # the library's own take any amount of memory


def is_unfinished(path: Path) -> bool:
    """Tell whether a file is mcap that was not closed."""
    try:
        with path.open("rb") as stream:
            begins = stream.read(len(MAGIC)) == MAGIC
            stream.seek(0, 2)
            stream.seek(max(stream.tell() - len(MAGIC), 0))
            return begins and stream.read() != MAGIC
    except OSError:
        return False


class _BoundedMcapReader(McapReader):
    """Reads a file whose chunks fit the memory."""

    def _open(self) -> None:
        super()._open()
        self._check_overlap()

    def _check_overlap(self) -> None:
        """Check that chunks whose times overlap, which are unpacked at the same time, fit the memory."""
        edges = [(c.message_start_time, c.uncompressed_size) for c in self.chunks]
        edges += [(c.message_end_time, -c.uncompressed_size) for c in self.chunks]
        at_once, limit = 0, max([2 * expansion_limit(0), *(c.uncompressed_size for c in self.chunks)])
        for _, size in sorted(edges):
            at_once += size
            if at_once > limit:
                raise ReaderError(f"chunks of more than {limit} bytes overlap in time")


class _RecoveringMcapReader(_BoundedMcapReader):
    """Reads a file without an end up to its last whole record."""

    def _open(self) -> None:
        if not is_unfinished(Path(str(self.path))):
            super()._open()
            return
        assert self.bio
        self._find_data()
        self.meta_scan()
        assert self.statistics
        counts, count = self.statistics.channel_message_counts, self.statistics.message_count
        start, end = self.statistics.start_time, self.statistics.end_time
        self.connections = [each._replace(msgcount=counts.get(each.id, 0)) for each in self.connections]
        self.metadata = self.metadata._replace(
            duration=end - start + 1 if count else 0,
            start_time=start if count else NEVER,
            end_time=end + 1 if count else 0,
            message_count=count,
        )

    def _find_data(self) -> None:
        """Find the begin of the data and the end of the last whole record."""
        assert self.bio
        size = self.bio.seek(0, 2)
        offset = len(MAGIC)
        while (following := self._after(offset, size)) is not None:
            if offset == len(MAGIC):
                self.data_start = following
            offset = following
        if not self.data_start:
            raise ReaderError("it ends within its first record")
        self.data_end = offset

    def _after(self, offset: int, size: int) -> int | None:
        """Return where the record at an offset ends, None where there is no whole one of the data."""
        assert self.bio
        self.bio.seek(offset)
        head = self.bio.read(RECORD_HEAD)
        if len(head) < RECORD_HEAD or not HEADER <= head[0] < DATA_END:
            return None
        end = offset + RECORD_HEAD + int.from_bytes(head[1:], "little")
        if end > size or (head[0] == CHUNK and not _whole(self.bio.read(end - offset - RECORD_HEAD))):
            return None
        return end


def _whole(chunk: bytes) -> bool:
    """Tell whether what a chunk holds can be unpacked and has its checksum."""
    stream = BytesIO(chunk[16:])
    try:
        size, crc = int.from_bytes(stream.read(8), "little"), int.from_bytes(stream.read(4), "little")
        compression = stream.read(int.from_bytes(stream.read(4), "little")).decode()
        length = int.from_bytes(stream.read(8), "little")
        decompress(stream.read(length), compression, size, crc)
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
        content = parse_yaml(read_text(path / "metadata.yaml"))
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
        """Yield connection, time and bytes of messages."""
        for connection, time_ns, data in super().messages(connections, start, stop):
            yield connection, time_ns, decompress_zstd(data) if self._messages_compressed else data


class RecoveringReader(Reader):
    """Reader of bags that also takes mcap files without an end; compressed parts are bounded."""

    STORAGE_PLUGINS = MappingProxyType(
        {**Reader.STORAGE_PLUGINS, "dir": _BoundedDirectoryReader, ".mcap": _RecoveringMcapReader}
    )
