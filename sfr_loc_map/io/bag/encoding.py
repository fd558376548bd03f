"""Encodings of the messages of a bag: ROS 2 (CDR) and ROS 1 are read, all others are skipped."""

from __future__ import annotations

from collections.abc import Sequence

from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from sfr_loc_map.errors import InputError

CDR, ROS1 = "cdr", "ros1"
OLD_TYPES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
"""ROS 2 names of message types whose ROS 1 names differ, by ROS 1 name."""
TYPESTORE = get_typestore(Stores.ROS2_JAZZY)  #: Types of ROS 2 messages.


def is_ros1(connection: Connection) -> bool:
    """Return whether the messages of a connection of a ROS 2 bag have the ROS 1 encoding."""
    return _encoding(connection) == ROS1


def cdr_of_ros1(data: bytes, msgtype: str) -> bytes:
    """Return a message of ROS 1 as CDR, without the sequence number of its header."""
    return bytes(TYPESTORE.ros1_to_cdr(data, msgtype))


def readable(connections: Sequence[Connection]) -> list[Connection]:
    """Return the connections with ROS 2 or ROS 1 messages; raise InputError if there are only other encodings."""
    of_ros = [_of_ros2(each) for each in connections if _encoding(each) in (CDR, ROS1, "")]
    if connections and not of_ros:
        written = ", ".join(sorted({_encoding(each) for each in connections}))
        raise InputError(
            f"its messages are encoded as {written}: ROS 2 (cdr) or ROS 1 (ros1) messages are required;",
            "record or convert it as a ROS bag",
        )
    return of_ros


def _encoding(connection: Connection) -> str:
    return str(getattr(connection.ext, "serialization_format", ""))


def _of_ros2(connection: Connection) -> Connection:
    """Return a connection with its type named as in ROS 2: `sensor_msgs/Image` becomes `sensor_msgs/msg/Image`."""
    package, _, name = connection.msgtype.rpartition("/")
    if _encoding(connection) != ROS1 or not package:
        return connection
    msgtype = f"{package.removesuffix('/msg')}/msg/{name}"
    return connection._replace(msgtype=OLD_TYPES.get(msgtype, msgtype))
