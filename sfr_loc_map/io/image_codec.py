"""Images as 8-bit grey arrays, from files and from image messages.

The functions for messages read attributes only (`height`, `encoding`, `data`, ...), so messages of a bag reader and
of a ROS client library are taken alike.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.inputs import MAX_IMAGE_BYTES, read_bytes
from sfr_loc_map.io.image_header import FORMATS, JPEG_MAGIC, PNG_MAGIC, claimed_size, decoded_pixel_bytes

BAYER = {
    "rggb": cv2.COLOR_BayerBG2GRAY,
    "bggr": cv2.COLOR_BayerRG2GRAY,
    "gbrg": cv2.COLOR_BayerGR2GRAY,
    "grbg": cv2.COLOR_BayerGB2GRAY,
}
"""Mosaics by their first four pixels; OpenCV names them by the second pixels of the second and third row."""
LUMA = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}
"""Encodings of a luma and half a colour a pixel: which of the two samples is the luma."""
ENCODINGS: dict[str, tuple[type[np.generic], int]] = {
    "mono8": (np.uint8, 1),
    "8UC1": (np.uint8, 1),
    "mono16": (np.uint16, 1),
    "16UC1": (np.uint16, 1),
    "rgb8": (np.uint8, 3),
    "bgr8": (np.uint8, 3),
    "8UC3": (np.uint8, 3),
    "rgba8": (np.uint8, 4),
    "bgra8": (np.uint8, 4),
    **{f"bayer_{order}8": (np.uint8, 1) for order in BAYER},
    **{f"bayer_{order}16": (np.uint16, 1) for order in BAYER},
    **dict.fromkeys(LUMA, (np.uint8, 2)),
}
"""Encodings of sensor_msgs/Image that are read: type of a sample and samples per pixel."""
MIN_MOSAIC = 4
"""Least side of a Bayer mosaic, pixels."""
MAX_DECODED_BYTES = 2**27
"""Largest image that is decoded: 8192 x 8192 in 8-bit grey twice, 5792 x 5792 in colour."""
ROWS_AT_ONCE = 256
SILENT = 0
"""Level of OpenCV's log."""


def grey8(image: NDArray[Any], order: Literal["bgr", "rgb"] = "bgr") -> GreyImage:
    """Return an image as 8-bit grey.

    Args:
        image: `(H, W)` or `(H, W, 1 | 3 | 4)`, uint8 or uint16 (0 .. 65535 becomes 0 .. 255, rounded; colour becomes
            luma after ITU-R BT.601, alpha is left out).
        order: Order of the colours.

    Raises:
        InputError: For another shape or type.
    """
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.dtype == np.uint16:
        image = _eight_bits(image)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (3, 4)):
        raise InputError(f"image of {image.dtype} {image.shape} found: 8 or 16 bit grey or colour is needed")
    if image.ndim == 3:
        code = cv2.COLOR_BGR2GRAY if order == "bgr" else cv2.COLOR_RGB2GRAY
        image = cv2.cvtColor(np.ascontiguousarray(image[:, :, :3]), code)
    return np.ascontiguousarray(image)


def _eight_bits(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return 16 bits as 8, rounded; a part at a time, so that large images take no multiple of their memory."""
    out = np.empty(image.shape, np.uint8)
    for first in range(0, len(image), ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        out[rows] = (image[rows].astype(np.uint32) + 128) // 257
    return out


def read_grey(path: Path) -> GreyImage:
    """Read an image file as 8-bit grey `(H, W)`.

    Raises:
        InputError: If the file is missing or its data is broken.
    """
    try:
        data = read_bytes(path, MAX_IMAGE_BYTES)
    except OSError as error:
        raise InputError(f"cannot read image '{path}': {error.strerror}; check the list of pairs") from error
    try:
        return decode_grey(data)
    except InputError as error:
        raise InputError(f"image '{path}': {error}") from error


def decode_grey(data: bytes | NDArray[np.uint8]) -> GreyImage:
    """Decode the bytes of an image file (PNG, JPEG, PGM, PPM, BMP) to 8-bit grey `(H, W)`.

    PNG checksums are verified, and a JPEG stream that the decoder could only guess at is refused.

    Raises:
        InputError: If it is of another format, larger than 8192 x 8192 or broken.
    """
    raw = bytes(data)
    size = claimed_size(raw)
    if size is None:
        raise InputError(f"its data is broken or of another format; {FORMATS} is needed: restore or convert it")
    try:
        check_image_size(*size, "it")
    except GeometryError as error:
        raise InputError(str(error)) from error
    if size[0] * size[1] * decoded_pixel_bytes(raw) > MAX_DECODED_BYTES:
        raise InputError(
            f"it is {size[0]} x {size[1]} in colour or 16 bits: up to {MAX_DECODED_BYTES} bytes are decoded"
        )
    if raw.startswith(JPEG_MAGIC):
        return _decode_jpeg(raw)
    if raw.startswith(PNG_MAGIC):
        raw = _critical_chunks(raw)
    return grey8(_decode_by_opencv(raw))


def image_from_message(message: Any) -> GreyImage:  # noqa: ANN401 - a sensor_msgs/Image of any library
    """Return a sensor_msgs/Image as 8-bit grey `(H, W)`.

    Raises:
        InputError: For an encoding that is not read or data of the wrong length; names the stamp.
    """
    stamp = stamp_of(message)
    if message.encoding not in ENCODINGS:
        known = ", ".join(ENCODINGS)
        raise InputError(f"image of stamp {stamp} has encoding '{message.encoding}': one of {known} is needed")
    kind, samples = ENCODINGS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.frombuffer(message.data, np.uint8)
    row = width * samples * dtype.itemsize
    if height <= 0 or width <= 0 or step < row or len(data) < step * (height - 1) + row:
        raise InputError(
            f"image of stamp {stamp} is {width} x {height} {message.encoding} with step {step} and {len(data)} bytes: "
            f"too few; the message is broken"
        )
    rows = np.lib.stride_tricks.as_strided(data, (height, row), (step, 1), writeable=False)
    image = np.ascontiguousarray(rows).view(dtype).astype(kind, copy=False)
    shape = (height, width) if samples == 1 else (height, width, samples)
    try:
        return _grey_of(image.reshape(shape), message.encoding)
    except InputError as error:
        raise InputError(f"image of stamp {stamp} {error}") from error


def _grey_of(image: NDArray[Any], encoding: str) -> GreyImage:
    """Return samples of an encoding as 8-bit grey."""
    if encoding in LUMA:
        return np.ascontiguousarray(image[:, :, LUMA[encoding]])
    if encoding.startswith("bayer_"):
        if min(image.shape) < MIN_MOSAIC:
            raise InputError(f"is {image.shape[1]} x {image.shape[0]}: too small for a Bayer mosaic")
        return grey8(np.asarray(cv2.cvtColor(image, BAYER[encoding[6:10]])))
    return grey8(image, "rgb" if encoding.startswith("rgb") else "bgr")


def image_from_compressed_message(message: Any) -> GreyImage:  # noqa: ANN401 - a sensor_msgs/CompressedImage
    """Return a sensor_msgs/CompressedImage (JPEG or PNG) as 8-bit grey `(H, W)`.

    Raises:
        InputError: If the data is broken; names the stamp.
    """
    try:
        return decode_grey(bytes(message.data))
    except InputError as error:
        raise InputError(f"image of stamp {stamp_of(message)}: {error}") from error


def stamp_of(message: Any) -> int:  # noqa: ANN401 - any message with a header
    """Return the header's stamp of a message, nanoseconds."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def encode_png(image: GreyImage) -> bytes:
    """Return the bytes of a PNG file (lossless)."""
    return bytes(cv2.imencode(".png", image)[1])


def encode_jpeg(image: GreyImage, quality: int) -> bytes:
    """Return the bytes of a grey JPEG file, quality 1 to 100."""
    return bytes(simplejpeg.encode_jpeg(image[:, :, None], quality, "GRAY", "GRAY"))


def _decode_by_opencv(raw: bytes) -> NDArray[Any]:
    """Decode an image file; what the library has to say of a broken one goes into the error, not to the terminal."""
    level = cv2.utils.logging.setLogLevel(SILENT)
    try:
        image = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise InputError(f"its data is broken ({error.err}); restore the original") from error
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None:
        raise InputError("its data is broken; restore the original")
    return np.asarray(image)


def _decode_jpeg(raw: bytes) -> GreyImage:
    try:
        return np.ascontiguousarray(simplejpeg.decode_jpeg(raw, "GRAY", strict=True)[:, :, 0])
    except ValueError as error:
        raise InputError(f"its JPEG data is broken ({error}); restore the original") from error


def _critical_chunks(raw: bytes) -> bytes:
    """Verify the chunks of a PNG (ISO/IEC 15948, 5.3): each ends in the CRC-32 of its type and data.

    Returns:
        The file with critical chunks alone: the pixels do not depend on others (texts, profiles, transparency), which
        may unpack to anything.
    """
    offset, kind, kept = len(PNG_MAGIC), b"", [PNG_MAGIC]
    while kind != b"IEND":
        head = raw[offset : offset + 8]
        if len(head) < 8:
            raise InputError("its PNG data is cut off; restore the original")
        (length,), kind = struct.unpack(">I", head[:4]), head[4:]
        end = offset + 8 + length
        if len(raw) < end + 4 or zlib.crc32(raw[offset + 4 : end]) != struct.unpack(">I", raw[end : end + 4])[0]:
            raise InputError("its PNG data is broken (checksum or length wrong); restore the original")
        if not kind[0] & 0x20:  # an upper case letter: critical (5.4)
            kept.append(raw[offset : end + 4])
        offset = end + 4
    return b"".join(kept)
