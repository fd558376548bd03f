"""Reads mcap files that were not closed: what was written whole is there, only the index at the end is missing.

Records and their order: the mcap specification (mcap.dev/spec), sections "Records" and "Data Section".
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from types import MappingProxyType

from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_mcap import McapReader, decompress

MAGIC = b"\x89MCAP0\r\n"
HEADER, CHUNK, DATA_END = 0x01, 0x06, 0x0F
RECORD_HEAD = 9
"""Opcode and length."""
NEVER = 2**63 - 1


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


class _RecoveringMcapReader(McapReader):
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


class RecoveringReader(Reader):
    """Reader of bags that also takes mcap files without an end."""

    STORAGE_PLUGINS = MappingProxyType({**Reader.STORAGE_PLUGINS, ".mcap": _RecoveringMcapReader})
