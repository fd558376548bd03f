# ruff: noqa: E402 - ROS may be absent
import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from geometry_msgs.msg import Point, Pose, Quaternion
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, Image, PointCloud2

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.image_codec import encode_jpeg, encode_png, stamp_of
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.nodes.messages import conversions as c

STAMP_NS = 1_700_000_000_123_456_789
RIG = StereoRig(6, 4, 10.0, 10.0, 2.5, 1.5, 0.1)


def sent(message):  # noqa: ANN001, ANN201
    """The message as it arrives: through its serialised form."""
    return deserialize_message(serialize_message(message), type(message))


def image(encoding: str, data: np.ndarray, *, step: int | None = None, big: bool = False) -> Image:
    height, width = data.shape[:2]
    row = data.itemsize * (data.size // height)
    rows = np.zeros((height, step or row), np.uint8)
    rows[:, :row] = np.frombuffer(data.tobytes(), np.uint8).reshape(height, row)
    message = Image(height=height, width=width, encoding=encoding, step=step or row, is_bigendian=int(big))
    message.header = c.header_msg(STAMP_NS, "left")
    message.data = rows.tobytes()
    return sent(message)


@settings(deadline=None)  # the first call loads the type support
@given(st.integers(0, 2**31 * 10**9 - 1))
def test_stamps_are_exact(stamp_ns: int) -> None:
    assert stamp_of(sent(Odometry(header=c.header_msg(stamp_ns, "ds")))) == stamp_ns


def test_odometry_holds_the_estimate_to_the_last_bit_and_the_orientation_of_ros() -> None:
    half = math.sqrt(0.5)
    T_ds_rb = Transform.from_quat([1 / 3, -2e-17, 1e9 / 7], [0.0, 0.0, half, half])
    covariance = np.arange(36.0).reshape(6, 6) / 7
    message = sent(
        c.odometry_msg(PoseEstimate(STAMP_NS, T_ds_rb, covariance, TrackingState.TRACKING), "world", "rover")
    )
    assert (message.header.frame_id, message.child_frame_id) == ("world", "rover")
    stamp, position, quat = c.odometry_row(message)
    assert stamp == STAMP_NS
    assert position == tuple(T_ds_rb.translation)
    assert quat == tuple(T_ds_rb.quat_xyzw)
    # A turn to the left by 90 degrees: RB's x axis points along y of DS, so z and w agree in sign.
    assert quat[2] == pytest.approx(half)
    assert Transform.from_quat(position, quat).rotation @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert np.array_equal(np.array(message.pose.covariance).reshape(6, 6), covariance)
    assert np.array(message.twist.covariance)[0] == 9999.0


def test_every_field_is_of_its_own_type_whatever_numpy_gives() -> None:
    pose = Transform(np.eye(3), np.array([1, 2, 3]))
    message = c.pose_msg(pose, np.array([0, 0, 0, 1], np.float32))
    assert type(message.position.x) is float
    assert sent(message) == Pose(position=Point(x=1.0, y=2.0, z=3.0), orientation=Quaternion(w=1.0))


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (Pose(position=Point(x=math.nan)), "not finite"),
        (Pose(orientation=Quaternion(x=math.inf, w=1.0)), "not finite"),
        (Pose(orientation=Quaternion(w=0.0)), "length 0"),
        (Pose(orientation=Quaternion(w=2.0)), "length 2"),
    ],
)
def test_poses_that_are_none_are_refused(pose: Pose, words: str) -> None:
    with pytest.raises(InputError, match=f"initialpose has .*{words}"):
        c.transform_from_pose(pose, "initialpose")


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.dot(q, q) > 0.01))
def test_poses_come_out_as_they_went_in(quat: list[float]) -> None:
    unit = np.array(quat) / np.linalg.norm(quat)
    pose = Transform.from_quat([0.1, 0.2, 0.3], unit)
    out = c.transform_from_pose(sent(c.pose_msg(pose, pose.file_quat_xyzw)), "pose")
    assert np.array_equal(out.rotation, pose.rotation)
    assert np.array_equal(out.translation, pose.translation)


GREY = np.arange(24, dtype=np.uint8).reshape(4, 6) * 10


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("padding", [0, 5])
def test_raw_images_become_grey(big: bool, padding: int) -> None:
    grey = c.grey_from_image(image("mono8", GREY, step=6 + padding), (6, 4))
    assert np.array_equal(grey, GREY)
    wide = (GREY.astype(np.uint16) * 257).astype(">u2" if big else "<u2")
    assert np.array_equal(c.grey_from_image(image("mono16", wide, step=12 + padding, big=big), (6, 4)), GREY)


def test_colour_images_become_luma() -> None:
    colour = np.random.default_rng(0).integers(0, 256, (4, 6, 3), np.uint8)
    expected = colour @ [0.299, 0.587, 0.114]
    grey = c.grey_from_image(image("rgb8", colour), (6, 4))
    assert np.abs(grey - expected).max() <= 1.0
    assert np.array_equal(c.grey_from_image(image("bgr8", np.ascontiguousarray(colour[..., ::-1])), (6, 4)), grey)


def compressed(data: bytes) -> CompressedImage:
    return sent(CompressedImage(header=c.header_msg(STAMP_NS, "left"), format="png", data=data))


def test_compressed_images_become_grey() -> None:
    assert np.array_equal(c.grey_from_image(compressed(encode_png(GREY)), (6, 4)), GREY)
    jpeg = c.grey_from_image(compressed(encode_jpeg(GREY, 100)), (6, 4))
    assert np.abs(jpeg.astype(int) - GREY).max() <= 8
    colour = cv2.imencode(".png", np.dstack([GREY] * 3))[1].tobytes()
    assert np.array_equal(c.grey_from_image(compressed(colour), (6, 4)), GREY)


def test_sizes_are_compared_before_anything_is_decoded_or_allocated() -> None:
    huge = Image(header=c.header_msg(STAMP_NS, ""), height=2**31, width=2**31, encoding="mono8", step=2**31)
    with pytest.raises(InputError, match=r"2147483648 x 2147483648: its camera_info says 6 x 4"):
        c.grey_from_image(sent(huge), (6, 4))
    bomb = bytearray(encode_png(GREY))
    bomb[16:24] = (60000).to_bytes(4, "big") * 2
    with pytest.raises(InputError, match=r"60000 x 60000: its camera_info says 6 x 4"):
        c.grey_from_image(compressed(bytes(bomb)), (6, 4))


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (lambda: image("yuv422", GREY), "encoding 'yuv422'"),
        (lambda: image("bayer_rggb8", GREY), "encoding 'bayer_rggb8'"),
        (
            lambda: Image(header=c.header_msg(1, ""), height=4, width=6, encoding="mono8", step=6, data=b"123"),
            "too few",
        ),
        (
            lambda: Image(header=c.header_msg(1, ""), height=4, width=6, encoding="mono8", step=3, data=bytes(24)),
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
        c.grey_from_image(message(), (6, 4))


def cloud(count: int) -> PointCloud:
    rng = np.random.default_rng(1)
    records = np.zeros(count, PointCloud.dtype())
    for name, kind in FIELD_TYPES.items():
        records[name] = rng.normal(size=count) if kind is np.float32 else rng.integers(0, 200, count)
    return PointCloud.from_structured(records)


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_clouds_come_out_as_they_went_in(count: int) -> None:
    made = cloud(count)
    message = sent(c.cloud_msg(made, STAMP_NS, "lm"))
    names = [(field.name, field.datatype) for field in message.fields]
    assert names == [(n, 7) for n in ("x", "y", "z", "sigma", "intensity")] + [("u", 4), ("v", 4), ("pair", 2)]
    assert (message.header.frame_id, message.height, message.width, message.is_dense) == ("lm", 1, count, True)
    assert (message.point_step, message.row_step) == (25, 25 * count)
    assert np.array_equal(c.cloud_from_msg(message).to_structured(), made.to_structured())


def test_clouds_of_other_layouts_are_read() -> None:
    made = cloud(5)
    message = c.cloud_msg(made, STAMP_NS, "lm")
    old = np.frombuffer(message.data, PointCloud.dtype())
    names, offsets = old.dtype.names, [32, 28, 24, 20, 16, 8, 4, 0]
    formats = [old.dtype[name].newbyteorder(">") for name in names]
    wide = np.zeros(6, np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": 40}))
    for name in names:
        wide[name][:5] = old[name]
    for field, offset in zip(message.fields, offsets, strict=True):
        field.offset = offset
    message.is_bigendian, message.point_step, message.row_step, message.data = True, 40, 240, wide.tobytes()
    assert np.array_equal(c.cloud_from_msg(sent(message)).to_structured(), made.to_structured())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: setattr(m, "data", m.data[:-1]), "too few"),
        (lambda m: setattr(m, "width", 2**31), "too few"),
        (lambda m: setattr(m, "height", 2**31), "too few"),
        (lambda m: m.fields.pop(), "no field 'pair' of uint8"),
        (lambda m: setattr(m.fields[0], "datatype", 8), "no field 'x' of float32"),
        (lambda m: setattr(m.fields[0], "offset", 22), "beyond the point's 25 bytes"),
        (lambda m: setattr(m, "row_step", 1), "too few"),
    ],
)
def test_broken_clouds_are_refused(change, words: str) -> None:  # noqa: ANN001
    message: PointCloud2 = c.cloud_msg(cloud(4), STAMP_NS, "lm")
    change(message)
    with pytest.raises(InputError, match=words):
        c.cloud_from_msg(message)


def test_disparity_comes_out_as_it_went_in_and_follows_the_definition_of_its_message() -> None:
    disparity = np.array([[0.25, 3.5, np.nan], [7.125, np.nan, 1.0]], np.float32)
    message = sent(c.disparity_msg(disparity, RIG, (0.3, 8.0), c.header_msg(STAMP_NS, "left")))
    assert (message.f, message.t, message.image.encoding) == (10.0, pytest.approx(0.1), "32FC1")
    sent_px = np.frombuffer(message.image.data, "<f4").reshape(2, 3)
    # stereo_msgs/DisparityImage: any disparity less than min_disparity is invalid.
    assert np.array_equal(sent_px < message.min_disparity, np.isnan(disparity))
    assert np.array_equal(c.disparity_from_msg(message), disparity, equal_nan=True)
    nothing = c.disparity_msg(np.full((2, 3), np.nan, np.float32), RIG, (0.3, 8.0), c.header_msg(1, ""))
    assert np.isnan(c.disparity_from_msg(sent(nothing))).all()
    message.image.width = 4
    with pytest.raises(InputError, match="32FC1"):
        c.disparity_from_msg(message)
