"""What an image file claims to be: format and size, read before anything is decoded or allocated."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable

import simplejpeg

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
JPEG_MAGIC = b"\xff\xd8"
FORMATS = "PNG, JPEG, PGM, PPM or BMP"
"""Formats that are read: those whose size is known before they are decoded."""
_PNM = re.compile(rb"P[2356](?:\s+|\s*#[^\n]*\n)+(\d{1,9})(?:\s+|\s*#[^\n]*\n)+(\d{1,9})\s")
_HEAD = 4096
"""Bytes that the header of a PGM or PPM may have, comments included."""


def claimed_size(data: bytes) -> tuple[int, int] | None:
    """Return width and height that an image file claims; None where it is of no format that is read."""
    for magic, size in _SIZES.items():
        if data.startswith(magic):
            return size(data)
    return None


def decoded_pixel_bytes(data: bytes) -> int:
    """Return how many bytes a pixel of an image file may have once decoded; 0 where the header is cut off."""
    if data.startswith(PNG_MAGIC):
        depth, colour = data[24:25], data[25:26]
        return (2 if depth == b"\x10" else 1) * (1 if colour == b"\0" else 4)
    if data.startswith((JPEG_MAGIC, b"P2", b"P5")):  # 8-bit grey, whatever the file has; rarely 16 bits
        return 1
    return 4


def _png_size(data: bytes) -> tuple[int, int] | None:
    """Return the size in the IHDR chunk, which comes first (ISO/IEC 15948, 11.2.2)."""
    return struct.unpack(">II", data[16:24]) if len(data) >= 24 else None


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    try:
        height, width, *_ = simplejpeg.decode_jpeg_header(data)
    except ValueError:
        return None
    return int(width), int(height)


def _pnm_size(data: bytes) -> tuple[int, int] | None:
    found = _PNM.match(data[:_HEAD])
    return (int(found[1]), int(found[2])) if found else None


def _bmp_size(data: bytes) -> tuple[int, int] | None:
    """Return the size in the BITMAPINFOHEADER; rows from top to bottom have a negative height."""
    if len(data) < 26 or struct.unpack("<I", data[14:18])[0] < 40:
        return None
    width, height = struct.unpack("<ii", data[18:26])
    return width, abs(height)


_SIZES: dict[bytes, Callable[[bytes], tuple[int, int] | None]] = {
    PNG_MAGIC: _png_size,
    JPEG_MAGIC: _jpeg_size,
    **{b"P%d" % digit: _pnm_size for digit in (2, 3, 5, 6)},
    b"BM": _bmp_size,
}
