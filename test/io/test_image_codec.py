"""Images of messages and files as 8-bit grey."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.image_codec import (
    decode_grey,
    encode_jpeg,
    encode_png,
    image_from_compressed_message,
    image_from_message,
)

images = hnp.arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9)))
HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=12, nanosec=34))
LUMA = np.array([0.299, 0.587, 0.114])  # of red, green, blue: ITU-R BT.601


def message(array: np.ndarray, coding: str, padding: int = 0, *, big: bool = False, **changes: Any) -> Any:
    """Return an image message with padded rows."""
    array = array.astype(array.dtype.newbyteorder(">" if big else "<"))
    rows = array.reshape(len(array), -1).view(np.uint8)
    rows = np.hstack((rows, np.full((len(rows), padding), 77, np.uint8)))
    fields = {"header": HEADER, "height": len(array), "width": array.shape[1], "encoding": coding}
    fields |= {"is_bigendian": int(big), "step": rows.shape[1], "data": rows.reshape(-1)}
    return SimpleNamespace(**fields | changes)


@given(images, st.integers(0, 5), st.booleans())
def test_grey_of_8_and_16_bits_with_padding(image: np.ndarray, padding: int, big: bool) -> None:
    np.testing.assert_array_equal(image_from_message(message(image, "mono8", padding)), image)
    np.testing.assert_array_equal(decode_grey(encode_png(image)), image)
    sixteen = image.astype(np.uint16) * 257  # 0 .. 255 spread to 0 .. 65535
    for coding in ("mono16", "16UC1"):
        np.testing.assert_array_equal(image_from_message(message(sixteen, coding, padding, big=big)), image)


@given(images)
def test_colours_become_luma_in_any_order(image: np.ndarray) -> None:
    rgb = np.dstack((image, image // 2, 255 - image))
    first = image_from_message(message(rgb, "rgb8"))
    assert np.abs(first - rgb @ LUMA).max() <= 0.6
    alpha = np.dstack((rgb, image)), np.dstack((rgb[..., ::-1], image))
    for colour, coding in ((rgb[..., ::-1], "bgr8"), (alpha[0], "rgba8"), (alpha[1], "bgra8")):
        np.testing.assert_array_equal(image_from_message(message(colour, coding)), first)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
def test_mosaics_become_luma(order: str, bits: int) -> None:
    colours = {"r": 200, "g": 120, "b": 40}
    mosaic = np.tile(np.reshape([colours[name] for name in order], (2, 2)), (5, 6)).astype(np.uint8)
    if bits == 16:
        mosaic = mosaic.astype(np.uint16) * 257
    found = image_from_message(message(mosaic, f"bayer_{order}{bits}"))
    assert found.shape == mosaic.shape
    assert np.abs(found[1:-1, 1:-1] - LUMA @ [200, 120, 40]).max() <= 1.0


@pytest.mark.parametrize(("coding", "luma_at"), [("yuv422", 1), ("uyvy", 1), ("yuv422_yuy2", 0), ("yuyv", 0)])
def test_luma_of_yuv422_is_the_image(coding: str, luma_at: int) -> None:
    pixels = np.random.default_rng(7).integers(0, 256, (6, 8, 2), dtype=np.uint8)
    np.testing.assert_array_equal(image_from_message(message(pixels, coding, 3)), pixels[..., luma_at])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"encoding": "nv21"}, "encoding 'nv21'.*mono8"),
        ({"encoding": "yuv422"}, "too few"),
        ({"encoding": "bayer_rggb8", "height": 3}, "too small for a Bayer mosaic"),
        ({"step": 3}, "step 3"),
        ({"width": 0}, "0 x 4"),
    ],
)
def test_broken_messages_name_the_stamp(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=f"stamp 12000000034 .*{words}"):
        image_from_message(message(np.zeros((4, 4), np.uint8), "mono8", **changes))


def smooth_image() -> np.ndarray:
    rng = np.random.default_rng(0)
    return cv2.GaussianBlur(rng.integers(0, 256, (64, 64), dtype=np.uint8), (0, 0), 2)


def test_any_flipped_byte_of_a_png_is_noticed() -> None:
    data = encode_png(smooth_image())
    for place in np.random.default_rng(1).integers(8, len(data), 100):
        broken = bytearray(data)
        broken[place] ^= 0x10
        with pytest.raises(InputError):
            decode_grey(bytes(broken))


def test_jpeg_is_close_and_a_cut_or_garbled_one_is_refused() -> None:
    image = smooth_image()
    data = encode_jpeg(image, 95)
    assert np.abs(decode_grey(data).astype(int) - image).max() <= 6
    np.testing.assert_array_equal(decode_grey(data), cv2.imdecode(np.frombuffer(data, np.uint8), 0))
    red = np.full((32, 32, 3), (0, 0, 200), np.uint8)  # in BGR
    assert np.abs(decode_grey(bytes(cv2.imencode(".jpg", red)[1])) - LUMA[0] * 200).max() <= 2
    garbled = bytearray(data)
    garbled[300:500:5] = b"\xd9" * 40
    for broken in (data[:-300], data[:100], bytes(garbled), b"\xff\xd8", b""):
        with pytest.raises(InputError, match="stamp 12000000034"):
            image_from_compressed_message(SimpleNamespace(header=HEADER, data=np.frombuffer(broken, np.uint8)))


def png(depth: int, colour: int, side: int) -> bytes:
    """Return the beginning of a PNG."""
    header = struct.pack(">II5B", side, side, depth, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", len(header)) + b"IHDR" + header + bytes(100)


SMALL = r"up to \d+ (in all|bytes are decoded)"


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"P5\n-1 2\n255\n" + bytes(9), "another format"),
        (b"P5\n999999 999999\n255\n" + bytes(9), "it is 999999 x 999999"),
        (b"P5\n20 20\n255\n" + bytes(9), "broken"),
        (b"P3\n2 2\n255\n1 2 x", "broken"),
        *((png(depth, colour, side), SMALL) for depth, colour, side in ((8, 0, 8193), (8, 2, 8000), (16, 6, 5000))),
    ],
)
def test_broken_or_too_large_images_are_refused_in_silence(
    data: bytes, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match=words):
        decode_grey(data)
    assert capfd.readouterr() == ("", "")
