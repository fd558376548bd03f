"""Clouds of map points as messages, and back."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import PointCloud2

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.nodes.messages.fields import header_msg, points_msg, points_of


def cloud_msg(cloud: PointCloud, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a cloud with the fields x y z sigma intensity u v pair, one row."""
    message = points_msg(cloud.to_structured(), header_msg(stamp_ns, frame_id))
    message.is_dense = bool(np.isfinite(cloud.xyz).all())
    return message


def cloud_from_msg(message: PointCloud2) -> PointCloud:
    """Return the cloud of a message with at least the fields of `mapping/points`.

    Raises InputError if a field is missing or of another type, or the data is too short.
    """
    points = points_of(message, {name: (kind,) for name, kind in FIELD_TYPES.items()})
    return PointCloud.from_structured(points.reshape(-1))


def xyz_from_msg(message: PointCloud2) -> FloatArray:
    """Return the points `(N, 3)` of any cloud with float fields x, y and z; NaN where there is none."""
    points = points_of(message, dict.fromkeys("xyz", (np.float32, np.float64)))
    return np.stack([points[name].reshape(-1).astype(np.float64) for name in "xyz"], axis=1)
