"""Images and clouds made small enough for a screen."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfr_loc_map.geometry.arrays import FloatArray32, GreyImage
from sfr_loc_map.io.image_codec import decode_grey, encode_jpeg
from sfr_loc_map.io.image_header import JPEG_MAGIC, claimed_size
from sfr_loc_map.live.updates import CloudSample, ImageSample

IMAGE_WIDTH = 640
"""Widest image that is shown, pixels."""
JPEG_QUALITY = 75
MAX_JPEG_BYTES = 100_000
"""Largest file that is shown as it is: a page has 2 MB/s for 14 images and the clouds."""
MAX_POINTS = 40_000
"""Most points of a cloud that are shown."""


def image_sample(topic: str, stamp_ns: int, image: NDArray[np.uint8], published_s: float) -> ImageSample:
    """Return an image reduced for the screen.

    Args:
        topic: Where it comes from.
        stamp_ns: Its stamp.
        image: `(H, W)` grey, or `(H, W, 3)` blue, green, red; 8 bits.
        published_s: When it was published, seconds of the host's clock.
    """
    height, width = image.shape[:2]
    shown = image
    if width > IMAGE_WIDTH:
        size = (IMAGE_WIDTH, max(round(height * IMAGE_WIDTH / width), 1))
        shown = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return ImageSample(topic, stamp_ns, _jpeg(shown), (shown.shape[1], shown.shape[0]), (width, height), published_s)


def file_sample(topic: str, stamp_ns: int, data: bytes, published_s: float) -> ImageSample:
    """Return an image file reduced for the screen; a small JPEG file is shown as it is.

    Args:
        topic: Where it comes from.
        stamp_ns: Its stamp.
        data: The file.
        published_s: When it was published, seconds of the host's clock.

    Raises:
        InputError: If it is no image that is read.
    """
    size = claimed_size(data) if data.startswith(JPEG_MAGIC) else None
    if size is not None and size[0] <= IMAGE_WIDTH and len(data) <= MAX_JPEG_BYTES:
        return ImageSample(topic, stamp_ns, data, size, size, published_s)
    return image_sample(topic, stamp_ns, decode_grey(data), published_s)


def _jpeg(image: GreyImage) -> bytes:
    image = np.ascontiguousarray(image)
    if image.ndim == 2:
        return encode_jpeg(image, JPEG_QUALITY)
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])


def cloud_sample(
    topic: str,
    stamp_ns: int,
    xyz: ArrayLike,
    sigma: ArrayLike | None,
    published_s: float,
    error: ArrayLike | None = None,
) -> CloudSample:
    """Return a cloud thinned for the screen: points without a number are left out, then every k-th is kept.

    Args:
        topic: Where it comes from.
        stamp_ns: Its stamp.
        xyz: `(N, 3)` metres.
        sigma: `(N,)` metres, None where it is not known.
        published_s: When it was published, seconds of the host's clock.
        error: `(N,)` distance to the truth, metres, NaN or None where it is not known.
    """
    points = np.asarray(xyz, np.float32).reshape(-1, 3)
    rows = np.flatnonzero(np.isfinite(points).all(axis=1))
    total = len(rows)
    if total > MAX_POINTS:
        rows = rows[np.linspace(0, total - 1, MAX_POINTS).astype(np.intp)]
    columns = np.full((len(rows), 4), np.nan, np.float32)
    columns[:, :3] = points[rows]
    if sigma is not None:
        columns[:, 3] = np.asarray(sigma, np.float32)[rows]
    thinned: FloatArray32 | None = None if error is None else np.asarray(error, np.float32)[rows]
    return CloudSample(topic, stamp_ns, columns, total, published_s, thinned)
