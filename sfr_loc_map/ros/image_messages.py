"""Convert images and disparities to messages, and check received images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image, RegionOfInterest
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.image_codec import JPEG_MAGIC, PNG_MAGIC, claimed_size, unread_codec
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.ros.messages import byte_array

if TYPE_CHECKING:  # nodes without kernels do not import numba
    from sfr_loc_map.mapping.disparity.semi_global_matching import SearchRange


RESOLUTION_PX = 1.0 / 16.0
"""Resolution that a disparity message states, px: that of stereo_image_proc, whose receivers expect this value. The
disparities are not rounded."""


def check_image(message: Image | CompressedImage, size: tuple[int, int]) -> None:
    """Check the size that an image claims before memory is allocated, because a small message may claim any size."""
    if isinstance(message, Image):
        found: tuple[int, int] | None = (int(message.width), int(message.height))
    else:
        data = bytes(message.data)
        found = claimed_size(data) if data.startswith((PNG_MAGIC, JPEG_MAGIC)) else None
    if found != size:
        if found is None:
            text = f"image of stamp {stamp_of(message)}: {unread_codec(message)}: publish raw images, PNG or JPEG"
            raise InputError(text)
        raise InputError(
            f"image of stamp {stamp_of(message)} is {found[0]} x {found[1]}: its camera_info states {size[0]} x "
            f"{size[1]}; publish the camera_info of these images"
        )


def image_msg(pixels: NDArray[np.generic], encoding: str, header: Header) -> Image:
    """Return an image `(H, W)` or `(H, W, C)` as a message with an encoding."""
    height, width = pixels.shape[:2]
    step = pixels.nbytes // max(height, 1)
    return Image(header=header, height=height, width=width, encoding=encoding, step=step, data=byte_array(pixels))


def disparity_msg(
    disparity_px: NDArray[np.float32], rig: StereoRig, searched: SearchRange, header: Header
) -> DisparityImage:
    """Return a disparity image; its range includes the search range and all valid disparities."""
    height, width = disparity_px.shape
    low = min(searched.min_disparity_px, float(np.nanmin(disparity_px, initial=np.inf)))
    high = max(searched.max_disparity_px, float(np.nanmax(disparity_px, initial=-np.inf)))
    filled = np.where(np.isnan(disparity_px), np.float32(low - 1.0), disparity_px).astype("<f4")
    message = DisparityImage(header=header, f=float(rig.fx), t=float(rig.baseline_m))
    message.delta_d = RESOLUTION_PX
    message.image = image_msg(filled, "32FC1", header)
    message.valid_window = RegionOfInterest(height=height, width=width)
    message.min_disparity = float(low)
    message.max_disparity = float(high)
    return message
