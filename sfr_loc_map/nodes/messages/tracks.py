"""Feature tracks and masks of the localiser as messages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.localisation.frontend.tracking import INLIER_CHI2_PER_DOF, TrackingResult
from sfr_loc_map.nodes.messages.fields import byte_array, float_points_msg, floats_of

TRACK_FIELDS = ("u", "v", "before_u", "before_v", "residual")
"""Fields of a track, all float32: pixel in the left image of the pair and in the newest keyframe; root of chi-square
per degree of freedom over that of the worst inlier (1 and more: outlier; NaN: not found)."""
MAX_TRACKS = 100_000
MASK_SCALE = 4  #: Pixels of the image, along each axis, for one of the mask that is published.


def tracks_msg(result: TrackingResult | None, header: Header) -> PointCloud2:
    """Return the landmarks of a pair; none where no landmark was tracked."""
    rows = np.empty((0, len(TRACK_FIELDS)), np.float32)
    if result is not None:
        residual = np.sqrt(result.chi2_per_dof / INLIER_CHI2_PER_DOF)
        rows = np.column_stack((result.observations[:, :2], result.landmarks.last_seen[:, :2], residual))
    message = float_points_msg(rows, TRACK_FIELDS, header)
    return message


def tracks_from_msg(message: PointCloud2) -> FloatArray32:
    """Return tracks `(N, 5)` in the order of `TRACK_FIELDS`."""
    if message.width * message.height > MAX_TRACKS:
        raise InputError(f"{message.width * message.height} tracks: at most {MAX_TRACKS} are read")
    return floats_of(message, TRACK_FIELDS).reshape(-1, len(TRACK_FIELDS))


def mask_msg(mask: NDArray[np.uint8], header: Header) -> Image:
    """Return a mask `(H, W)`, 0 where no landmark is made, as mono8 of a quarter of its width and height."""
    small = mask[MASK_SCALE // 2 :: MASK_SCALE, MASK_SCALE // 2 :: MASK_SCALE]
    height, width = small.shape
    message = Image(header=header, height=height, width=width, encoding="mono8", step=width)
    message.data = byte_array(small)
    return message
