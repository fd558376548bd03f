"""ROS messages with hostile fields, through converters and sessions as the nodes use them, without any transport."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from execution import Target
from message_mutations import hostile_fields
from rclpy.serialization import deserialize_message
from targets import check_estimate

from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io import bag_messages
from sfr_loc_map.io.bag import TYPESTORE
from sfr_loc_map.io.image_codec import points_image
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.nodes.diagnostics import task_record
from sfr_loc_map.nodes.messages.point_cloud import cloud_from_msg
from sfr_loc_map.nodes.messages.pose import covariance_of, odometry_msg, odometry_row, transform_from_pose
from sfr_loc_map.nodes.stereo_input import ReceivedPair, StereoInput, StereoInputConfig
from sfr_loc_map.pipeline.localisation_session import LocalisationSession
from sfr_loc_map.pipeline.mapping_session import MappingSession
from sfr_loc_map.pipeline.monitor_score import MonitorScore
from sfr_loc_map.pipeline.reception import MessageTimes

from made_scene import LOC_RIG, NAV_RIG, PERIOD_NS, START_NS, T_RB_LOCSB, loc_pair, nav_pair, true_pose  # isort: skip


def _serialised(message: Any) -> bytes:
    return bytes(TYPESTORE.serialize_cdr(message, message.__msgtype__))


def _of_ros(raw: bytes, msgtype: str) -> Any:
    package, _, name = msgtype.split("/")
    return deserialize_message(raw, getattr(import_module(f"{package}.msg"), name))


def _sent(message: Any) -> Any:
    return _of_ros(_serialised(message), message.__msgtype__)


def make_messages(world: Path) -> None:
    """Write the valid messages into a world."""
    pair, nav = loc_pair(1), nav_pair(0)
    values = {"task": "localisation", "stamp_ns": str(pair.stamp_ns), "state": "tracking", "processing_time_s": "0.1"}
    values |= {"peak_rss_bytes": "100000000", "above_idle_bytes": "1000000"}
    entry, status, array = (
        TYPESTORE.types[f"diagnostic_msgs/msg/{name}"] for name in ("KeyValue", "DiagnosticStatus", "DiagnosticArray")
    )
    entries = [entry(key, value) for key, value in values.items()]
    folder = world / "messages"
    folder.mkdir(exist_ok=True)
    for message in (
        bag_messages.image(pair.stamp_ns, pair.left, "loc", "left"),
        bag_messages.jpeg_image(pair.stamp_ns, pair.left, "loc", "left", 90),
        bag_messages.camera_info(pair.stamp_ns, LOC_RIG, "loc", "left"),
        bag_messages.pose(pair.stamp_ns, nav.T_lm_navsb),
        bag_messages.odometry(pair.stamp_ns, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])),
        bag_messages.points(nav.pair.stamp_ns, nav.truth, None),
        array(bag_messages.header(pair.stamp_ns, ""), [status(0, "localisation_node: call", "", "", entries)]),
    ):
        (folder / f"{message.__msgtype__.split('/')[2]}.cdr").write_bytes(_serialised(message))


class _Rover:
    """The part of a localisation node behind its subscriptions."""

    def __init__(self) -> None:
        self.localisation = LocalisationSession(LocalisationConfig())
        self.problems: list[str] = []
        restart, report = self.localisation.restart, self.problems.append
        on_rig = self.localisation.set_rig
        self.stereo = StereoInput("loc", StereoInputConfig(), self.on_pair, on_rig, restart, report)
        self.farthest_m = 1e6

    def on_pair(self, received: ReceivedPair) -> None:
        try:
            pair = received.decode()
            estimate = self.localisation.localiser_at(pair.stamp_ns, T_RB_LOCSB).process(pair)
        except SfrError as error:
            self.problems.append(str(error))
            return
        self.localisation.accept(estimate)
        odometry_msg(estimate, "ds", "rb")
        check_estimate(estimate, self.farthest_m)

    def drive(self, infos: tuple[Any, ...] | None = None, image: Any = None) -> None:
        """Send two good pairs, with other camera_info or another image among them."""
        good = tuple(_sent(bag_messages.camera_info(0, LOC_RIG, "loc", side)) for side in SIDES)
        times = MessageTimes.of({"source_timestamp": START_NS, "received_timestamp": START_NS})
        for index in range(3):
            pair, other = loc_pair(index), index == 1
            for side, info in zip(SIDES, infos if infos and other else good, strict=True):
                self.stereo.add_camera_info(side, info)
            for side, data in (("left", pair.left), ("right", pair.right)):
                message = image if image and other else _sent(bag_messages.image(pair.stamp_ns, data, "loc", side))
                self.stereo.add_image(side, (message, times))


def take_image(message: Any) -> None:
    _Rover().drive(image=message)


def take_camera_info(info: Any) -> None:
    right = _sent(bag_messages.camera_info(0, LOC_RIG, "loc", "right"))
    _Rover().drive(infos=(info, right))
    right.p[:] = info.p
    right.p[3] -= abs(float(right.p[0])) * 0.12 if np.isfinite(right.p).all() else 0.0
    _Rover().drive(infos=(info, right))


def take_pose(message: Any) -> None:
    pose = transform_from_pose(message.pose, "nav/pose")
    session, pair = MappingSession(MappingConfig()), nav_pair(0).pair
    session.set_rig(NAV_RIG)
    result = session.map_pair(pair, pose)
    session.map_pair(StereoPair(START_NS + PERIOD_NS, pair.left, pair.right), Transform.identity())
    if not np.isfinite(result.cloud.xyz).all():
        raise ArithmeticError("points that are not finite")
    session.fuse()
    rover = _Rover()
    rover.farthest_m = 1.1e9  # the start may be anywhere
    rover.localisation.set_pose(StartPose(pose))
    rover.drive()


def take_odometry(message: Any) -> None:
    score = MonitorScore(ScoreConfig(), None)
    rows = [(START_NS + index * PERIOD_NS, true_pose(index)) for index in range(4)]
    for stamp, pose in rows:
        values = tuple(pose.translation.tolist()), tuple(pose.quat_xyzw.tolist())
        score.add_truth(stamp, *values)
        score.add_estimate(stamp, *values, np.eye(6) * 1e-4)
    stamp, position, quat = odometry_row(message)
    for kind in ("estimate", "truth"):
        if score.jumped_back(kind, stamp):
            score.restart()
    score.add_truth(stamp, position, quat)
    score.add_estimate(stamp, position, quat, covariance_of(message))
    score.result()


def take_cloud(message: Any) -> None:
    for read in (partial(points_image, size=(NAV_RIG.width, NAV_RIG.height)), cloud_from_msg):
        with suppress(SfrError):  # a cloud of an image is none of points with their uncertainty
            read(message)


def take_calls(message: Any) -> None:
    score = MonitorScore(ScoreConfig(), None)
    for status in message.status:
        if (found := task_record(status)) is not None:
            score.add_call(found.record)
            score.score_maps()
    score.result()


READERS: dict[str, Callable[[Any], None]] = {
    "sensor_msgs/msg/Image": take_image,
    "sensor_msgs/msg/CompressedImage": take_image,
    "sensor_msgs/msg/CameraInfo": take_camera_info,
    "geometry_msgs/msg/PoseStamped": take_pose,
    "nav_msgs/msg/Odometry": take_odometry,
    "sensor_msgs/msg/PointCloud2": take_cloud,
    "diagnostic_msgs/msg/DiagnosticArray": take_calls,
}


def _target(msgtype: str, take: Callable[[Any], None]) -> Target:
    name = msgtype.split("/")[2]
    use = lambda path: take(_of_ros(path.read_bytes(), msgtype))  # noqa: E731
    return Target(name, f"messages/{name}.cdr", (partial(hostile_fields, msgtype),), (use,))


MESSAGE_TARGETS = [_target(msgtype, take) for msgtype, take in READERS.items()]
