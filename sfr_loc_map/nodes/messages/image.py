"""Images as messages, and the checks of image messages before they are decoded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image, RegionOfInterest
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.image_codec import (
    JPEG_MAGIC,
    PNG_MAGIC,
    claimed_size,
    image_from_compressed_message,
    image_from_message,
    stamp_of,
)
from sfr_loc_map.nodes.messages.fields import byte_array


def grey_from_image(message: Image | CompressedImage, size: tuple[int, int]) -> GreyImage:
    """Return an image message (PNG or JPEG where compressed) as 8-bit grey `(H, W)`; `size` is that of camera_info.

    Raises InputError if the size is another, the encoding is not supported or the data is broken.
    """
    check_image(message, size)
    return image_from_message(message) if isinstance(message, Image) else image_from_compressed_message(message)


def check_image(message: Image | CompressedImage, size: tuple[int, int]) -> None:
    """Check the size that an image claims before anything is decoded or allocated: a small message may claim any."""
    if isinstance(message, Image):
        found: tuple[int, int] | None = (int(message.width), int(message.height))
    else:
        data = bytes(message.data)
        found = claimed_size(data) if data.startswith((PNG_MAGIC, JPEG_MAGIC)) else None
    if found != size:
        what = "not PNG or JPEG" if found is None else f"{found[0]} x {found[1]}"
        raise InputError(
            f"image of stamp {stamp_of(message)} is {what}: its camera_info says {size[0]} x {size[1]}; "
            f"publish the camera_info of these images"
        )


def image_msg(image: NDArray[np.uint8], header: Header) -> Image:
    """Return a colour image `(H, W, 3)` uint8, blue, green, red, as a message."""
    height, width = image.shape[:2]
    message = Image(header=header, height=height, width=width, encoding="bgr8", step=3 * width)
    message.data = byte_array(image)
    return message


def disparity_msg(
    disparity_px: NDArray[np.float32], rig: StereoRig, searched_px: tuple[float, float], header: Header
) -> DisparityImage:
    """Return a disparity image."""
    height, width = disparity_px.shape
    low = min(searched_px[0], float(np.nanmin(disparity_px, initial=np.inf)))
    filled = np.where(np.isnan(disparity_px), np.float32(low - 1.0), disparity_px).astype("<f4")
    message = DisparityImage(header=header, f=float(rig.fx), t=float(rig.baseline_m), delta_d=1.0 / 16.0)
    message.image = Image(header=header, height=height, width=width, encoding="32FC1", step=4 * width)
    message.image.data = byte_array(filled)
    message.valid_window = RegionOfInterest(height=height, width=width)
    message.min_disparity, message.max_disparity = float(low), float(searched_px[1])
    return message
