"""Topics and messages of ROS 2 (sqlite3, mcap) and ROS 1 bags, read as a stream; each pass reopens the files."""

from __future__ import annotations

import logging
import struct
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.rosbag1.reader import ReaderError as Ros1Error
from rosbags.rosbag2.errors import ReaderError

from sfr_loc_map.errors import InputError, SfrError, naming
from sfr_loc_map.io.bag.encoding import TYPESTORE, readable
from sfr_loc_map.io.bag.files import ZSTD_MAGIC, bag_files
from sfr_loc_map.io.bag.readers import BagReader, message_count, messages_of_readers, opened_readers
from sfr_loc_map.io.bag.topic_names import TopicNames
from sfr_loc_map.message_stamps import NS_PER_S, serialised_stamp
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.message_types import (
    CAMERA_INFO,
    COMPRESSED,
    DISPARITY,
    FIX,
    IMAGE,
    JOINTS,
    ODOMETRY,
    POINT,
    POINTS,
    POSE,
    POSE_WITH_COVARIANCE,
    TRANSFORM,
)
from sfr_loc_map.topics import COMPRESSED_END, RECTIFIED

STAMPED = {IMAGE, COMPRESSED, CAMERA_INFO, POSE, ODOMETRY, POINTS, DISPARITY}
"""Types of the messages of pairs and results. `Bag.stream` yields these messages with the stamps of their headers."""
HEADER_FIRST = STAMPED | {POSE_WITH_COVARIANCE, POINT, TRANSFORM, FIX, JOINTS}
"""The types whose only stamp is that of a header, their first field. In a bag read by times of recording, these times
replace the stamps. A nav_msgs/Path, whose poses have their own stamps, is read as recorded."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag: its relative name in the suite (`loc/left/image_rect`), its name in the bag, its type."""

    name: str
    bag_name: str
    msgtype: str


class Bag:
    """A bag; `topics` maps names to types. An `unfinished` bag was not closed and is read up to its last record."""

    def __init__(self, path: Path, topics: Mapping[str, str] | None = None, stamps: str = "header") -> None:
        """Read the topics of a folder or file (.mcap, .db3, .bag of ROS 1).

        `topics`: name in the bag by name in the suite, where both differ (`SourceConfig.topics`).
        `stamps`: "header", or "record" to replace the stamps of headers by the times of recording. InputError if the
        bag is missing or corrupt; ConfigError if `topics` do not fit the bag.
        """
        self.path = path
        self._by_record = stamps == "record"
        self._files = bag_files(path)
        self.unfinished = self._files.are_unfinished
        if self.unfinished:
            _log.warning(f"bag '{path}' was not closed: it is read up to its last complete record")
        if self._files.unnamed:
            _log.warning(
                f"bag '{path}': {', '.join(self._files.unnamed)} ignored: metadata.yaml does not name these files; run "
                "'ros2 bag reindex' if they belong to the bag"
            )
        with self._reading() as readers:
            self._check_count(message_count(readers), self._files.message_count)
            connections = readable([c for reader in readers for c in reader.connections])
            self.topics: dict[str, str] = {c.topic: c.msgtype for c in connections}
            types = {name: {c.msgtype for c in connections if c.topic == name} for name in self.topics}
            self._types_of_mixed = {name: sorted(found) for name, found in types.items() if len(found) > 1}
            if not all(isinstance(text, str) for pair in self.topics.items() for text in pair):  # as sqlite permits
                raise TypeError("the name or the type of a topic is not text")
            self.counts = {name: sum(c.msgcount for c in connections if c.topic == name) for name in self.topics}
        if not any(self.counts.values()):
            raise InputError(f"bag '{path}' has no messages:", "record it again")
        self.names = TopicNames.of(self.topics, topics or {}, path)

    def renamed(self, topics: Mapping[str, str]) -> Bag:
        """Return a copy with topics renamed by `topics` alone; raise InputError or ConfigError if a name is wrong."""
        other = copy(self)
        other.names = TopicNames.of(self.topics, topics, self.path)
        return other

    def stamped_by(self, stamps: str) -> Bag:
        """Return the bag with the stamps of the headers ("header") or the times of recording ("record")."""
        other = copy(self)
        other._by_record = stamps == "record"
        return other

    def matches(self, name: str) -> list[str]:
        """Return the names in the bag of the topics that match a name (`TopicNames.matching`)."""
        return self.names.matching(name)

    def find(self, name: str, *msgtypes: str) -> Topic | None:
        """Return the topic of a name (`matches`); None if absent.

        The type `COMPRESSED` also permits `name/compressed`.
        """
        matching = self.matches(name)
        if not matching and COMPRESSED in msgtypes:
            matching = self.matches(f"{name}{COMPRESSED_END}")
        if not matching:
            return None
        if len(matching) > 1:
            several = ", ".join(matching)
            raise InputError(f"bag '{self.path}' has several topics '{name}': {several};", "choose one with --remap")
        if types := self._types_of_mixed.get(matching[0]):
            raise InputError(
                f"topic '{matching[0]}' of bag '{self.path}' has messages of several types, {' and '.join(types)}:",
                "record one type on each topic",
            )
        msgtype = self.topics[matching[0]]
        if msgtypes and msgtype not in msgtypes:
            raise InputError(
                f"topic '{matching[0]}' of bag '{self.path}' is {msgtype}:",
                f"{alternatives(msgtypes)} is required for '{name}'",
            )
        relative = name.strip("/")
        return Topic(f"{relative}{COMPRESSED_END}" if msgtype == COMPRESSED else relative, matching[0], msgtype)

    def raw_messages(self, names: Collection[str]) -> Iterator[tuple[str, str, int, bytes]]:
        """Yield relative name, type, stamp and bytes of the messages on topics `names`; images may be compressed."""
        topics = [self.find(name, *((IMAGE, COMPRESSED) if name.endswith(RECTIFIED) else ())) for name in names]
        for topic, stamp_ns, raw in self.stream([topic for topic in topics if topic is not None]):
            yield topic.name, topic.msgtype, stamp_ns, raw

    def stream(self, topics: Collection[Topic]) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield topic, stamp and CDR bytes in the order of recording.

        The stamp, ns, is that of the header for the types in `STAMPED`, and the time of recording for all others. In a
        bag that is read by the times of recording (`stamped_by`), every stamp is the time of recording.
        """
        by_name = {topic.bag_name: topic for topic in topics}
        with self._reading() as readers:
            expected = sum(c.msgcount for reader in readers for c in reader.connections if c.topic in by_name)
            count = 0
            are_compressed = self._files.compression == "message"
            messages = messages_of_readers(readers, by_name.keys(), are_compressed=are_compressed)
            for connection, recorded_ns, raw in messages:
                topic = by_name[connection.topic]
                count += 1
                if self._by_record and topic.msgtype in HEADER_FIRST:
                    raw = restamped(raw, recorded_ns)
                yield topic, serialised_stamp(raw) if topic.msgtype in STAMPED else recorded_ns, raw
            self._check_count(count, expected)

    def messages(self, topics: Collection[Topic]) -> Iterator[tuple[Topic, int, Any]]:
        """Yield topic, stamp (as in `stream`) and deserialised message in the order of recording."""
        for topic, stamp_ns, raw in self.stream(topics):
            yield topic, stamp_ns, self.deserialise(topic, raw)

    def deserialise(self, topic: Topic, raw: bytes) -> Any:  # noqa: ANN401 - the type depends on the topic
        """Return the deserialised message."""
        try:
            return TYPESTORE.deserialize_cdr(raw, topic.msgtype)
        except Exception as error:
            where = f"a message on '{topic.bag_name}' of bag '{self.path}'"
            if raw.startswith(ZSTD_MAGIC):
                raise InputError(
                    f"{where} is compressed by zstd, which only metadata.yaml states:",
                    "restore metadata.yaml beside the files, or run 'ros2 bag reindex'",
                ) from error
            raise InputError(f"{where} is corrupt: {_line(error)}") from error

    def first(self, topics: Collection[Topic]) -> dict[str, Any]:
        """Return the first message of each topic by the topic's name; topics without a message are omitted."""
        messages: dict[str, Any] = {}
        with_messages = [topic for topic in topics if self.counts[topic.bag_name]]
        for topic, _, raw in self.stream(with_messages):
            if topic.name not in messages:
                messages[topic.name] = self.deserialise(topic, raw)
                if len(messages) == len(with_messages):
                    break
        return messages

    def _check_count(self, count: int, expected: int) -> None:
        """Raise InputError if fewer messages than expected were found."""
        if count < expected:
            raise InputError(
                f"bag '{self.path}' is truncated: {count} of {expected} messages could be read;", "copy it again"
            )

    @contextmanager
    def _reading(self) -> Iterator[list[BagReader]]:
        """Open the files; any exception that corrupt data causes (KeyError, sqlite3.Error, ...) becomes InputError."""
        with naming(self.path):
            try:
                with opened_readers(self._files) as readers:
                    yield readers
            except SfrError:
                raise
            except Exception as error:
                raise InputError(
                    f"bag '{self.path}' cannot be read: {_line(error)}; it is corrupt or truncated:",
                    "record or copy it again",
                ) from error


def restamped(raw: bytes, stamp_ns: int) -> bytes:
    """Return a CDR message that begins with a header, with the header stamp replaced (XTypes 1.3, 7.4)."""
    order = "<" if raw[1] & 1 else ">"
    return raw[:4] + struct.pack(f"{order}iI", *divmod(stamp_ns, NS_PER_S)) + raw[12:]


def _line(error: Exception) -> str:
    """Return the text of an error in one line; the class is added unless the error belongs to the readers of bags."""
    text = " ".join(str(error).split())
    if text and isinstance(error, ReaderError | Ros1Error):
        return text[:300]
    return f"{type(error).__name__}: {text}"[:300] if text else type(error).__name__
