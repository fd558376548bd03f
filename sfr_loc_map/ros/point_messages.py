"""Convert points, clouds and feature tracks to messages of sensor_msgs/PointCloud2 and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, FloatArray32
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.ros.messages import byte_array, header_msg

_LETTERS = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
POINT_TYPES = {np.dtype(name).type: code for code, name in enumerate(_LETTERS, PointField.INT8)}
"""Datatype codes of sensor_msgs/PointField by numpy type."""


def points_msg(records: NDArray[np.void], header: Header) -> PointCloud2:
    """Return structured points `(N,)` or `(H, W)` as a message with aligned fields and `is_dense` false."""
    dtype, shape = np.dtype(records.dtype.descr, align=True), (1, *records.shape)[-2:]
    layout: Mapping[str, Any] = dtype.fields or {}
    fields = [
        PointField(name=name, offset=int(offset), datatype=POINT_TYPES[kind.type], count=1)
        for name, (kind, offset, *_) in layout.items()
    ]
    size = int(dtype.itemsize)
    message = PointCloud2(header=header, height=shape[0], width=shape[1], fields=fields)
    message.point_step, message.row_step = size, size * shape[1]
    message.data = byte_array(records.astype(dtype))
    return message


def points_of(message: PointCloud2, wanted: Mapping[str, Sequence[type[np.generic]]]) -> NDArray[np.void]:
    """Return a view of the points `(H, W)` of a message with the wanted fields; the message may have any layout."""
    what, found = f"cloud of stamp {stamp_of(message)}", {field.name: field for field in message.fields}
    order: Literal["<", ">"] = ">" if message.is_bigendian else "<"
    formats, offsets = [], []
    for name, kinds in wanted.items():
        field = found.get(name)
        kind = next((k for k in kinds if field is not None and field.datatype == POINT_TYPES[k]), None)
        if field is None or kind is None or field.count not in (0, 1):
            types = alternatives(each.__name__ for each in kinds)
            raise InputError(f"{what} has no field '{name}' of {types} (fields: {', '.join(found) or 'none'})")
        formats.append(np.dtype(kind).newbyteorder(order))
        offsets.append(int(field.offset))
        if field.offset + formats[-1].itemsize > message.point_step:
            raise InputError(f"{what}: field '{name}' ends after the {message.point_step} bytes of a point")
    height, width, step, row = (int(n) for n in (message.height, message.width, message.point_step, message.row_step))
    if row < step * width or len(message.data) < row * height:
        raise InputError(
            f"{what} has {len(message.data)} bytes: {width} x {height} points of {step} bytes are required"
        )
    dtype = np.dtype({"names": list(wanted), "formats": formats, "offsets": offsets, "itemsize": step})
    if not height * width:
        return np.zeros((height, width), dtype)
    return np.ndarray((height, width), dtype, np.frombuffer(message.data, np.uint8).data, strides=(row, step))


def float_points_msg(values: FloatArray32, names: Sequence[str], header: Header) -> PointCloud2:
    """Return float32 values `(N, F)` or `(H, W, F)` as a cloud with F fields."""
    rows = np.ascontiguousarray(values, "<f4").view([(name, "<f4") for name in names])[..., 0]
    return points_msg(rows, header)


def floats_of(message: PointCloud2, names: Sequence[str]) -> FloatArray32:
    """Return the named float32 fields of a cloud as `(H, W, F)`."""
    points = points_of(message, dict.fromkeys(names, (np.float32,)))
    return np.stack([points[name].astype(np.float32) for name in names], axis=-1)


def cloud_msg(cloud: PointCloud, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a cloud as one row of points with the fields x, y, z, sigma, intensity, u, v, pair."""
    message = points_msg(cloud.to_structured(), header_msg(stamp_ns, frame_id))
    message.is_dense = bool(np.isfinite(cloud.xyz).all())
    return message


def cloud_from_msg(message: PointCloud2) -> PointCloud:
    """Return the cloud of a message with at least the fields of `mapping/points`."""
    points = points_of(message, {name: (kind,) for name, kind in FIELD_TYPES.items()})
    return PointCloud.from_structured(points.reshape(-1))


def xyz_from_msg(message: PointCloud2) -> FloatArray:
    """Return the points `(N, 3)` of any cloud with float fields x, y and z; missing points stay NaN."""
    points = points_of(message, dict.fromkeys("xyz", (np.float32, np.float64)))
    return np.stack([points[name].reshape(-1).astype(np.float64) for name in "xyz"], axis=1)


TRACK_FIELDS = ("u", "v", "before_u", "before_v", "residual")
"""Float32 fields of a track: pixel in the left image of the pair, pixel in the newest keyframe, and residual. The
residual is the root of chi-square per degree of freedom divided by the gate of an inlier (1 and more: outlier; NaN: not
found)."""

MAX_TRACKS = 100_000  #: Maximum number of tracks in a message.


def tracks_from_msg(message: PointCloud2) -> FloatArray32:
    """Return tracks `(N, 5)` in the order of `TRACK_FIELDS`."""
    if message.width * message.height > MAX_TRACKS:
        raise InputError(f"{message.width * message.height} tracks: at most {MAX_TRACKS} are allowed")
    return floats_of(message, TRACK_FIELDS).reshape(-1, len(TRACK_FIELDS))
