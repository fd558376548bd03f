"""Parts of all messages: header, bytes, type.

The other modules convert values to messages and back: `pose_messages`, `image_messages`, `point_messages` and
`grid_messages`. Every field is set to a plain Python number, because message classes accept numpy numbers silently and
send wrong values. Invalid messages (NaN, too few bytes, a wrong size or type) raise an InputError.
"""

from __future__ import annotations

import importlib
from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.time import Time
from std_msgs.msg import Header

from sfr_loc_map.errors import NodeError


def header_msg(stamp_ns: int, frame_id: str) -> Header:
    """Return a header with a stamp and a frame."""
    return Header(stamp=Time(nanoseconds=int(stamp_ns)).to_msg(), frame_id=frame_id)


def byte_array(values: NDArray[Any]) -> array[int]:
    """Return the bytes of an array as `array.array`, the only type that message fields copy fast."""
    data = array("B")
    data.frombytes(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
    return data


def tf_message_type() -> type[Any] | None:
    """Return tf2_msgs/TFMessage; None if tf2_msgs is not installed (it is not part of the ROS wheels)."""
    try:
        return message_type("tf2_msgs/msg/TFMessage")
    except NodeError:
        return None


def message_type(msgtype: str) -> type[Any]:
    """Return the class of a name such as `sensor_msgs/msg/Image`; raise a NodeError if its package is missing."""
    package, _, name = msgtype.split("/")
    try:
        found: type[Any] = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise NodeError(f"message type {msgtype} is not available: install or source {package}") from error
    return found
