"""Bags of given messages."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import StoragePlugin, Writer

from sfr_loc_map.io.bag.encoding import TYPESTORE


def write_messages(path: Path, entries: Iterable[tuple[str, int, Any]]) -> Path:
    """Write messages as another program would: of each the topic, the time of recording in ns, and the message."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for topic, stamp, message in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=TYPESTORE)
            writer.write(connections[topic], stamp, TYPESTORE.serialize_cdr(message, message.__msgtype__))
    return path
