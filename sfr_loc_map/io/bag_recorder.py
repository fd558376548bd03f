"""Writes an mcap bag that is whole at any moment, for recordings that may end by a crash.

After each chunk the file gets an end record, which the next chunk overwrites, so that any reader takes what is there;
a bag that was closed has an index and metadata.yaml as well. What a crash of the host may cost is bounded by writing
to the disk each second.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any

from rosbags.interfaces import Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from sfr_loc_map.errors import OutputError
from sfr_loc_map.io.bag_writer import CheckedMcapWriter
from sfr_loc_map.io.mcap_recovery import MAGIC

CHUNK_BYTES = 8 * 2**20
SYNC_S = 1.0
DATA_END = b"\x0f" + (4).to_bytes(8, "little") + bytes(4)
FOOTER = b"\x02" + (20).to_bytes(8, "little") + bytes(20)
END = DATA_END + FOOTER + MAGIC
"""End of a file without an index (mcap specification: Data End, Footer, Magic)."""


class _Part(BytesIO):
    """What is to be written at an offset of the file; positions count from the start of the file."""

    def __init__(self, begin: int) -> None:
        super().__init__()
        self._begin = begin

    def tell(self) -> int:
        return super().tell() + self._begin

    def seek(self, offset: int, whence: int = 0) -> int:
        return super().seek(offset - self._begin, whence) + self._begin

    def close(self) -> None:
        """Keep what is to be written; the memory is freed with the object."""


class _SafeMcapWriter(CheckedMcapWriter):
    """Writes chunk and end in one go; when the disk is full the file keeps what it had."""

    bio: Any

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self._file = self.bio
        self._offset = self.bio.tell()
        self._file.flush()
        self.bio = _Part(self._offset)
        self._put(END)

    def close_chunk(self) -> None:
        """End the chunk if it is large enough."""
        if self.chunk.bio.tell() > CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Write what has been gathered."""
        if not self.chunk.bio.tell():
            return
        super().close_chunk()
        data = self.bio.getvalue()
        self._put(data + END)
        self._offset += len(data)
        self.bio = _Part(self._offset)

    def sync(self) -> None:
        """Let the system bring to the disk what was written."""
        os.fdatasync(self._file.fileno())

    def close(self, version: int, metadata: str) -> None:
        """Write the index."""
        self.flush()
        super().close(version, metadata)
        self._put(self.bio.getvalue())
        self.sync()
        self._file.close()

    def abort(self) -> None:
        """Leave the file as it is: it has an end."""
        self._file.close()

    def _put(self, data: bytes) -> None:
        number, done = self._file.fileno(), 0
        try:
            while done < len(data):
                done += os.pwrite(number, memoryview(data)[done:], self._offset + done)
        except OSError:
            os.ftruncate(number, self._offset)
            os.pwrite(number, END, self._offset)
            raise


class _SafeWriter(Writer):
    STORAGE_PLUGINS = MappingProxyType({StoragePlugin.MCAP: _SafeMcapWriter})


class BagRecorder:
    """A bag that messages are added to as they come; a context manager. What was flushed stays, however it ends.

    Attributes:
        count: Messages added.
    """

    def __init__(self, path: Path, *, zstd: bool = False) -> None:
        """Prepare a bag.

        Args:
            path: Folder of the bag; must not exist.
            zstd: Whether chunks are compressed.

        Raises:
            OutputError: If something is there.
        """
        if path.exists():
            raise OutputError(f"cannot record to '{path}': it exists; choose another name")
        self.path = path
        self.count = 0
        self._writer = _SafeWriter(path, version=9, storage_plugin=StoragePlugin.MCAP)
        if zstd:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._last_ns = 0
        self._stop = threading.Event()
        self._syncing = threading.Thread(target=self._sync, name="sync", daemon=True)

    def __enter__(self) -> BagRecorder:
        """Make the bag.

        Raises:
            OutputError: If that is not possible.
        """
        try:
            self._writer.open()
        except OSError as error:
            raise OutputError(f"cannot record to '{self.path}': {error.strerror}; choose another path") from error
        self._syncing.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the bag; after an error it stays as it is, which any reader can read.

        Raises:
            OutputError: If the disk is full.
        """
        self._stop.set()
        self._syncing.join()
        if kind is not None:
            self._writer.abort()
            return
        try:
            self._writer.close()
        except OSError as failure:
            self._writer.abort()
            raise self._broke_off(failure) from failure

    def add_topic(self, name: str, msgtype: str, definition: str, type_hash: str, offers: Sequence[Qos]) -> Any:  # noqa: ANN401
        """Add a topic.

        Args:
            name: With leading slash.
            msgtype: As `sensor_msgs/msg/Image`.
            definition: Text of the type and those within it, as mcap has it; may be empty.
            type_hash: RIHS01 of the type.
            offers: Quality of service of its publishers.

        Returns:
            What `write` takes.
        """
        return self._writer.add_connection(
            name, msgtype, msgdef=definition, rihs01=type_hash, offered_qos_profiles=offers
        )

    def write(self, topic: Any, received_ns: int, raw: bytes) -> None:  # noqa: ANN401
        """Add a serialised message.

        Raises:
            OutputError: If the disk is full; what was flushed before stays.
        """
        self._last_ns = max(self._last_ns, received_ns)  # files without an index are read in the order of time
        try:
            self._writer.write(topic, self._last_ns, raw)
        except OSError as error:
            raise self._broke_off(error) from error
        self.count += 1

    def flush(self) -> None:
        """Make what was added readable for others.

        Raises:
            OutputError: If the disk is full.
        """
        try:
            self._storage.flush()
        except OSError as error:
            raise self._broke_off(error) from error

    @property
    def _storage(self) -> _SafeMcapWriter:
        storage = self._writer.storage
        assert isinstance(storage, _SafeMcapWriter)
        return storage

    def _sync(self) -> None:
        storage = self._storage
        while not self._stop.wait(SYNC_S):
            try:
                storage.sync()
            except OSError:
                return  # the next write says it

    def _broke_off(self, error: OSError) -> OutputError:
        return OutputError(
            f"recording to '{self.path}' broke off after {self.count} messages: {error.strerror}; all but the last "
            f"second is there, free some space and record on under another name"
        )
