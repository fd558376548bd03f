"""Results of an external node are only its answers to pairs of the replay."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2

from helpers.made_scene import NAV_RIG
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.message_stamps import NS_PER_S, stamp_of
from sfr_loc_map.methods.method_call import MethodFailureError
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention, converted
from sfr_loc_map.metrics.figures.records import FindingKind, FindingRecord
from sfr_loc_map.replay.external.answer_converters import CloudConverter, PoseConverter
from sfr_loc_map.replay.external.external_node import ExternalNode
from sfr_loc_map.replay.message_store import ExternalMaps, ReceivedDrive
from sfr_loc_map.replay.options import ExternalOptions
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.ros.point_messages import cloud_from_msg, cloud_msg
from sfr_loc_map.ros.pose_messages import pose_msg
from sfr_loc_map.suite_names import Task


class Kept:
    """A converter that keeps the stamps of the accepted answers."""

    kind = Odometry

    def __init__(self) -> None:
        self.accepted_ns: list[int] = []

    def frames_of(self, message: Odometry) -> str:
        """Return the frames of any message."""
        return f"{message.header.frame_id} -> {message.child_frame_id}"

    def read(self, message: Odometry) -> None:
        """Read any message."""

    def accept(self, message: Odometry, content: None) -> None:
        """Keep the stamp."""
        self.accepted_ns.append(stamp_of(message))


def test_answers_whose_stamp_is_of_no_pair_are_not_used() -> None:
    kept, of_pair, of_next = Kept(), NS_PER_S, 2 * NS_PER_S
    graph = SimpleNamespace(get_publishers_info_by_topic=lambda topic: [])
    peer = cast("Any", SimpleNamespace(ros_node=graph))
    node = ExternalNode(peer, ExternalOptions(Task.LOCALISATION, "poses"), None, kept, name="n", watch=None)

    def answer(stamp_ns: int) -> None:
        node.receive(Odometry(header=header_msg(stamp_ns, "ds"), child_frame_id="rb"))

    node.note_sent(of_pair, time.monotonic())
    for number in range(100):
        answer(of_pair + number)
    answer(of_next)
    assert kept.accepted_ns == [of_pair], "the other answers are to no published pair"
    node.note_sent(of_next, time.monotonic())
    assert kept.accepted_ns == [of_pair, of_next]


def test_a_process_to_watch_that_does_not_publish_the_answers_is_reported_at_the_first_check() -> None:
    other = SimpleNamespace(endpoint_gid=[3] * 16)
    publishers: list[Any] = []
    graph = SimpleNamespace(get_publishers_info_by_topic=lambda topic: publishers)
    watch = SimpleNamespace(has_publishers=lambda ids: not ids)
    peer = cast("Any", SimpleNamespace(ros_node=graph))
    options = ExternalOptions(Task.LOCALISATION, "poses", watch="vo_node")
    node = ExternalNode(peer, options, None, Kept(), name="n", watch=cast("Any", watch))
    node.receive(Odometry(header=header_msg(NS_PER_S, "ds"), child_frame_id="rb"))
    publishers.append(other)
    with pytest.raises(ConfigError, match="'--watch vo_node': the publisher of poses belongs to another process"):
        node.check()


@pytest.mark.parametrize("setting", ["inverse_motion=true", "inverse=true", "mirrored=true", "frame=rb_optical"])
def test_a_pose_is_published_as_by_the_conversion_of_all_poses(setting: str) -> None:
    published: list[Odometry] = []
    publisher = SimpleNamespace(publish=published.append)
    peer = cast("Any", SimpleNamespace(ros_node=SimpleNamespace(create_publisher=lambda *_: publisher)))
    convention = PoseConvention.parse([setting])
    options = ExternalOptions(Task.LOCALISATION, "poses", convention=convention)
    loc = cast("Any", SimpleNamespace(rig=None, ground_truth=None))
    converter = PoseConverter(peer, options, ReceivedDrive(), loc)
    rng = np.random.default_rng(2)
    quats = Rotation.random(4, random_state=1).as_quat()
    poses = Trajectory(np.arange(4) * NS_PER_S, rng.normal(0.0, 3.0, (4, 3)), quats)
    for row, (stamp_ns, pose) in enumerate(poses):
        message = Odometry(header=header_msg(stamp_ns, "ds"), child_frame_id="rb")
        message.pose.pose = pose_msg(pose, quats[row])
        converter.accept(message, converter.read(message))
    wanted = converted(poses, convention, convention.T_rb_child(None))
    found = [message.pose.pose.position for message in published]
    np.testing.assert_allclose([(at.x, at.y, at.z) for at in found], wanted.positions, atol=1e-12)
    turns = [message.pose.pose.orientation for message in published]
    np.testing.assert_allclose([(q.x, q.y, q.z, q.w) for q in turns], wanted.quats_xyzw, atol=1e-12)


@pytest.mark.parametrize("is_organised", [False, True])
def test_a_cloud_is_converted_to_metres_and_published_without_points_that_are_not_finite(is_organised: bool) -> None:
    published: list[Any] = []
    publisher = SimpleNamespace(publish=published.append)
    peer = cast("Any", SimpleNamespace(ros_node=SimpleNamespace(create_publisher=lambda *_: publisher)))
    options = ExternalOptions(Task.MAPPING, "points", convention=PoseConvention(metres_per_unit=0.001))
    received, nav = ExternalMaps(), cast("Any", SimpleNamespace(rig=NAV_RIG, pairs=list, stamps_ns=[1]))
    converter = CloudConverter(peer, options, received, nav)
    records = np.zeros(4, PointCloud.dtype())
    records["x"] = 1000.0, np.nan, 2000.0, 3000.0
    records["sigma"] = 10.0
    message = cloud_msg(PointCloud.from_structured(records), 1, "lm")
    if is_organised:
        message.height, message.width, message.row_step = 2, 2, message.row_step // 2
    converter.accept(message, converter.read(message))
    ((_, points, cloud),) = received.clouds
    assert cloud is not None
    assert len(points) == len(cloud) == (3 if is_organised else 4)
    assert np.isnan(points).any() == (not is_organised)
    found = cloud_from_msg(published[0])
    np.testing.assert_allclose(found.xyz[:, 0], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(found.sigma, 0.01)
    np.testing.assert_array_equal(cloud.sigma[-3:], found.sigma)


@pytest.mark.parametrize(("field", "value"), [("u", 60000), ("v", NAV_RIG.height), ("pair", 2)])
def test_a_cloud_with_a_pixel_or_pair_that_does_not_exist_is_a_finding(field: str, value: int) -> None:
    records = np.zeros(4, PointCloud.dtype())
    records[field][2] = value
    message = cloud_msg(PointCloud.from_structured(records), 1, "lm")
    received = ExternalMaps()
    (finding,) = findings_of_cloud(message, received)
    assert (finding.kind, finding.count, received.clouds) == (FindingKind.INVALID_RESULT, 1, [])


def test_a_cloud_of_another_layout_is_an_invalid_result() -> None:
    message = cloud_msg(PointCloud.from_structured(np.zeros(4, PointCloud.dtype())), 1, "lm")
    message.row_step += 1
    message.data = message.data[:-3]
    (finding,) = findings_of_cloud(message, ExternalMaps())
    assert finding.kind is FindingKind.INVALID_RESULT


def findings_of_cloud(message: PointCloud2, received: ExternalMaps) -> tuple[FindingRecord, ...]:
    """Return the findings on a mapper that answers the only published of two pairs by a cloud."""
    graph = SimpleNamespace(get_publishers_info_by_topic=lambda topic: [], create_publisher=lambda *_: None)
    peer = cast("Any", SimpleNamespace(ros_node=graph))
    options = ExternalOptions(Task.MAPPING, "points")
    nav = cast("Any", SimpleNamespace(rig=NAV_RIG, pairs=list, stamps_ns=[1, 2]))
    node = ExternalNode(peer, options, None, CloudConverter(peer, options, received, nav), name="n", watch=None)
    node.note_sent(1, time.monotonic())
    node.receive(message)
    return tuple(item for item in node.result(None).findings if item.kind is not FindingKind.MISSING)


@pytest.mark.parametrize(("w", "kind"), [(np.nan, FindingKind.NOT_FINITE), (0.0, FindingKind.INVALID_RESULT)])
def test_an_invalid_pose_is_a_finding_of_its_kind(w: float, kind: FindingKind) -> None:
    peer = cast("Any", SimpleNamespace(ros_node=SimpleNamespace(create_publisher=lambda *_: None)))
    loc = cast("Any", SimpleNamespace(rig=None, ground_truth=None))
    converter = PoseConverter(peer, ExternalOptions(Task.LOCALISATION, "poses"), ReceivedDrive(), loc)
    message = Odometry(header=header_msg(1, "ds"), child_frame_id="rb")
    message.pose.pose.orientation.w = w
    with pytest.raises(MethodFailureError) as raised:
        converter.read(message)
    assert raised.value.kind is kind


def test_a_cloud_with_the_stamp_of_no_pair_has_a_wrong_stamp() -> None:
    graph = SimpleNamespace(get_publishers_info_by_topic=lambda topic: [], create_publisher=lambda *_: None)
    peer = cast("Any", SimpleNamespace(ros_node=graph))
    options = ExternalOptions(Task.MAPPING, "points", convention=PoseConvention(frame="left_optical"))
    nav = cast("Any", SimpleNamespace(rig=NAV_RIG, pairs=list, stamps_ns=[1]))
    converter = CloudConverter(peer, options, ExternalMaps(), nav)
    node = ExternalNode(peer, options, None, converter, name="n", watch=None)
    node.receive(cloud_msg(PointCloud.from_structured(np.zeros(4, PointCloud.dtype())), 1, "lm"))
    ((kind, count),) = [(finding.kind, finding.count) for finding in node.result(None).findings]
    assert (kind, count) == (FindingKind.WRONG_STAMP, 1)
