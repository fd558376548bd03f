"""Records messages to a ROS 2 bag (mcap) as they arrive.

A recording stays readable after a crash. Each chunk is followed by an end record, which the next chunk overwrites. The
file is synchronised with the disk once per second, which limits the loss if the host crashes.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rosbags.interfaces import Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from sfr_loc_map.errors import OutputError
from sfr_loc_map.io.bag.files import MCAP_MAGIC
from sfr_loc_map.io.bag.mcap_file import CHECKSUM_BYTES, DATA_END, FOOTER, FOOTER_BYTES, RECORD_HEAD
from sfr_loc_map.io.bag.writer import CheckedMcapWriter
from sfr_loc_map.message_text import counted

CHUNK_BYTES = 8 * 2**20  #: Size at which a recording ends a chunk, bytes.
SYNC_S = 1.0  #: Period at which a recording is synchronised with the disk, s.
_DATA_END = RECORD_HEAD.pack(DATA_END, CHECKSUM_BYTES) + bytes(CHECKSUM_BYTES)
_FOOTER = RECORD_HEAD.pack(FOOTER, FOOTER_BYTES) + bytes(FOOTER_BYTES)
END = _DATA_END + _FOOTER + MCAP_MAGIC  #: End of a file without an index.


class _Part(BytesIO):
    """A buffer that is written at an offset of the file; positions count from the start of the file."""

    def __init__(self, begin: int) -> None:
        super().__init__()
        self._begin = begin

    def tell(self) -> int:
        return super().tell() + self._begin

    def seek(self, offset: int, whence: int = 0) -> int:
        return super().seek(offset - self._begin, whence) + self._begin

    def close(self) -> None:
        """Keep the data, which are written later; the memory is freed with the object."""


class _SafeMcapWriter(CheckedMcapWriter):
    """Writes a chunk and the end record together; if the disk is full, the file keeps its previous content."""

    bio: Any

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self._file = self.bio
        self._offset = self.bio.tell()
        self._file.flush()
        self.bio = _Part(self._offset)
        self._put(END)

    def close_chunk(self) -> None:
        if self.chunk.bio.tell() > CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        if self.chunk.bio.tell():
            super().close_chunk()
            data = self.bio.getvalue()
            self._put(data + END)
            self._offset += len(data)
            self.bio = _Part(self._offset)

    def sync(self) -> None:
        os.fdatasync(self._file.fileno())

    def close(self, version: int, metadata: str) -> None:
        self.flush()
        super().close(version, metadata)
        self._put(self.bio.getvalue())
        self.sync()
        self._file.close()

    def abort(self) -> None:
        """Close the file without an index; its end record makes it readable."""
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
    storage: Any
    STORAGE_PLUGINS = MappingProxyType({StoragePlugin.MCAP: _SafeMcapWriter})


class BagRecorder:
    """Context manager that records messages to a bag as they arrive. Flushed messages survive a crash."""

    def __init__(self, path: Path, *, zstd: bool = False) -> None:
        """Prepare a bag in a folder that must not exist; `zstd` compresses its chunks."""
        if path.exists():
            raise OutputError(f"cannot record to '{path}': it exists; rename or remove it, or choose another name")
        self.path = path
        self.count = 0
        self._writer = _SafeWriter(path, version=9, storage_plugin=StoragePlugin.MCAP)
        if zstd:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._last_ns = 0
        self._stop = threading.Event()
        self._sync_error: OSError | None = None
        self._syncing = threading.Thread(target=self._sync, name="sync", daemon=True)

    def __enter__(self) -> BagRecorder:
        try:
            self._writer.open()
        except OSError as error:
            raise OutputError(f"cannot record to '{self.path}': {error.strerror}; choose another path") from error
        self._syncing.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Close the bag; after an exception it has no index, but remains readable."""
        self._stop.set()
        self._syncing.join()
        if kind is not None:
            self._writer.abort()
            return
        with self._reporting():
            try:
                self._writer.close()
            except OSError:
                self._writer.abort()
                raise
            self._check_synced()

    def add_topic(self, name: str, msgtype: str, definition: str, type_hash: str, offers: Sequence[Qos]) -> Any:  # noqa: ANN401
        """Add a topic and return its handle for `write`; `definition`: type definition as in mcap files, or empty."""
        return self._writer.add_connection(
            name, msgtype, msgdef=definition, rihs01=type_hash, offered_qos_profiles=offers
        )

    def write(self, topic: Any, received_ns: int, raw: bytes) -> None:  # noqa: ANN401
        """Add a serialised message."""
        # The times never decrease, because a file without an index is read in the order of writing.
        self._last_ns = max(self._last_ns, received_ns)
        with self._reporting():
            self._check_synced()
            self._writer.write(topic, self._last_ns, raw)
        self.count += 1

    def flush(self) -> None:
        """Make the added messages readable for other processes."""
        with self._reporting():
            self._writer.storage.flush()

    def _sync(self) -> None:
        try:
            while not self._stop.wait(SYNC_S):
                self._writer.storage.sync()
        except OSError as error:  # Linux reports a failed synchronisation only once
            self._sync_error = error

    def _check_synced(self) -> None:
        """Raise the error of a failed synchronisation."""
        if self._sync_error is not None:
            raise self._sync_error

    @contextmanager
    def _reporting(self) -> Iterator[None]:
        """Convert a disk error to an OutputError with the number of recorded messages."""
        try:
            yield
        except OSError as error:
            raise OutputError(
                f"recording to '{self.path}' stopped after {counted(self.count, 'message')}: {error.strerror}; at most "
                f"the last second is missing; free disk space and record under another name"
            ) from error
