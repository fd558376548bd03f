"""ROS messages with hostile fields, through converters and sessions as the nodes use them, without any transport."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from execution import Reader, Target
from geometry_msgs.msg import PoseStamped
from message_mutations import message_fields
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from targets import check_estimate

from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
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
from sfr_loc_map.nodes.stereo_input import (
    ReceivedPair,
    StereoInput,
    StereoInputConfig,
)
from sfr_loc_map.pipeline.localisation_session import LocalisationSession
from sfr_loc_map.pipeline.mapping_session import MappingSession
from sfr_loc_map.pipeline.monitor_score import MonitorScore
from sfr_loc_map.pipeline.reception import MessageTimes

from made_scene import LOC_RIG, NAV_RIG, PERIOD_NS, START_NS, T_RB_LOCSB, loc_pair, nav_pair, true_pose  # isort: skip

TYPES = {
    "Image": Image,
    "CompressedImage": CompressedImage,
    "CameraInfo": CameraInfo,
    "PoseStamped": PoseStamped,
    "Odometry": Odometry,
    "PointCloud2": PointCloud2,
    "DiagnosticArray": DiagnosticArray,
}


def _serialised(message: Any) -> bytes:
    return bytes(TYPESTORE.serialize_cdr(message, message.__msgtype__))


def make_messages(world: Path) -> None:
    """Write the valid messages into a world."""
    pair, nav = loc_pair(1), nav_pair(0)
    records = np.zeros(40, PointCloud.dtype())
    records["x"], records["u"], records["v"] = 3.0, np.arange(40), 7
    made = {
        "Image": bag_messages.image(pair.stamp_ns, pair.left, "loc", "left"),
        "CompressedImage": bag_messages.jpeg_image(pair.stamp_ns, pair.left, "loc", "left", 90),
        "CameraInfo": bag_messages.camera_info(pair.stamp_ns, LOC_RIG, "loc", "left"),
        "PoseStamped": bag_messages.pose(pair.stamp_ns, nav.T_lm_navsb),
        "Odometry": bag_messages.odometry(pair.stamp_ns, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])),
        "PointCloud2": bag_messages.points(nav.pair.stamp_ns, nav.truth, None),
    }
    folder = world / "messages"
    folder.mkdir(exist_ok=True)
    for name, message in made.items():
        (folder / f"{name}.cdr").write_bytes(_serialised(message))
    types = TYPESTORE.types
    values = {"task": "localisation", "stamp_ns": str(pair.stamp_ns), "state": "tracking", "processing_time_s": "0.1"}
    values |= {"peak_rss_bytes": "100000000", "above_idle_bytes": "1000000"}
    entries = [types["diagnostic_msgs/msg/KeyValue"](key, value) for key, value in values.items()]
    status = types["diagnostic_msgs/msg/DiagnosticStatus"](0, "localisation_node: call", "", "", entries)
    array = types["diagnostic_msgs/msg/DiagnosticArray"](bag_messages.header(pair.stamp_ns, ""), [status])
    (folder / "DiagnosticArray.cdr").write_bytes(_serialised(array))


class _Rover:
    """The part of a localisation node, or of a mapping node, behind its subscriptions."""

    def __init__(self) -> None:
        self.localisation = LocalisationSession(LocalisationConfig())
        self.problems: list[str] = []
        restart, report = self.localisation.restart, self.problems.append
        self.stereo = StereoInput("loc", StereoInputConfig(), self.on_pair, self.on_rig, restart, report)
        self.farthest_m = 1e6

    def on_rig(self, rig: Any) -> None:
        self.localisation.set_rig(rig)

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

    def drive(self, infos: tuple[Any, Any] | None = None, image: Any = None) -> None:
        """Send two good pairs, with other camera_info or another image among them."""
        good = tuple(
            _message("CameraInfo", bag_messages.camera_info(0, LOC_RIG, "loc", side)) for side in ("left", "right")
        )
        times = MessageTimes.of({"source_timestamp": START_NS, "received_timestamp": START_NS})
        for index in range(3):
            chosen = infos if infos is not None and index == 1 else good
            for side, info in zip(("left", "right"), chosen, strict=True):
                self.stereo.add_camera_info(side, info)
            pair = loc_pair(index)
            for side, data in (("left", pair.left), ("right", pair.right)):
                message = _message("Image", bag_messages.image(pair.stamp_ns, data, "loc", side))
                if image is not None and index == 1:
                    message = image
                self.stereo.add_image(side, (message, times))


def _message(name: str, message: Any) -> Any:
    return deserialize_message(_serialised(message), TYPES[name])


def _read(name: str, path: Path) -> Any:
    return deserialize_message(path.read_bytes(), TYPES[name])


def take_image(name: str) -> Reader:
    def take(path: Path) -> None:
        _Rover().drive(image=_read(name, path))

    return take


def take_camera_info(path: Path) -> None:
    info = _read("CameraInfo", path)
    right = _message("CameraInfo", bag_messages.camera_info(0, LOC_RIG, "loc", "right"))
    _Rover().drive(infos=(info, right))
    both = _read("CameraInfo", path)
    if len(both.p) == 12:
        shifted = [float(value) for value in both.p]  # numbers of Python: infinity less infinity warns of nothing
        shifted[3] = shifted[3] - abs(shifted[0]) * 0.12
        both.p = np.array(shifted)
        _Rover().drive(infos=(info, both))


def take_pose(path: Path) -> None:
    message = _read("PoseStamped", path)
    pose = transform_from_pose(message.pose, "nav/pose")
    session = MappingSession(MappingConfig())
    session.set_rig(NAV_RIG)
    result = session.map_pair(nav_pair(0).pair, pose)
    session.map_pair(
        StereoPair(START_NS + PERIOD_NS, *(nav_pair(0).pair.left, nav_pair(0).pair.right)), Transform.identity()
    )
    if not np.isfinite(result.cloud.xyz).all():
        raise ArithmeticError("points that are not finite")
    session.fuse()
    rover = _Rover()
    rover.farthest_m = 1.1e9  # the start may be anywhere
    rover.localisation.set_pose(StartPose(pose))
    rover.drive()


def take_odometry(path: Path) -> None:
    message = _read("Odometry", path)
    score = MonitorScore(ScoreConfig(), None)
    for index in range(4):
        pose = true_pose(index)
        stamp = START_NS + index * PERIOD_NS
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


def take_cloud(path: Path) -> None:
    message = _read("PointCloud2", path)
    for read in (lambda: points_image(message, (NAV_RIG.width, NAV_RIG.height)), lambda: cloud_from_msg(message)):
        try:
            read()
        except SfrError:
            continue


def take_calls(path: Path) -> None:
    score = MonitorScore(ScoreConfig(), None)
    for status in _read("DiagnosticArray", path).status:
        found = task_record(status)
        if found is not None:
            score.add_call(found.record)
            score.score_maps()
    score.result()


def _target(name: str, take: Callable[[Path], None]) -> Target:
    package = {"PoseStamped": "geometry_msgs", "Odometry": "nav_msgs", "DiagnosticArray": "diagnostic_msgs"}
    msgtype = f"{package.get(name, 'sensor_msgs')}/msg/{name}"
    return Target(name, f"messages/{name}.cdr", (message_fields(msgtype),), (take,))


MESSAGE_TARGETS = (
    _target("Image", take_image("Image")),
    _target("CompressedImage", take_image("CompressedImage")),
    _target("CameraInfo", take_camera_info),
    _target("PoseStamped", take_pose),
    _target("Odometry", take_odometry),
    _target("PointCloud2", take_cloud),
    _target("DiagnosticArray", take_calls),
)
