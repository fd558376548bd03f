import cv2
import numpy as np
import pytest
from scenes import disparity_of, sent
from sensor_msgs.msg import CompressedImage, Image

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.image_codec import encode_jpeg, encode_png
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.image import disparity_msg, grey_from_image

STAMP_NS, SIZE = 1_700_000_000_123_456_789, (6, 4)
GREY = np.arange(24, dtype=np.uint8).reshape(4, 6) * 10
PNG = encode_png(GREY)


def image(encoding: str, pixels: np.ndarray, *, padding: int = 0, big: bool = False, **fields: object) -> Image:
    rows = np.frombuffer(pixels.tobytes(), np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    given = {
        "height": pixels.shape[0],
        "width": pixels.shape[1],
        "step": rows.shape[1],
        "data": rows.tobytes(),
    } | fields
    return Image(header=header_msg(STAMP_NS, "left"), encoding=encoding, is_bigendian=int(big), **given)


def compressed(data: bytes) -> CompressedImage:
    return CompressedImage(header=header_msg(STAMP_NS, "left"), format="png", data=data)


def grey_of(message: Image | CompressedImage) -> np.ndarray:
    return grey_from_image(sent(message), SIZE)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("padding", [0, 5])
def test_raw_images_become_grey(big: bool, padding: int) -> None:
    assert np.array_equal(grey_of(image("mono8", GREY, padding=padding)), GREY)
    wide = (GREY.astype(np.uint16) * 257).astype(">u2" if big else "<u2")
    assert np.array_equal(grey_of(image("mono16", wide, padding=padding, big=big)), GREY)


def test_colour_images_become_luma() -> None:
    colour = np.random.default_rng(0).integers(0, 256, (4, 6, 3), np.uint8)
    grey = grey_of(image("rgb8", colour))
    assert np.abs(grey - colour @ [0.299, 0.587, 0.114]).max() <= 1.0
    assert np.array_equal(grey_of(image("bgr8", np.ascontiguousarray(colour[..., ::-1]))), grey)


def test_compressed_images_become_grey() -> None:
    assert np.array_equal(grey_of(compressed(PNG)), GREY)
    assert np.abs(grey_of(compressed(encode_jpeg(GREY, 100))).astype(int) - GREY).max() <= 8
    colour = cv2.imencode(".png", np.dstack([GREY] * 3))[1].tobytes()
    assert np.array_equal(grey_of(compressed(colour)), GREY)


BROKEN = [
    (image("nv21", GREY), "encoding 'nv21'"),
    (image("yuv422", GREY), "too few"),
    (image("mono8", GREY, data=b"123"), "too few"),
    (image("mono8", GREY, step=3), "broken"),
    # sizes are compared before anything is decoded or allocated
    (image("mono8", GREY, height=2**31, width=2**31, step=2**31), "2147483648 x 2147483648: its camera_info"),
    (compressed(PNG[:16] + (60000).to_bytes(4, "big") * 2 + PNG[24:]), "60000 x 60000: its camera_info says 6 x 4"),
    (compressed(b""), "not PNG or JPEG"),
    (compressed(b"\xff\xd8\xff\xe0" + bytes(40)), "not PNG or JPEG"),
    (compressed(b"BM" + bytes(100)), "not PNG or JPEG"),
    (compressed(PNG[:-20]), "broken"),
]


@pytest.mark.parametrize(("message", "words"), BROKEN)
def test_broken_images_are_refused(message: Image | CompressedImage, words: str) -> None:
    with pytest.raises(InputError, match=words):
        grey_of(message)


def test_disparity_comes_out_as_it_went_in_and_follows_the_definition_of_its_message() -> None:
    rig = StereoRig(6, 4, 10.0, 10.0, 2.5, 1.5, 0.1)
    for disparity in (np.array([[0.25, 3.5, np.nan], [7.125, np.nan, 1.0]]), np.full((2, 3), np.nan)):
        disparity = disparity.astype(np.float32)
        message = sent(disparity_msg(disparity, rig, (0.3, 8.0), header_msg(STAMP_NS, "left")))
        assert (message.f, message.t, message.image.encoding) == (10.0, pytest.approx(0.1), "32FC1")
        # stereo_msgs/DisparityImage: any disparity less than min_disparity is invalid
        assert np.array_equal(disparity_of(message), disparity, equal_nan=True)
