"""Values are equal after conversion to messages and back, and invalid messages are rejected."""

import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CompressedImage, Image, PointCloud2, PointField

from helpers.made_scene import LOC_RIG, loc_pair, true_pose
from helpers.node_scenes import disparity_of, sent
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.image_codec import encode_jpeg, encode_png, samples_of
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.mapping.disparity.semi_global_matching import SearchRange
from sfr_loc_map.mapping.terrain.cells import CellGrid
from sfr_loc_map.mapping.terrain.elevation import ElevationModel
from sfr_loc_map.mapping.terrain.terrain_grid import TerrainGrid
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.ros.grid_messages import (
    ELEVATION_FIELDS,
    elevation_from_msg,
    elevation_msg,
    hazard_from_msg,
    hazard_msg,
)
from sfr_loc_map.ros.image_messages import check_image, disparity_msg
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.ros.point_messages import cloud_from_msg, cloud_msg, xyz_from_msg
from sfr_loc_map.ros.pose_messages import (
    covariance_of,
    odometry_msg,
    odometry_row,
    pose_msg,
    start_pose_of,
    transform_from_pose,
)

STAMP_NS, SIZE = 1_700_000_000_123_456_789, (6, 4)
GREY = np.arange(24, dtype=np.uint8).reshape(4, 6) * 10
PNG = encode_png(GREY)


# ---- disparities


@pytest.mark.parametrize(("smallest", "largest"), [(4.0, 9.0), (1.5, 14.0)])
def test_the_range_of_a_disparity_image_includes_the_searched_range_and_all_its_disparities(
    smallest: float, largest: float
) -> None:
    disparity_px = np.array([[smallest, np.nan], [largest, 5.0]], np.float32)
    message = sent(disparity_msg(disparity_px, LOC_RIG, SearchRange(2.0, 10.0, 16), header_msg(STAMP_NS, "left")))
    assert (message.min_disparity, message.max_disparity) == (min(smallest, 2.0), max(largest, 10.0))
    assert np.array_equal(disparity_of(message), disparity_px, equal_nan=True)


# ---- poses


def test_odometry_holds_the_estimate_to_the_last_bit_and_the_orientation_of_ros() -> None:
    half = math.sqrt(0.5)
    T_ds_rb = Transform.from_quat([1 / 3, -2e-17, 1e9 / 7], [0.0, 0.0, half, half])
    covariance = np.arange(36.0).reshape(6, 6) / 7
    message = sent(odometry_msg(PoseEstimate(STAMP_NS, T_ds_rb, covariance, TrackingState.TRACKING), "world", "rover"))
    assert (message.header.frame_id, message.child_frame_id) == ("world", "rover")
    stamp, position, quat = odometry_row(message)
    assert (stamp, position, quat) == (STAMP_NS, tuple(T_ds_rb.translation), tuple(T_ds_rb.quat_xyzw))
    # A turn to the left by 90 degrees: RB's x axis points along y of DS, so z and w agree in sign.
    assert quat[2] == pytest.approx(half)
    assert Transform.from_quat(position, quat).rotation @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert np.array_equal(covariance_of(message), covariance)
    assert np.array(message.twist.covariance)[0] == 9999.0  # no step is known


def integrated(found: Transform, before: Odometry, message: Odometry) -> Transform:
    """Return a pose moved on by the velocity of a message, as a consumer does that has the messages alone."""
    seconds = (stamp_of(message) - stamp_of(before)) / 1e9
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    turned = seconds * np.array([angular.x, angular.y, angular.z])
    return found @ Transform(matrix_from_rotvec(turned), seconds * np.array([linear.x, linear.y, linear.z]))


def test_the_velocity_integrates_to_the_path() -> None:
    localiser = Localiser(LOC_RIG, LocalisationConfig(), true_pose(0))
    estimates = [localiser.process(loc_pair(index)) for index in (0, 1, 2, 3, 5, 6)]  # unequal intervals
    messages = [sent(odometry_msg(estimate, "ds", "rb")) for estimate in estimates]
    found = estimates[0].T_ds_rb
    for before, message, estimate in zip(messages, messages[1:], estimates[1:], strict=False):
        found = integrated(found, before, message)
        np.testing.assert_allclose(found.matrix, estimate.T_ds_rb.matrix, atol=1e-9)
        step = estimate.step
        np.testing.assert_array_equal(message.twist.covariance, (step.motion_covariance / step.seconds**2).reshape(36))


@given(
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.dot(q, q) > 0.01),
    st.integers(0, 2**31 * 10**9 - 1),
)
def test_poses_and_stamps_come_out_as_they_went_in(quat: list[float], stamp_ns: int) -> None:
    pose = Transform.from_quat([0.1, 0.2, 0.3], np.array(quat) / np.linalg.norm(quat))
    message = Odometry(header=header_msg(stamp_ns, "ds"))
    message.pose.pose = pose_msg(pose, pose.file_quat_xyzw)
    out = transform_from_pose(sent(message).pose.pose, "pose")
    assert np.array_equal(out.matrix, pose.matrix)
    assert stamp_of(sent(message)) == stamp_ns


def test_a_start_pose_has_the_stamp_and_the_covariance_of_its_message() -> None:
    def initial_pose(stamp_ns: int, covariance: np.ndarray) -> PoseWithCovarianceStamped:
        message = PoseWithCovarianceStamped(header=header_msg(stamp_ns, ""))
        message.pose.covariance = covariance.reshape(36)
        return sent(message)

    covariance = np.diag(np.arange(6.0))
    found = start_pose_of(initial_pose(STAMP_NS, covariance))
    assert found.stamp_ns == STAMP_NS
    np.testing.assert_array_equal(found.covariance, covariance)
    assert start_pose_of(initial_pose(0, covariance)).stamp_ns is None
    for broken in (-np.eye(6), np.full((6, 6), np.nan), np.triu(np.ones((6, 6)))):
        with pytest.raises(InputError, match="zeros mean an exact pose"):
            start_pose_of(initial_pose(STAMP_NS, broken))


# ---- images


def image(encoding: str, pixels: np.ndarray, *, padding: int = 0, big: bool = False, **fields: object) -> Image:
    rows = np.frombuffer(pixels.tobytes(), np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    given = {"height": len(pixels), "width": pixels.shape[1], "step": rows.shape[1], "data": rows.tobytes()} | fields
    return Image(header=header_msg(STAMP_NS, "left"), encoding=encoding, is_bigendian=int(big), **given)


def compressed(data: bytes) -> CompressedImage:
    return CompressedImage(header=header_msg(STAMP_NS, "left"), format="png", data=data)


def grey_of(message: Image | CompressedImage) -> np.ndarray:
    received = sent(message)
    check_image(received, SIZE)
    return samples_of(received).grey()


def test_images_of_any_encoding_become_grey() -> None:
    for big in (False, True):
        wide = (GREY.astype(np.uint16) * 257).astype(">u2" if big else "<u2")
        assert np.array_equal(grey_of(image("mono8", GREY, padding=5)), GREY)
        assert np.array_equal(grey_of(image("mono16", wide, padding=5, big=big)), GREY)
    colour = np.random.default_rng(0).integers(0, 256, (4, 6, 3), np.uint8)
    grey = grey_of(image("rgb8", colour))
    assert np.abs(grey - colour @ [0.299, 0.587, 0.114]).max() <= 1.0
    assert np.array_equal(grey_of(image("bgr8", np.ascontiguousarray(colour[..., ::-1]))), grey)
    assert np.array_equal(grey_of(compressed(PNG)), GREY)
    assert np.abs(grey_of(compressed(encode_jpeg(GREY, 100))).astype(int) - GREY).max() <= 8
    assert np.array_equal(grey_of(compressed(cv2.imencode(".png", np.dstack([GREY] * 3))[1].tobytes())), GREY)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (image("yuv411", GREY), "encoding 'yuv411'"),
        (image("yuv422", GREY), "too few"),
        (image("mono8", GREY, step=3), "corrupt"),
        # sizes are compared before anything is decoded or allocated
        (image("mono8", GREY, height=2**31, width=2**31, step=2**31), "2147483648 x 2147483648: its camera_info"),
        (
            compressed(PNG[:16] + (60000).to_bytes(4, "big") * 2 + PNG[24:]),
            "60000 x 60000: its camera_info states 6 x 4",
        ),
        (compressed(b""), "it has no data"),
        (compressed(b"BM" + bytes(100)), "it is BMP"),
        (compressed(PNG[:-20]), "corrupt|truncated"),
    ],
)
def test_broken_images_are_refused(message: Image | CompressedImage, words: str) -> None:
    with pytest.raises(InputError, match=words):
        grey_of(message)


# ---- clouds and grids


def cloud(count: int) -> PointCloud:
    rng = np.random.default_rng(1)
    records = np.zeros(count, PointCloud.dtype())
    for name, kind in FIELD_TYPES.items():
        records[name] = rng.normal(size=count) if kind is np.float32 else rng.integers(0, 200, count)
    return PointCloud.from_structured(records)


@pytest.mark.parametrize(("kind", "code", "order"), [("f4", PointField.FLOAT32, "<"), ("f8", PointField.FLOAT64, ">")])
def test_points_of_any_float_layout_are_read(kind: str, code: int, order: str) -> None:
    values = np.random.default_rng(1).normal(size=(6, 3)).astype(kind)
    size = values.dtype.itemsize
    offsets = {"z": 0, "x": 2 * size, "y": size}
    dtype = {"names": list(offsets), "formats": [order + kind] * 3, "offsets": [*offsets.values()], "itemsize": 40}
    records = np.zeros(6, np.dtype(dtype))
    for axis, name in enumerate("xyz"):
        records[name] = values[:, axis]
    fields = [PointField(name=name, offset=offset, datatype=code, count=1) for name, offset in offsets.items()]
    message = PointCloud2(height=2, width=3, fields=fields, is_bigendian=order == ">", point_step=40, row_step=120)
    message.data = records.tobytes()
    np.testing.assert_array_equal(xyz_from_msg(message), values.astype(np.float64))
    message.fields = fields[:2]
    with pytest.raises(InputError, match="no field 'y' of float32 or float64"):
        xyz_from_msg(message)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: setattr(m, "data", m.data[:-1]), "bytes are required"),
        (lambda m: setattr(m, "height", 2**31), "bytes are required"),
        (lambda m: m.fields.pop(), "no field 'pair' of uint8"),
        (lambda m: setattr(m.fields[0], "offset", 25), "ends after the 28 bytes of a point"),
        (lambda m: setattr(m, "row_step", 1), "bytes are required"),
    ],
)
def test_broken_clouds_are_refused(change: Callable[[PointCloud2], None], words: str) -> None:
    message = cloud_msg(cloud(4), STAMP_NS, "lm")
    change(message)
    with pytest.raises(InputError, match=words):
        cloud_from_msg(message)


def test_grids_come_out_as_they_went_in() -> None:
    layers = np.random.default_rng(2).normal(size=(5, 3, 4)).astype(np.float32)
    layers[:, 1, 2] = np.nan
    count, hazard = np.arange(12, dtype=np.int32).reshape(3, 4), np.arange(-1, 11, dtype=np.int8).reshape(3, 4)
    grid = TerrainGrid(ElevationModel(*layers[:2], count, CellGrid(-2, 5, *count.shape, 0.25)), *layers[2:], hazard)
    message = sent(elevation_msg(grid, 5, "lm"))
    assert [field.name for field in message.fields] == list(ELEVATION_FIELDS)
    assert (message.height, message.width, message.header.frame_id, message.is_dense) == (3, 4, "lm", False)
    found = elevation_from_msg(message)
    np.testing.assert_allclose(found[0, :, 0], -0.375 + 0.25 * np.arange(4), atol=1e-6)
    np.testing.assert_allclose(found[:, 0, 1], 1.375 + 0.25 * np.arange(3), atol=1e-6)
    assert np.array_equal(found[..., 2:7], np.moveaxis(layers, 0, -1), equal_nan=True)
    assert np.array_equal(found[..., 7], count)
    message = sent(hazard_msg(grid, 5, "lm"))
    info = message.info
    assert (info.height, info.width, info.resolution) == (3, 4, 0.25)
    assert (info.origin.position.x, info.origin.position.y) == (-0.5, 1.25)
    assert np.array_equal(hazard_from_msg(message), np.where(hazard < 0, np.nan, hazard), equal_nan=True)
