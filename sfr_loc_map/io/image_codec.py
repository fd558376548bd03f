"""Images as 8-bit grey arrays, from files and from messages, of a bag or a ROS node; the true points of a pair."""

from __future__ import annotations

import re
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
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M, check_image_size
from sfr_loc_map.inputs import MAX_IMAGE_BYTES, read_bytes, refusing, stamp_of

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
JPEG_MAGIC = b"\xff\xd8"
FORMATS = "PNG, JPEG, PGM or PPM"  #: Formats that are read: those whose size is known before they are decoded.
_PNM = re.compile(rb"P[2356](?:\s+|\s*#[^\n]*\n)+(\d{1,9})(?:\s+|\s*#[^\n]*\n)+(\d{1,9})\s")
BAYER = {
    "rggb": cv2.COLOR_BayerBG2GRAY,
    "bggr": cv2.COLOR_BayerRG2GRAY,
    "gbrg": cv2.COLOR_BayerGR2GRAY,
    "grbg": cv2.COLOR_BayerGB2GRAY,
}
"""Mosaics by their first four pixels; OpenCV names them by the second pixels of the second and third row."""
_MOSAIC = re.compile(r"\s*bayer_(rggb|bggr|gbrg|grbg)(?:8|16)\s*(?:;\s*\w*\s*(?:compressed)?\s*)?")
LUMA = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}
"""Encodings of a luma and half a colour a pixel: which of the two samples is the luma."""
ENCODINGS: dict[str, tuple[type[np.generic], int]] = {
    **dict.fromkeys(("mono8", "8UC1"), (np.uint8, 1)),
    **dict.fromkeys(("mono16", "16UC1"), (np.uint16, 1)),
    **dict.fromkeys(("rgb8", "bgr8", "8UC3"), (np.uint8, 3)),
    **dict.fromkeys(("rgba8", "bgra8"), (np.uint8, 4)),
    **{f"bayer_{order}8": (np.uint8, 1) for order in BAYER},
    **{f"bayer_{order}16": (np.uint16, 1) for order in BAYER},
    **dict.fromkeys(LUMA, (np.uint8, 2)),
}
"""Encodings of sensor_msgs/Image that are read: type of a sample and samples per pixel."""
MAX_DECODED_BYTES = 2**27  #: Largest image that is decoded: 8192 x 8192 in 8-bit grey twice, 5792 x 5792 in colour.


def grey8(image: NDArray[Any], order: Literal["bgr", "rgb"] = "bgr") -> GreyImage:
    """Return an image `(H, W)` or `(H, W, 3 | 4)` of 8 or 16 bits as 8-bit grey: luma after ITU-R BT.601, no alpha."""
    if image.dtype == np.uint16:
        image = cv2.convertScaleAbs(image, alpha=1 / 257)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (3, 4)):
        raise InputError(f"image of {image.dtype} {image.shape} found: 8 or 16 bit grey or colour is needed")
    if image.ndim == 3:
        code = cv2.COLOR_BGR2GRAY if order == "bgr" else cv2.COLOR_RGB2GRAY
        image = cv2.cvtColor(np.ascontiguousarray(image[:, :, :3]), code)
    return np.ascontiguousarray(image)


def read_grey(path: Path) -> GreyImage:
    """Read an image file as 8-bit grey `(H, W)`."""
    with refusing(f"cannot read image '{path}'", "check the list of pairs"):
        data = read_bytes(path, MAX_IMAGE_BYTES)
    try:
        return decode_grey(data)
    except InputError as error:
        raise InputError(f"image '{path}': {error}") from error


def decode_grey(data: bytes | NDArray[np.uint8]) -> GreyImage:
    """Decode PNG, JPEG, PGM or PPM to 8-bit grey `(H, W)`; PNG checksums are verified, broken JPEG streams refused."""
    raw = bytes(data)
    size = claimed_size(raw)
    if size is None:
        raise InputError(f"its data is broken or of another format; {FORMATS} is needed: restore or convert it")
    try:
        check_image_size(*size, "it")
    except GeometryError as error:
        raise InputError(str(error)) from error
    if size[0] * size[1] * _decoded_pixel_bytes(raw) > MAX_DECODED_BYTES:
        raise InputError(
            f"it is {size[0]} x {size[1]} in colour or 16 bits: up to {MAX_DECODED_BYTES} bytes are decoded"
        )
    if raw.startswith(JPEG_MAGIC):
        with refusing("its JPEG data is broken", "restore the original"):
            return np.ascontiguousarray(simplejpeg.decode_jpeg(raw, "GRAY", strict=True)[:, :, 0])
    if raw.startswith(PNG_MAGIC):
        raw = _critical_chunks(raw)
    level = cv2.utils.logging.setLogLevel(0)  # what the library says of a broken one goes into the error
    try:
        image = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise InputError(f"its data is broken ({error.err}); restore the original") from error
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None:
        raise InputError("its data is broken; restore the original")
    return grey8(np.asarray(image))


def claimed_size(data: bytes) -> tuple[int, int] | None:
    """Return width and height that an image file claims; None where it is of no format that is read."""
    if data.startswith(PNG_MAGIC):  # the IHDR chunk comes first (ISO/IEC 15948, 11.2.2)
        return struct.unpack(">II", data[16:24]) if len(data) >= 24 else None
    if data.startswith(JPEG_MAGIC):
        try:
            height, width, *_ = simplejpeg.decode_jpeg_header(data)
        except ValueError:
            return None
        return int(width), int(height)
    found = _PNM.match(data[:4096])  # comments included
    return (int(found[1]), int(found[2])) if found else None


def _decoded_pixel_bytes(data: bytes) -> int:
    if data.startswith(PNG_MAGIC):
        return (2 if data[24:25] == b"\x10" else 1) * (1 if data[25:26] == b"\0" else 4)  # depth, kind of colour
    return 1 if data.startswith((JPEG_MAGIC, b"P2", b"P5")) else 4  # 8-bit grey, rarely 16 bits


def image_from_message(message: Any) -> GreyImage:  # noqa: ANN401 - a message of any library
    """Return a sensor_msgs/Image or sensor_msgs/CompressedImage (JPEG or PNG) as 8-bit grey `(H, W)`."""
    if not hasattr(message, "encoding"):
        return image_from_compressed_message(message)
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
    image, encoding = image.reshape(shape), message.encoding
    if encoding in LUMA:
        return np.ascontiguousarray(image[:, :, LUMA[encoding]])
    if encoding.startswith("bayer_"):
        return _demosaiced(image, encoding[6:10], f"image of stamp {stamp}")
    return grey8(image, "rgb" if encoding.startswith("rgb") else "bgr")


def image_from_compressed_message(message: Any) -> GreyImage:  # noqa: ANN401 - a sensor_msgs/CompressedImage
    """Return a sensor_msgs/CompressedImage (JPEG or PNG) as 8-bit grey `(H, W)`.

    `format` is `bayer_rggb8; png compressed` where the compressed image is the mosaic of the sensor; with a colour
    behind it (`...; jpeg compressed bgr8`) the mosaic was made an image before.
    """
    mosaic = _MOSAIC.fullmatch(str(getattr(message, "format", "")).lower())
    try:
        image = decode_grey(bytes(message.data))
        if mosaic is None or _has_colour(bytes(message.data)):
            return image
        return _demosaiced(image, mosaic[1], "it")
    except InputError as error:
        raise InputError(f"image of stamp {stamp_of(message)}: {error}") from error


def _demosaiced(image: NDArray[Any], order: str, name: str) -> GreyImage:
    """Return the grey image of a Bayer mosaic; `order` names its first four pixels."""
    height, width = image.shape
    if min(height, width) < 4:
        raise InputError(f"{name} is {width} x {height}: too small for a Bayer mosaic")
    return grey8(np.asarray(cv2.cvtColor(image, BAYER[order])))


def _has_colour(data: bytes) -> bool:
    """Tell whether a PNG or JPEG has more than one channel."""
    if data.startswith(PNG_MAGIC):
        return len(data) > 25 and data[25] not in (0, 4)  # colour type (ISO/IEC 15948, 11.2.2)
    return data.startswith(JPEG_MAGIC) and str(simplejpeg.decode_jpeg_header(data)[2]).lower() != "gray"


def encode_png(image: GreyImage) -> bytes:
    """Return the bytes of a PNG file (lossless)."""
    return bytes(cv2.imencode(".png", image)[1])


def encode_jpeg(image: GreyImage, quality: int) -> bytes:
    """Return the bytes of a grey JPEG file, quality 1 to 100."""
    return bytes(simplejpeg.encode_jpeg(image[:, :, None], quality, "GRAY", "GRAY"))


def _critical_chunks(raw: bytes) -> bytes:
    """Verify a PNG's chunks (ISO/IEC 15948, 5.3), return its critical ones: others may unpack to anything."""
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


def points_image(message: Any, size: tuple[int, int]) -> NDArray[np.float32]:  # noqa: ANN401 - a PointCloud2 of any library
    """Return an organised sensor_msgs/PointCloud2 of a size (width, height) as `(H, W, 3)` float32, metres."""
    offsets = {field.name: int(field.offset) for field in message.fields if int(field.datatype) == 7}
    shape, step, row = (int(message.height), int(message.width)), int(message.point_step), int(message.row_step)
    size_ok = (shape[1], shape[0]) == size and row >= step * shape[1] and len(message.data) >= row * shape[0]
    if not size_ok or any(name not in offsets or offsets[name] + 4 > step for name in "xyz"):
        raise InputError(
            f"ground_truth/points is {shape[1]} x {shape[0]} with float32 fields {sorted(offsets)}: an organised cloud "
            f"of {size[0]} x {size[1]} with x, y, z is needed"
        )
    order = ">f4" if message.is_bigendian else "<f4"
    layout = np.dtype(
        {"names": list("xyz"), "formats": [order] * 3, "offsets": [offsets[n] for n in "xyz"], "itemsize": step}
    )
    records = np.ndarray(shape, layout, np.frombuffer(message.data, np.uint8), strides=(row, step))
    points = np.stack([records[name].astype("<f4") for name in "xyz"], axis=-1)
    return checked_points(points, "ground_truth/points")


def checked_points(points: NDArray[np.floating], name: str) -> NDArray[np.float32]:
    """Return true points as float32, NaN where a number is not finite."""
    with np.errstate(invalid="ignore", over="ignore"):  # a NaN that signals; what is too large for float32
        points = np.array(points, np.float32)
    known = np.isfinite(points)
    points[~known] = np.nan
    if np.abs(points[known]).max(initial=0.0) > MAX_POSITION_M:
        raise InputError(f"{name} has a coordinate beyond {MAX_POSITION_M:g} m; NaN stands for no truth")
    return points
