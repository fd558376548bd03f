"""Point clouds as messages, and the checks of their layout."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.nodes.messages.fields import byte_array, header_msg

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


def cloud_msg(cloud: PointCloud, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a cloud with the fields x y z sigma intensity u v pair, one row."""
    records = cloud.to_structured()
    dtype, count = records.dtype, len(records)
    fields = [
        PointField(name=name, offset=int(dtype.fields[name][1]), datatype=POINT_TYPES[dtype[name].type], count=1)
        for name in dtype.names or ()
        if dtype.fields
    ]
    message = PointCloud2(header=header_msg(stamp_ns, frame_id), height=1, width=count, fields=fields)
    message.point_step, message.row_step = int(dtype.itemsize), int(dtype.itemsize) * count
    message.data = byte_array(records)
    message.is_dense = bool(np.isfinite(cloud.xyz).all())
    return message


def cloud_from_msg(message: PointCloud2, every: int = 1) -> PointCloud:
    """Return the cloud of a message with at least the fields of `mapping/points`.

    Args:
        message: The message.
        every: Take one of so many points.

    Raises:
        InputError: If a field is missing or of another type, or the data is too short.
    """
    stamp = stamp_of(message)
    offsets = _checked_offsets(message, stamp)
    height, width, step, row = (int(n) for n in (message.height, message.width, message.point_step, message.row_step))
    if row < step * width or len(message.data) < row * height:
        raise InputError(
            f"cloud of stamp {stamp} is {width} x {height} points of {step} bytes in {len(message.data)}: too few"
        )
    order: Literal["<", ">"] = ">" if message.is_bigendian else "<"
    formats = [np.dtype(kind).newbyteorder(order) for kind in FIELD_TYPES.values()]
    dtype = np.dtype({"names": list(FIELD_TYPES), "formats": formats, "offsets": offsets, "itemsize": step})
    records: NDArray[np.void] = np.zeros((0, 0), dtype)
    if height * width:
        records = np.ndarray((height, width), dtype, np.frombuffer(message.data, np.uint8).data, strides=(row, step))
    return PointCloud.from_structured(records.reshape(-1)[::every])


def points_from_msg(message: PointCloud2) -> FloatArray:
    """Return the points `(N, 3)` of any cloud with float fields x, y and z; NaN where there is none.

    Raises:
        InputError: If a field is missing or of another type, or the data is too short.
    """
    dtype, shape, row = _xyz_type(message), (int(message.height), int(message.width)), int(message.row_step)
    size = len(message.data)
    if row < dtype.itemsize * shape[1] or size < row * shape[0]:
        raise InputError(
            f"cloud of stamp {stamp_of(message)} is {shape[1]} x {shape[0]} points in {size} bytes: too few"
        )
    if not shape[0] * shape[1]:
        return np.zeros((0, 3))
    data = np.frombuffer(message.data, np.uint8).data
    records: NDArray[np.void] = np.ndarray(shape, dtype, data, strides=(row, dtype.itemsize))
    return np.stack([records[name].reshape(-1).astype(np.float64) for name in "xyz"], axis=1)


def _xyz_type(message: PointCloud2) -> np.dtype[np.void]:
    """Return the type of a point of which only x, y and z matter.

    Raises:
        InputError: If one is missing, of another type or beyond the point.
    """
    found = {field.name: field for field in message.fields}
    kinds: dict[int, str] = {PointField.FLOAT32: "f4", PointField.FLOAT64: "f8"}
    fields = [found[name] for name in "xyz" if name in found and found[name].datatype in kinds]
    order = ">" if message.is_bigendian else "<"
    formats = [np.dtype(order + kinds[field.datatype]) for field in fields]
    ends = [field.offset + kind.itemsize for field, kind in zip(fields, formats, strict=True)]
    if len(fields) < 3 or max(ends) > message.point_step:
        have = ", ".join(found) or "none"
        raise InputError(f"cloud of stamp {stamp_of(message)} has no float fields x, y, z (fields: {have})")
    offsets = [int(field.offset) for field in fields]
    return np.dtype({"names": list("xyz"), "formats": formats, "offsets": offsets, "itemsize": int(message.point_step)})


def _checked_offsets(message: PointCloud2, stamp: int) -> list[int]:
    """Return where in a point each field of `FIELD_TYPES` lies, bytes.

    Raises:
        InputError: If a field is missing, of another type or beyond the point.
    """
    found = {field.name: field for field in message.fields}
    for name, kind in FIELD_TYPES.items():
        field = found.get(name)
        if field is None or field.datatype != POINT_TYPES[kind] or field.count not in (0, 1):
            have = ", ".join(found) or "none"
            raise InputError(f"cloud of stamp {stamp} has no field '{name}' of {kind.__name__} (fields: {have})")
        if field.offset + np.dtype(kind).itemsize > message.point_step:
            raise InputError(f"cloud of stamp {stamp}: field '{name}' lies beyond the {message.point_step} byte point")
    return [int(found[name].offset) for name in FIELD_TYPES]
