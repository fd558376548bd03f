# ruff: noqa: E402 - ROS may be absent
import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from scenes import disparity_of, sent
from sensor_msgs.msg import CompressedImage, Image

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.image_codec import encode_jpeg, encode_png
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.image import disparity_msg, grey_from_image

STAMP_NS = 1_700_000_000_123_456_789

RIG = StereoRig(6, 4, 10.0, 10.0, 2.5, 1.5, 0.1)


def image(encoding: str, data: np.ndarray, *, step: int | None = None, big: bool = False) -> Image:
    height, width = data.shape[:2]
    row = data.itemsize * (data.size // height)
    rows = np.zeros((height, step or row), np.uint8)
    rows[:, :row] = np.frombuffer(data.tobytes(), np.uint8).reshape(height, row)
    message = Image(height=height, width=width, encoding=encoding, step=step or row, is_bigendian=int(big))
    message.header = header_msg(STAMP_NS, "left")
    message.data = rows.tobytes()
    return sent(message)


GREY = np.arange(24, dtype=np.uint8).reshape(4, 6) * 10


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("padding", [0, 5])
def test_raw_images_become_grey(big: bool, padding: int) -> None:
    grey = grey_from_image(image("mono8", GREY, step=6 + padding), (6, 4))
    assert np.array_equal(grey, GREY)
    wide = (GREY.astype(np.uint16) * 257).astype(">u2" if big else "<u2")
    assert np.array_equal(grey_from_image(image("mono16", wide, step=12 + padding, big=big), (6, 4)), GREY)


def test_colour_images_become_luma() -> None:
    colour = np.random.default_rng(0).integers(0, 256, (4, 6, 3), np.uint8)
    expected = colour @ [0.299, 0.587, 0.114]
    grey = grey_from_image(image("rgb8", colour), (6, 4))
    assert np.abs(grey - expected).max() <= 1.0
    assert np.array_equal(grey_from_image(image("bgr8", np.ascontiguousarray(colour[..., ::-1])), (6, 4)), grey)


def compressed(data: bytes) -> CompressedImage:
    return sent(CompressedImage(header=header_msg(STAMP_NS, "left"), format="png", data=data))


def test_compressed_images_become_grey() -> None:
    assert np.array_equal(grey_from_image(compressed(encode_png(GREY)), (6, 4)), GREY)
    jpeg = grey_from_image(compressed(encode_jpeg(GREY, 100)), (6, 4))
    assert np.abs(jpeg.astype(int) - GREY).max() <= 8
    colour = cv2.imencode(".png", np.dstack([GREY] * 3))[1].tobytes()
    assert np.array_equal(grey_from_image(compressed(colour), (6, 4)), GREY)


def test_sizes_are_compared_before_anything_is_decoded_or_allocated() -> None:
    huge = Image(header=header_msg(STAMP_NS, ""), height=2**31, width=2**31, encoding="mono8", step=2**31)
    with pytest.raises(InputError, match=r"2147483648 x 2147483648: its camera_info says 6 x 4"):
        grey_from_image(sent(huge), (6, 4))
    bomb = bytearray(encode_png(GREY))
    bomb[16:24] = (60000).to_bytes(4, "big") * 2
    with pytest.raises(InputError, match=r"60000 x 60000: its camera_info says 6 x 4"):
        grey_from_image(compressed(bytes(bomb)), (6, 4))


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (lambda: image("nv21", GREY), "encoding 'nv21'"),
        (lambda: image("yuv422", GREY), "too few"),
        (
            lambda: Image(header=header_msg(1, ""), height=4, width=6, encoding="mono8", step=6, data=b"123"),
            "too few",
        ),
        (
            lambda: Image(header=header_msg(1, ""), height=4, width=6, encoding="mono8", step=3, data=bytes(24)),
            "broken",
        ),
        (lambda: compressed(b""), "not PNG or JPEG"),
        (lambda: compressed(b"\xff\xd8\xff\xe0" + bytes(40)), "not PNG or JPEG"),
        (lambda: compressed(b"BM" + bytes(100)), "not PNG or JPEG"),
        (lambda: compressed(encode_png(GREY)[:-20]), "broken"),
    ],
)
def test_broken_images_are_refused(message, words: str) -> None:  # noqa: ANN001
    with pytest.raises(InputError, match=words):
        grey_from_image(message(), (6, 4))


def test_disparity_comes_out_as_it_went_in_and_follows_the_definition_of_its_message() -> None:
    disparity = np.array([[0.25, 3.5, np.nan], [7.125, np.nan, 1.0]], np.float32)
    message = sent(disparity_msg(disparity, RIG, (0.3, 8.0), header_msg(STAMP_NS, "left")))
    assert (message.f, message.t, message.image.encoding) == (10.0, pytest.approx(0.1), "32FC1")
    sent_px = np.frombuffer(message.image.data, "<f4").reshape(2, 3)
    # stereo_msgs/DisparityImage: any disparity less than min_disparity is invalid.
    assert np.array_equal(sent_px < message.min_disparity, np.isnan(disparity))
    assert np.array_equal(disparity_of(message), disparity, equal_nan=True)
    nothing = disparity_msg(np.full((2, 3), np.nan, np.float32), RIG, (0.3, 8.0), header_msg(1, ""))
    assert np.isnan(disparity_of(sent(nothing))).all()
