"""Decoding of images in files and ROS messages to 8-bit grey arrays, and encoding as PNG and JPEG."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from sfr_loc_map.errors import GeometryError, InputError, naming
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.inputs import MAX_IMAGE_BYTES, read_bytes, refusing
from sfr_loc_map.message_stamps import stamp_of

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
JPEG_MAGIC = b"\xff\xd8"
FORMATS = "PNG, JPEG, PGM or PPM"  #: Supported formats, in which the size of an image is known before decoding.
_GAP = rb"(?:\s|#[^\n]*\n)++"
"""Gap between the numbers in the head of a PGM or PPM; possessive, to avoid backtracking."""
_PNM = re.compile(rb"P[2356]%b(\d{1,9})%b(\d{1,9})\s" % (_GAP, _GAP))
_BINARY_PNM = re.compile(rb"P[56]%b\d{1,9}%b\d{1,9}%b(\d{1,5})\s" % (_GAP, _GAP, _GAP))
"""Head of a binary PGM or PPM with the value of a white sample; `_PNM` is the head of any PGM or PPM."""
BAYER = {
    "rggb": cv2.COLOR_BayerBG2GRAY,
    "bggr": cv2.COLOR_BayerRG2GRAY,
    "gbrg": cv2.COLOR_BayerGR2GRAY,
    "grbg": cv2.COLOR_BayerGB2GRAY,
}
"""Mosaics by their first four pixels; OpenCV names a mosaic by the second and third pixel of the second row."""
_MOSAIC = re.compile(
    r"\s*bayer_?(rggb|bggr|gbrg|grbg|rg|bg|gb|gr)_?(?:8|10|12|14|16)\s*(?:;\s*\w*\s*(?:compressed)?\s*)?"
)
FIRST_TWO = {"rg": "rggb", "bg": "bggr", "gb": "gbrg", "gr": "grbg"}
"""Mosaics by the first two pixels in a GenICam name (BayerRG8)."""
LUMA = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}
"""Index of the luma in encodings with two samples per pixel, luma and chroma."""
PLANAR = ("nv12", "nv21", "nv24")  #: Encodings whose first plane is the luma, one byte per pixel.
ENCODINGS: dict[str, tuple[type[np.generic], int]] = {
    **dict.fromkeys(("mono8", "8UC1"), (np.uint8, 1)),
    **dict.fromkeys(("mono16", "16UC1"), (np.uint16, 1)),
    **dict.fromkeys(("rgb8", "bgr8", "8UC3"), (np.uint8, 3)),
    **dict.fromkeys(("rgb16", "bgr16", "16UC3"), (np.uint16, 3)),
    **dict.fromkeys(("rgba8", "bgra8", "8UC4"), (np.uint8, 4)),
    **dict.fromkeys(("rgba16", "bgra16", "16UC4"), (np.uint16, 4)),
    **{f"bayer_{order}8": (np.uint8, 1) for order in BAYER},
    **{f"bayer_{order}16": (np.uint16, 1) for order in BAYER},
    **dict.fromkeys(LUMA, (np.uint8, 2)),
    **dict.fromkeys(PLANAR, (np.uint8, 1)),
}
"""Supported encodings of sensor_msgs/Image: type of a sample and samples per pixel."""
MAX_DECODED_BYTES = 2**27  #: Largest decoded image, bytes: 8192 x 8192 in 16-bit grey, 5792 x 5792 in colour.
SAMPLE_BITS = (8, 10, 12, 14, 16)  #: Bit depths of sensors whose samples are sent as 16-bit numbers.
CODECS = (
    (r"RIFF....WEBP", "WebP"),
    (r"....ftyp(?:avif|avis)", "AVIF"),
    (r"....ftyp", "HEIF"),
    (r"\xff\x0a|....JXL ", "JPEG XL"),
    (r"....jP  |\xff\x4f\xff\x51", "JPEG 2000"),
    (r"II\*\0|MM\0\*", "TIFF"),
    (r"BM", "BMP"),
    (r"\x1f\x8b", "compressed by gzip"),
    (r"GIF8", "GIF"),
    (r"OggS", "Theora"),
    (r"\0\0\0?\x01[\x40-\x4f]", "H.265"),
    (r"\0\0\0?\x01", "H.264"),
    (r"\x12\0\x0a", "AV1"),
)
"""Patterns of the first bytes of unsupported codecs, and the names of the codecs."""
_CODECS = tuple((re.compile(pattern.encode("latin-1"), re.DOTALL), name) for pattern, name in CODECS)


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """An image as provided by a sensor or a file, with 8 or 16 bits per sample."""

    pixels: NDArray[Any]  #: `(H, W)` or `(H, W, 3 | 4)`, uint8 or uint16.
    order: Literal["bgr", "rgb"] = "bgr"  #: Order of the colours.
    mosaic: str = ""  #: First four pixels of a Bayer mosaic, empty for none.

    @property
    def bits(self) -> int:
        """The smallest of `SAMPLE_BITS` that holds every sample; 0 for 8-bit samples."""
        if self.pixels.dtype != np.uint16:
            return 0
        largest = int(self.pixels[..., :3].max(initial=0) if self.pixels.ndim == 3 else self.pixels.max(initial=0))
        return next(bits for bits in SAMPLE_BITS if largest < 2**bits)

    def grey(self, bits: int = 16) -> GreyImage:
        """Return the image as 8-bit grey; `bits` is the bit depth of 16-bit samples."""
        pixels = self.pixels
        if self.mosaic:
            pixels = np.asarray(cv2.cvtColor(pixels, BAYER[self.mosaic]))
        return grey8(pixels, self.order, bits)


class SampleDepth:
    """Bit depth of the 16-bit samples of a stereo camera: the smallest of `SAMPLE_BITS` that holds all samples so far.

    Sensors of 10, 12 or 14 bits use the lower part of the 16-bit range (mono16). Both images of a pair have the same
    depth. The depth never decreases. If it increases, the brightness scale changes once, which is reported.
    """

    def __init__(self, report: Callable[[str], object], name: str, bits: int = 0) -> None:
        """`report` is called with the detected depth of the images of `name`. A `bits` above 0 fixes the depth."""
        self.bits = bits
        self._reported_bits = bits  # largest depth of the samples that was reported, if the depth is given
        self._report, self._name, self._is_given = report, name, bits > 0

    def grey(self, *images: Samples) -> list[GreyImage]:
        """Return the images of a pair as 8-bit grey."""
        found = max(image.bits for image in images)
        if found > self._reported_bits and self._is_given:
            self._reported_bits = found
            self._report(
                f"images of '{self._name}' have samples of {found} bits, but a depth of {self.bits} bits is given: "
                "brighter samples are saturated; correct input.sample_bits"
            )
        if found > self.bits and not self._is_given:
            has_changed = self.bits > 0
            self.bits = found
            if has_changed or found < SAMPLE_BITS[-1]:
                change = "; earlier images were scaled by fewer bits, so the brightness changes" if has_changed else ""
                self._report(
                    f"images of '{self._name}' have 16-bit samples, of which {found} bits are used "
                    f"(0 to {2**found - 1}){change}"
                )
        return [image.grey(self.bits or SAMPLE_BITS[-1]) for image in images]


def grey8(image: NDArray[Any], order: Literal["bgr", "rgb"] = "bgr", bits: int = 16) -> GreyImage:
    """Return an image `(H, W)` or `(H, W, 3 | 4)` of 8 or 16 bits as 8-bit grey: luma of ITU-R BT.601, no alpha.

    `bits` is the bit depth of 16-bit samples, and the largest value of this depth becomes 255.
    """
    if image.dtype == np.uint16:
        image = cv2.convertScaleAbs(image, alpha=255 / (2**bits - 1))
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (3, 4)):
        raise InputError(f"the image is {image.dtype} {image.shape}:", "8 or 16 bit grey or colour is required")
    if image.ndim == 3:
        code = cv2.COLOR_BGR2GRAY if order == "bgr" else cv2.COLOR_RGB2GRAY
        image = cv2.cvtColor(np.ascontiguousarray(image[:, :, :3]), code)
    return np.ascontiguousarray(image)


def read_grey(path: Path) -> GreyImage:
    """Read an image file as 8-bit grey `(H, W)`."""
    return read_samples(path).grey()


def read_samples(path: Path) -> Samples:
    """Read an image file."""
    with refusing(f"cannot read image '{path}'", "check the list of pairs"):
        data = read_bytes(path, MAX_IMAGE_BYTES)
    with naming(path):
        return decoded(data)


def decoded(raw: bytes) -> Samples:
    """Decode PNG, JPEG, PGM or PPM; PNG checksums are verified, and corrupt JPEG data are rejected."""
    size = claimed_size(raw)
    if size is None:
        codec = codec_of(raw)
        found = f"it is {codec}, which is not supported" if codec else "its data is corrupt or has another format"
        raise InputError(f"{found}; {FORMATS} is required:", "restore or convert it")
    try:
        check_image_size(*size, "it")
    except GeometryError as error:
        raise InputError(str(error)) from error
    if size[0] * size[1] * _decoded_pixel_bytes(raw) > MAX_DECODED_BYTES:
        raise InputError(
            f"it is {size[0]} x {size[1]} and exceeds {MAX_DECODED_BYTES} bytes when decoded:", "reduce the image"
        )
    if raw.startswith(JPEG_MAGIC):
        with refusing("its JPEG data is corrupt", "restore the original"):
            return Samples(np.ascontiguousarray(simplejpeg.decode_jpeg(raw, "GRAY", strict=True)[:, :, 0]))
    if raw.startswith(PNG_MAGIC):
        raw = _critical_chunks(raw)
    elif raw.startswith((b"P2", b"P3")):
        raw += b"\n"  # OpenCV rejects text without a separator after the last number
    level = cv2.utils.logging.setLogLevel(0)  # errors of corrupt images are reported by exceptions
    try:
        image = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise InputError(f"its data is corrupt ({error.err});", "restore the original") from error
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None:
        raise InputError("its data is corrupt;", "restore the original")
    binary = _BINARY_PNM.match(raw[:4096])
    if binary and (white := int(binary[1])) < 255:  # OpenCV scales text, but not binary samples
        image = np.minimum(image.astype(np.uint32) * 255 // white, 255).astype(np.uint8)
    return Samples(np.asarray(image))


def codec_of(data: bytes) -> str:
    """Return the name of an unsupported codec by the first bytes of the data; empty if the codec is unknown."""
    return next((name for pattern, name in _CODECS if pattern.match(data[:16])), "")


def claimed_size(data: bytes) -> tuple[int, int] | None:
    """Return the width and height in the header of an image file; None if the format is not supported."""
    if data.startswith(PNG_MAGIC):  # the IHDR chunk comes first (ISO/IEC 15948, 11.2.2)
        return struct.unpack(">II", data[16:24]) if len(data) >= 24 else None
    if data.startswith(JPEG_MAGIC):
        try:
            height, width, *_ = simplejpeg.decode_jpeg_header(data)
        except ValueError:
            return None
        return int(width), int(height)
    found = _PNM.match(data[:4096])  # the head with its comments
    return (int(found[1]), int(found[2])) if found else None


def _decoded_pixel_bytes(data: bytes) -> int:
    if data.startswith(PNG_MAGIC):
        return (2 if data[24:25] == b"\x10" else 1) * (1 if data[25:26] == b"\0" else 4)  # bit depth, colour type
    return 1 if data.startswith((JPEG_MAGIC, b"P2", b"P5")) else 4  # 8-bit grey, rarely 16 bits


def samples_of(message: Any) -> Samples:  # noqa: ANN401 - a message of any library
    """Return the image of a sensor_msgs/Image or sensor_msgs/CompressedImage (JPEG or PNG)."""
    if not hasattr(message, "encoding"):
        return _samples_of_compressed(message)
    stamp = stamp_of(message)
    if message.encoding not in ENCODINGS:
        known = ", ".join(ENCODINGS)
        raise InputError(f"image of stamp {stamp} has encoding '{message.encoding}':", f"one of {known} is required")
    kind, samples = ENCODINGS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.frombuffer(message.data, np.uint8)
    row = width * samples * dtype.itemsize
    if height <= 0 or width <= 0 or step < row or len(data) < step * (height - 1) + row:
        raise InputError(
            f"image of stamp {stamp} is {width} x {height} {message.encoding} with step {step} and {len(data)} bytes, "
            "which are too few: the message is corrupt"
        )
    rows = np.lib.stride_tricks.as_strided(data, (height, row), (step, 1), writeable=False)
    image = np.ascontiguousarray(rows).view(dtype).astype(kind, copy=False)
    shape = (height, width) if samples == 1 else (height, width, samples)
    image, encoding = image.reshape(shape), message.encoding
    if encoding in LUMA:
        return Samples(np.ascontiguousarray(image[:, :, LUMA[encoding]]))
    if encoding.startswith("bayer_"):
        return _mosaic(image, encoding[6:10], f"image of stamp {stamp}")
    return Samples(image, "rgb" if encoding.startswith("rgb") else "bgr")


def _samples_of_compressed(message: Any) -> Samples:  # noqa: ANN401 - a sensor_msgs/CompressedImage
    """Return the image of a sensor_msgs/CompressedImage (JPEG or PNG).

    If `format` is `bayer_rggb8; png compressed`, the compressed image is the mosaic of the sensor. If a colour encoding
    follows (`...; jpeg compressed bgr8`), the mosaic was converted before the compression.
    """
    form = str(getattr(message, "format", "")).lower()
    mosaic = _MOSAIC.fullmatch(form)
    data = bytes(message.data)
    with naming(f"image of stamp {stamp_of(message)}"):
        if claimed_size(data) is None:
            raise InputError(f"{unread_codec(message)}:", "publish raw images, PNG or JPEG")
        image = decoded(data)
        if _has_colour(data):
            return image
        if mosaic is not None:
            pixels = image.pixels if image.pixels.ndim == 2 else image.pixels[:, :, 0]  # grey with alpha
            return _mosaic(np.ascontiguousarray(pixels), FIRST_TWO.get(mosaic[1], mosaic[1]), "it")
        if "bayer" in form and not form.partition("compressed")[2].strip():
            raise InputError(
                f"its format '{form[:40]}' is a Bayer mosaic of unknown order:", "name the order, such as bayer_rggb8"
            )
        return image


def unread_codec(message: Any) -> str:  # noqa: ANN401 - a sensor_msgs/CompressedImage
    """Return the end of a message about a sensor_msgs/CompressedImage that is neither PNG nor JPEG."""
    form = str(getattr(message, "format", ""))[:40]
    named = f" (format '{form}')" if form else ""
    data = bytes(message.data[:16])
    if not data:
        return f"it has no data{named}"
    codec = codec_of(data)
    return f"it is {codec}{named}, which is not supported" if codec else f"it is neither PNG nor JPEG{named}"


def _mosaic(image: NDArray[Any], order: str, name: str) -> Samples:
    """Return the samples of a Bayer mosaic; `order` names its first four pixels."""
    height, width = image.shape
    if min(height, width) < 4:
        raise InputError(f"{name} is {width} x {height}: too small for a Bayer mosaic")
    return Samples(image, mosaic=order)


def _has_colour(data: bytes) -> bool:
    """Return whether a PNG or JPEG has more than one channel."""
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
    """Verify a PNG's chunks (ISO/IEC 15948, 5.3).

    Return only the critical chunks, because others may decompress to any size.
    """
    offset, kind, kept = len(PNG_MAGIC), b"", [PNG_MAGIC]
    while kind != b"IEND":
        head = raw[offset : offset + 8]
        if len(head) < 8:
            raise InputError("its PNG data is truncated;", "restore the original")
        (length,), kind = struct.unpack(">I", head[:4]), head[4:]
        end = offset + 8 + length
        if len(raw) < end + 4 or zlib.crc32(raw[offset + 4 : end]) != struct.unpack(">I", raw[end : end + 4])[0]:
            raise InputError("its PNG data is corrupt (checksum or length wrong);", "restore the original")
        if not kind[0] & 0x20:  # an upper case letter: critical (5.4)
            kept.append(raw[offset : end + 4])
        offset = end + 4
    return b"".join(kept)
