"""Images of messages and files as 8-bit grey."""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.image_codec import PNG_MAGIC, SampleDepth, Samples, decoded, encode_jpeg, encode_png, samples_of

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
    np.testing.assert_array_equal(samples_of(message(image, "mono8", padding)).grey(), image)
    np.testing.assert_array_equal(decoded(encode_png(image)).grey(), image)
    sixteen = image.astype(np.uint16) * 257  # 0 .. 255 spread to 0 .. 65535
    for coding in ("mono16", "16UC1"):
        np.testing.assert_array_equal(samples_of(message(sixteen, coding, padding, big=big)).grey(), image)


@given(images)
def test_colours_become_luma_in_any_order(image: np.ndarray) -> None:
    rgb = np.dstack((image, image // 2, 255 - image))
    first = samples_of(message(rgb, "rgb8")).grey()
    assert np.abs(first - rgb @ LUMA).max() <= 0.6
    alpha = np.dstack((rgb, image)), np.dstack((rgb[..., ::-1], image))
    for colour, coding in ((rgb[..., ::-1], "bgr8"), (alpha[0], "rgba8"), (alpha[1], "bgra8")):
        np.testing.assert_array_equal(samples_of(message(colour, coding)).grey(), first)


def test_a_mosaic_in_a_png_may_have_an_alpha_channel() -> None:
    mosaic = np.random.default_rng(3).integers(0, 256, (6, 8), dtype=np.uint8)
    rows = b"".join(b"\0" + np.dstack((row, np.full_like(row, 255))).tobytes() for row in mosaic)
    parts = (b"IHDR" + struct.pack(">IIBBBBB", 8, 6, 8, 4, 0, 0, 0), b"IDAT" + zlib.compress(rows), b"IEND")
    chunks = (struct.pack(">I", len(part) - 4) + part + struct.pack(">I", zlib.crc32(part)) for part in parts)
    data = np.frombuffer(PNG_MAGIC + b"".join(chunks), np.uint8)
    found = samples_of(SimpleNamespace(header=HEADER, format="bayer_rggb8; png compressed", data=data))
    np.testing.assert_array_equal(found.grey(), samples_of(message(mosaic, "bayer_rggb8")).grey())


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
def test_mosaics_become_luma(order: str, bits: int) -> None:
    colours = {"r": 200, "g": 120, "b": 40}
    mosaic = np.tile(np.reshape([colours[name] for name in order], (2, 2)), (5, 6)).astype(np.uint8)
    if bits == 16:
        mosaic = mosaic.astype(np.uint16) * 257
    found = samples_of(message(mosaic, f"bayer_{order}{bits}")).grey()
    assert found.shape == mosaic.shape
    assert np.abs(found[1:-1, 1:-1] - LUMA @ [200, 120, 40]).max() <= 1.0


@pytest.mark.parametrize(("coding", "luma_at"), [("yuv422", 1), ("uyvy", 1), ("yuv422_yuy2", 0), ("yuyv", 0)])
def test_luma_of_yuv422_is_the_image(coding: str, luma_at: int) -> None:
    pixels = np.random.default_rng(7).integers(0, 256, (6, 8, 2), dtype=np.uint8)
    np.testing.assert_array_equal(samples_of(message(pixels, coding, 3)).grey(), pixels[..., luma_at])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"encoding": "32FC1"}, "encoding '32FC1'.*mono8"),
        ({"encoding": "yuv422"}, "too few"),
        ({"encoding": "bayer_rggb8", "height": 3}, "too small for a Bayer mosaic"),
        ({"step": 3}, "step 3"),
        ({"width": 0}, "0 x 4"),
    ],
)
def test_broken_messages_name_the_stamp(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=f"stamp 12000000034 .*{words}"):
        samples_of(message(np.zeros((4, 4), np.uint8), "mono8", **changes))


def smooth_image() -> np.ndarray:
    rng = np.random.default_rng(0)
    return cv2.GaussianBlur(rng.integers(0, 256, (64, 64), dtype=np.uint8), (0, 0), 2)


@pytest.mark.parametrize(
    "data",
    [
        b"P5\n# white is 15\n2 2\n15\n" + bytes([0, 5, 7, 15]),
        b"P6 2 2 15\n" + bytes([0, 0, 0, 5, 5, 5, 7, 7, 7, 15, 15, 15]),
        b"P2\n2 2\n15\n0 5\n7 15",
        b"P3\n2 2\n15\n0 0 0 5 5 5\n7 7 7 15 15 15",
    ],
)
def test_the_white_of_pgm_and_ppm_is_255_and_the_last_line_needs_no_end(data: bytes) -> None:
    assert decoded(data).grey().tolist() == [[0, 85], [119, 255]]


def test_any_flipped_byte_of_a_png_is_noticed() -> None:
    data = encode_png(smooth_image())
    for place in np.random.default_rng(1).integers(8, len(data), 100):
        broken = bytearray(data)
        broken[place] ^= 0x10
        with pytest.raises(InputError):
            decoded(bytes(broken)).grey()


def test_jpeg_is_close_and_a_cut_or_garbled_one_is_refused() -> None:
    image = smooth_image()
    data = encode_jpeg(image, 95)
    assert np.abs(decoded(data).grey().astype(int) - image).max() <= 6
    np.testing.assert_array_equal(decoded(data).grey(), cv2.imdecode(np.frombuffer(data, np.uint8), 0))
    red = np.full((32, 32, 3), (0, 0, 200), np.uint8)  # in BGR
    assert np.abs(decoded(bytes(cv2.imencode(".jpg", red)[1])).grey() - LUMA[0] * 200).max() <= 2
    garbled = bytearray(data)
    garbled[300:500:5] = b"\xd9" * 40
    for broken in (data[:-300], data[:100], bytes(garbled), b"\xff\xd8", b""):
        with pytest.raises(InputError, match="stamp 12000000034"):
            samples_of(SimpleNamespace(header=HEADER, data=np.frombuffer(broken, np.uint8))).grey()


def png(depth: int, colour: int, side: int) -> bytes:
    """Return the beginning of a PNG."""
    header = struct.pack(">II5B", side, side, depth, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", len(header)) + b"IHDR" + header + bytes(100)


SMALL = r"(at most \d+ pixels in total|exceeds \d+ bytes when decoded)"


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"P5\n-1 2\n255\n" + bytes(9), "another format"),
        (b"P5\n999999 999999\n255\n" + bytes(9), "it is 999999 x 999999"),
        (b"P5\n20 20\n255\n" + bytes(9), "corrupt"),
        (b"P5" + b" " * 4000 + b"x", "another format"),
        (b"P3\n2 2\n255\n1 2 x", "corrupt"),
        *((png(depth, colour, side), SMALL) for depth, colour, side in ((8, 0, 8193), (8, 2, 8000), (16, 6, 5000))),
    ],
)
def test_broken_or_too_large_images_are_refused_in_silence(
    data: bytes, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match=words):
        decoded(data).grey()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("coding", ["mono16", "rgb16", "bayer_rggb16", "png"])
def test_samples_of_any_depth_use_the_range_of_grey(bits: int, coding: str) -> None:
    grey = np.random.default_rng(3).integers(0, 256, (8, 8), dtype=np.uint8)
    grey[0, 0] = 255
    deep = np.rint(grey.astype(float) * (2**bits - 1) / 255.0).astype(np.uint16)
    said: list[str] = []
    depth = SampleDepth(said.append, "loc")
    if coding == "png":
        data = np.frombuffer(bytes(cv2.imencode(".png", deep)[1]), np.uint8)
        found = samples_of(SimpleNamespace(header=HEADER, format="16UC1; png compressed", data=data))
        shallow = Samples(grey)
    else:
        found = samples_of(message(np.dstack([deep] * 3) if coding == "rgb16" else deep, coding))
        shallow = replace(found, pixels=np.dstack([grey] * 3) if coding == "rgb16" else grey)
    np.testing.assert_allclose(depth.grey(found)[0].astype(int), shallow.grey(), atol=1)
    assert depth.bits == bits
    assert len(said) == (bits < 16)
    assert SampleDepth(said.append, "loc", 16).grey(found)[0].max() <= 2 ** (bits - 8)
    said.clear()
    given = SampleDepth(said.append, "loc", 8)
    for _ in range(2):
        given.grey(found)
    assert len(said) == (bits > 8), "saturated samples are reported once"


def test_the_depth_of_samples_only_grows_and_is_that_of_both_images() -> None:
    depth = SampleDepth(lambda _: None, "loc")
    dark, bright = (Samples(np.full((4, 4), value, np.uint16)) for value in (400, 4000))
    assert [int(image[0, 0]) for image in depth.grey(dark, bright)] == [25, 249]
    assert int(depth.grey(dark)[0][0, 0]) == 25


@pytest.mark.parametrize("coding", ["nv12", "nv21", "nv24"])
def test_the_first_plane_is_the_image(coding: str) -> None:
    pixels = np.random.default_rng(7).integers(0, 256, (6, 8), dtype=np.uint8)
    image = message(pixels, coding)
    image.data = np.append(image.data, np.zeros(24, np.uint8))
    np.testing.assert_array_equal(samples_of(image).grey(), pixels)


CODECS = {
    "H.264": (b"\0\0\0\x01\x67\x42", "h264"),
    "H.265": (b"\0\0\0\x01\x40\x01", "hevc"),
    "WebP": (b"RIFF\x10\0\0\0WEBPVP8 ", "webp"),
    "AVIF": (b"\0\0\0\x1cftypavif", "avif"),
    "JPEG XL": (b"\xff\x0a\xfa\x1f", "jxl"),
    "TIFF": (b"II*\0\x08\0\0\0", "rgb8; tiff compressed bgr8"),
    "Theora": (b"OggS\0\x02", "theora"),
    "no data": (b"", "jpeg"),
    "neither PNG nor JPEG (format 'xyz')": (b"abcdefgh", "xyz"),
}


@pytest.mark.parametrize("name", CODECS)
def test_a_codec_that_is_not_read_is_named(name: str) -> None:
    data, form = CODECS[name]
    packed = SimpleNamespace(header=HEADER, format=form, data=np.frombuffer(data, np.uint8))
    with pytest.raises(InputError, match=f"{re.escape(name)}.*publish raw images, PNG or JPEG"):
        samples_of(packed).grey()


@pytest.mark.parametrize("largest", [4000, 60000])
def test_a_depth_that_grows_is_reported_as_a_change_of_the_brightness(largest: int) -> None:
    reports: list[str] = []
    depth = SampleDepth(lambda text: reports.append(str(text)), "camera")
    for value in (200, largest):
        depth.grey(Samples(np.full((2, 2), value, np.uint16)))
    assert ["brightness changes" in text for text in reports] == [False, True]
