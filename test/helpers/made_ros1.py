"""ROS 1 bags with the messages of a ROS 2 bag."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from rosbags.rosbag1 import Writer
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.message_types import TF

NOETIC = get_typestore(Stores.ROS1_NOETIC)


def write_ros1(path: Path, source: Path, names: Mapping[str, str] | None = None, compression: str = "") -> Path:
    """Write the messages of a ROS 2 bag as ROS 1 has them; `names` are other names of topics."""
    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression])
    with writer, Reader(source) as reader:
        made = {}
        for old in reader.connections:
            store = TYPESTORE if old.msgtype == TF else NOETIC
            definition, digest = store.generate_msgdef(old.msgtype, ros_version=1)
            topic, kind = (names or {}).get(old.topic, old.topic), old.msgtype
            kind = "tf/msg/tfMessage" if kind == TF else kind
            made[old.id] = writer.add_connection(topic, kind, msgdef=definition, md5sum=digest)
        for old, time_ns, data in reader.messages():
            writer.write(made[old.id], time_ns, TYPESTORE.cdr_to_ros1(data, old.msgtype))
    return path
