"""Values as fields of messages: stamps, headers and bytes.

Every field gets a plain Python number: message classes accept those of numpy silently and send something else.
"""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from std_msgs.msg import Header

from sfr_loc_map.inputs import NS_PER_S


def time_msg(stamp_ns: int) -> Time:
    """Return nanoseconds as a ROS time, exactly."""
    sec, nanosec = divmod(int(stamp_ns), NS_PER_S)
    return Time(sec=sec, nanosec=nanosec)


def header_msg(stamp_ns: int, frame_id: str) -> Header:
    """Return a header."""
    return Header(stamp=time_msg(stamp_ns), frame_id=frame_id)


def byte_array(values: NDArray[Any]) -> array[int]:
    """Return the bytes of an array as the one type that message fields take quickly."""
    data = array("B")
    data.frombytes(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data if values.size else b"")
    return data
