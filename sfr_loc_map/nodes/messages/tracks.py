"""Feature tracks and masks of the localiser as messages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import Header

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.localisation.frontend.tracking import INLIER_CHI2_PER_DOF, TrackingResult
from sfr_loc_map.nodes.messages.fields import byte_array

TRACK_FIELDS = ("u", "v", "before_u", "before_v", "residual")
"""Fields of a track, all float32: pixel in the left image of the pair and in the newest keyframe; root of chi-square
per degree of freedom over that of the worst inlier (1 and more: outlier; NaN: not found)."""
MAX_TRACKS = 100_000
MASK_SCALE = 4
"""Pixels of the image, along each axis, for one of the mask that is published."""
_STEP = 4 * len(TRACK_FIELDS)


def tracks_msg(result: TrackingResult | None, header: Header) -> PointCloud2:
    """Return the landmarks of a pair; none where no landmark was tracked."""
    rows = np.empty((0, len(TRACK_FIELDS)), "<f4") if result is None else _rows(result)
    message = PointCloud2(header=header, height=1, width=len(rows), point_step=_STEP, row_step=_STEP * len(rows))
    message.fields = [
        PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
        for index, name in enumerate(TRACK_FIELDS)
    ]
    message.data = byte_array(rows)
    return message


def tracks_from_msg(message: PointCloud2) -> FloatArray32:
    """Return tracks `(N, 5)` in the order of `TRACK_FIELDS`.

    Raises:
        InputError: If it is another message, or its data too short.
    """
    names, count = tuple(field.name for field in message.fields), int(message.width) * int(message.height)
    data = np.frombuffer(message.data, np.uint8)
    if names != TRACK_FIELDS or message.point_step != _STEP or message.is_bigendian or count > MAX_TRACKS:
        raise InputError(f"no tracks: fields {', '.join(TRACK_FIELDS)} of float32 are needed, found {', '.join(names)}")
    if len(data) < count * _STEP:
        raise InputError(f"{count} tracks need {count * _STEP} bytes, found {len(data)}")
    return data[: count * _STEP].view("<f4").reshape(count, len(TRACK_FIELDS)).astype(np.float32)


def mask_msg(mask: NDArray[np.uint8], header: Header) -> Image:
    """Return a mask `(H, W)`, 0 where no landmark is made, as mono8 of a quarter of its width and height."""
    small = mask[MASK_SCALE // 2 :: MASK_SCALE, MASK_SCALE // 2 :: MASK_SCALE]
    height, width = small.shape
    message = Image(header=header, height=height, width=width, encoding="mono8", step=width)
    message.data = byte_array(small)
    return message


def _rows(result: TrackingResult) -> FloatArray32:
    residual = np.sqrt(result.chi2_per_dof / INLIER_CHI2_PER_DOF)
    columns = (result.observations[:, :2], result.landmarks.last_seen[:, :2], residual)
    return np.asarray(np.column_stack(columns), "<f4")
