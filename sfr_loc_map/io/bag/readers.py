"""The readers of bags: the readers of rosbags with limits on decompressed sizes, and our own reader of MCAP files.

Decompressed sizes are checked before or during decompression. Messages of ROS 1 (format 2.0) are returned as CDR,
without the sequence number of their headers.
"""

from __future__ import annotations

from collections.abc import Collection, Generator
from functools import lru_cache
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Any, TypeAlias

from rosbags import rosbag1
from rosbags.interfaces import Connection
from rosbags.rosbag1.reader import Chunk, ChunkInfo, decompressors
from rosbags.rosbag1.reader import ReaderError as Ros1Error
from rosbags.rosbag2 import Reader
from rosbags.rosbag2 import reader as rosbag2_reader
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from ruamel.yaml import YAML

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import check_regular, read_text
from sfr_loc_map.io.bag.encoding import OLD_TYPES, cdr_of_ros1
from sfr_loc_map.io.bag.files import is_ros1_bag
from sfr_loc_map.io.bag.mcap_file import McapFile, RecoveringMcapFile
from sfr_loc_map.io.bag.unpacking import check_zstd_file, unpack_bz2, unpack_lz4, unpack_zstd
from sfr_loc_map.json_yaml import parse_yaml

METADATA = "rosbag2_bagfile_information"
BOUNDED = {decompressors["bz2"]: unpack_bz2, decompressors["lz4"]: unpack_lz4}
"""Decompressors of ROS 1 chunks with a size limit, by the decompressors of rosbags that they replace."""
_ROS1 = get_typestore(Stores.ROS1_NOETIC)


_parsed_metadata = lru_cache(maxsize=4)(parse_yaml)
"""Content of `metadata.yaml`, which callers do not change. A command opens a bag twenty times."""


class _RosbagsYaml:
    """Replaces the YAML parser of rosbags, which would parse `metadata.yaml` again each time a bag is opened."""

    def __init__(self, typ: str) -> None:
        self._typ = typ

    def load(self, text: str) -> Any:  # noqa: ANN401 - any YAML
        """Return the content of a text, which rosbags does not change."""
        return _loaded_by_rosbags(text, self._typ)


@lru_cache(maxsize=4)
def _loaded_by_rosbags(text: str, typ: str) -> Any:  # noqa: ANN401 - any YAML
    return YAML(typ=typ).load(text)


rosbag2_reader.YAML = _RosbagsYaml  # type: ignore[attr-defined, assignment]


class _BoundedDirectoryReader(DirectoryReader):
    """Reads the folder of a bag with limits on its metadata and its compressed files."""

    STORAGE_PLUGINS = MappingProxyType({**DirectoryReader.STORAGE_PLUGINS, "mcap": McapFile})
    _messages_compressed = False

    def open(self) -> None:
        """Check the metadata and the files before they are read."""
        path = Path(str(self.path))
        content = _parsed_metadata(read_text(path / "metadata.yaml"))
        information = content.get(METADATA) if isinstance(content, dict) else None
        if not isinstance(information, dict) or not isinstance(information.get("relative_file_paths"), list):
            raise ReaderError("metadata.yaml does not name the files of the bag")
        mode = str(information.get("compression_mode", "")).lower()
        for name in information["relative_file_paths"]:
            file = path / PurePath(str(name)).name
            if file.exists():  # rosbags reports missing files
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
            yield connection, time_ns, unpack_zstd(data) if self._messages_compressed else data


class Ros2Reader(Reader):
    """Reader of a ROS 2 bag; a context manager."""

    STORAGE_PLUGINS = MappingProxyType(
        {**Reader.STORAGE_PLUGINS, "dir": _BoundedDirectoryReader, ".mcap": RecoveringMcapFile}
    )


class Ros1Reader(rosbag1.Reader):
    """Reader of a ROS 1 bag; a context manager."""

    def open(self) -> None:
        """Read the index."""
        self._places: set[int] = set()
        super().open()
        self.connections = [c._replace(msgtype=OLD_TYPES.get(c.msgtype, c.msgtype)) for c in self.connections]

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
                    f"the definition of {each.msgtype} on '{each.topic}' differs from ROS Noetic: "
                    "record the topic with the definition of Noetic"
                )
        for each, time_ns, data in super().messages(connections, start, stop):
            connection = wanted[each.id]
            yield connection, time_ns, cdr_of_ros1(data, connection.msgtype)


def _has_known_fields(connection: Connection) -> bool:
    """Return whether the fields are those of ROS Noetic, ignoring case: rosbags-convert writes `k` instead of `K`."""
    msgtype = connection.msgtype
    if msgtype not in _ROS1.fielddefs:
        return True
    if connection.digest in ("*", _ROS1.generate_msgdef(msgtype, ros_version=1)[1]):
        return True
    given = get_types_from_msg(connection.msgdef.data, msgtype)
    return all(_fields(item) == _fields(_ROS1.fielddefs.get(name, ([], []))) for name, item in given.items())


def _fields(definition: Any) -> list[tuple[str, Any]]:  # noqa: ANN401 - a type definition of rosbags
    return [(name.lower(), kind) for name, kind in definition[1]]


BagReader: TypeAlias = Ros2Reader | Ros1Reader


def reader_of(file: Path) -> BagReader:
    """Return the reader of a file or folder of `files.reader_paths`."""
    return Ros1Reader(file) if is_ros1_bag(file) else Ros2Reader(file)
