"""Values as fields of messages: stamps, headers, bytes, and clouds of named float32 fields.

Every field gets a plain Python number: message classes accept those of numpy silently and send something else.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.image_codec import stamp_of

POINT_TYPES: dict[type[np.generic], int] = {
    np.int8: PointField.INT8,
    np.uint8: PointField.UINT8,
    np.int16: PointField.INT16,
    np.uint16: PointField.UINT16,
    np.int32: PointField.INT32,
    np.uint32: PointField.UINT32,
    np.float32: PointField.FLOAT32,
    np.float64: PointField.FLOAT64,
}
"""Codes of sensor_msgs/PointField."""


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


def points_msg(records: NDArray[np.void], header: Header) -> PointCloud2:
    """Return structured points `(N,)` or `(H, W)` as a message, not said to be dense."""
    dtype, shape = records.dtype, (1, *records.shape)[-2:]
    fields = [
        PointField(name=name, offset=int(dtype.fields[name][1]), datatype=POINT_TYPES[dtype[name].type], count=1)
        for name in dtype.names or ()
        if dtype.fields
    ]
    message = PointCloud2(header=header, height=shape[0], width=shape[1], fields=fields)
    message.point_step, message.row_step = int(dtype.itemsize), int(dtype.itemsize) * shape[1]
    message.data = byte_array(records)
    return message


def points_of(message: PointCloud2, wanted: Mapping[str, Sequence[type[np.generic]]]) -> NDArray[np.void]:
    """Return a view of the points `(H, W)` of a message with the wanted fields, of whatever layout.

    Raises:
        InputError: If a field is missing, of another type or beyond the point, or the data is too short.
    """
    what, found = f"cloud of stamp {stamp_of(message)}", {field.name: field for field in message.fields}
    order: Literal["<", ">"] = ">" if message.is_bigendian else "<"
    formats, offsets = [], []
    for name, kinds in wanted.items():
        field = found.get(name)
        kind = next((k for k in kinds if field is not None and field.datatype == POINT_TYPES[k]), None)
        if field is None or kind is None or field.count not in (0, 1):
            types = " or ".join(each.__name__ for each in kinds)
            raise InputError(f"{what} has no field '{name}' of {types} (fields: {', '.join(found) or 'none'})")
        formats.append(np.dtype(kind).newbyteorder(order))
        offsets.append(int(field.offset))
        if field.offset + formats[-1].itemsize > message.point_step:
            raise InputError(f"{what}: field '{name}' lies beyond the {message.point_step} byte point")
    height, width, step, row = (int(n) for n in (message.height, message.width, message.point_step, message.row_step))
    if row < step * width or len(message.data) < row * height:
        raise InputError(f"{what} is {width} x {height} points of {step} bytes in {len(message.data)}: too few")
    dtype = np.dtype({"names": list(wanted), "formats": formats, "offsets": offsets, "itemsize": step})
    if not height * width:
        return np.zeros((height, width), dtype)
    return np.ndarray((height, width), dtype, np.frombuffer(message.data, np.uint8).data, strides=(row, step))


def float_points_msg(values: FloatArray32, names: Sequence[str], header: Header) -> PointCloud2:
    """Return float32 `(N, F)` or `(H, W, F)` as a cloud with F fields."""
    rows = np.ascontiguousarray(values, "<f4").view([(name, "<f4") for name in names])[..., 0]
    return points_msg(rows, header)


def floats_of(message: PointCloud2, names: Sequence[str]) -> FloatArray32:
    """Return the fields of a cloud as float32 `(H, W, F)`."""
    points = points_of(message, dict.fromkeys(names, (np.float32,)))
    return np.stack([points[name].astype(np.float32) for name in names], axis=-1)
