"""The localisation node: stereo pairs in, odometry out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from sfr_loc_map.config import param
from sfr_loc_map.errors import ConfigError, InputError, SfrError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.nodes.calls import CallReporter
from sfr_loc_map.nodes.conversions import odometry_msg, transform_from_pose
from sfr_loc_map.nodes.diagnostics import Level
from sfr_loc_map.nodes.parameters import declare
from sfr_loc_map.nodes.runner import run
from sfr_loc_map.nodes.static_frames import StaticFrames, tf_message_type
from sfr_loc_map.nodes.stereo_input import WARN_EVERY_S, StereoInput, StereoInputConfig

NAME = "localisation_node"
LEVELS = {
    TrackingState.INITIALISING: Level.WARN,
    TrackingState.TRACKING: Level.OK,
    TrackingState.LOST: Level.ERROR,
}


@dataclass(frozen=True, slots=True)
class MountConfig:
    """Place of the localisation stereo bench on the rover."""

    translation_m: tuple[float, ...] = param((0.0, 0.0, 0.0), unit="m", doc="Origin of LOCSB in RB: x, y, z.")
    quat_xyzw: tuple[float, ...] = param(
        (0.0, 0.0, 0.0, 0.0),
        doc="Orientation of LOCSB in RB: x, y, z, w; takes components in LOCSB to RB. All zero: not given, the place "
        "is then taken from /tf_static (rb_frame to locsb_frame) where tf2_msgs is installed.",
    )

    def transform(self) -> Transform | None:
        """Return `T_rb_locsb`, None where it is not given.

        Raises:
            ConfigError: If the values are not a place.
        """
        if len(self.translation_m) != 3 or len(self.quat_xyzw) != 4:
            raise ConfigError("T_rb_locsb needs translation_m [x, y, z] and quat_xyzw [x, y, z, w]")
        if not any(self.quat_xyzw):
            if any(self.translation_m):
                raise ConfigError("T_rb_locsb.translation_m is given but quat_xyzw is not: give both")
            return None
        if abs(float(np.linalg.norm(self.quat_xyzw)) - 1.0) > 1e-3:
            raise ConfigError(f"T_rb_locsb.quat_xyzw is {list(self.quat_xyzw)}: a unit quaternion is needed")
        return Transform.from_quat(self.translation_m, self.quat_xyzw)


@dataclass(frozen=True, slots=True)
class LocalisationNodeConfig:
    """Parameters of the localisation node."""

    ds_frame: str = param("ds", doc="Name of the world frame DS: parent of the odometry.")
    rb_frame: str = param("rb", doc="Name of the rover's frame RB: child of the odometry.")
    locsb_frame: str = param("locsb", doc="Name of the stereo bench's frame LOCSB in /tf_static.")
    publish_tf: bool = param(True, doc="Publish ds to rb on /tf, where tf2_msgs is installed.")
    output_depth: int = param(100, unit="messages", doc="Depth of the odometry's queue.", low=1, high=10000)
    T_rb_locsb: MountConfig = field(default_factory=MountConfig)
    input: StereoInputConfig = field(default_factory=StereoInputConfig)
    localisation: LocalisationConfig = field(default_factory=LocalisationConfig)


class LocalisationNode(Node):
    """Publishes the pose of RB in DS for each stereo pair."""

    def __init__(self) -> None:
        """Declare the parameters, warm up, subscribe.

        Raises:
            ConfigError: If a parameter is unknown or not valid.
        """
        super().__init__(NAME)
        (self._config,) = declare(self, LocalisationNodeConfig)
        self._mount = self._config.T_rb_locsb.transform()
        self._localiser: Localiser | None = None
        self._first_pose = self._next_pose = Transform.identity()
        self._frames = StaticFrames()
        Localiser.warm_up()  # before the first picture: no call pays for it
        self._calls = CallReporter(self, "localisation")
        qos = QoSProfile(depth=self._config.output_depth)
        self._odometry = self.create_publisher(Odometry, "localisation/odometry", qos)
        self._tf = self._create_tf()
        # First, so that a pose sent before the first pair is handled before it.
        poses = self.create_subscription(
            PoseWithCovarianceStamped, "initialpose", self._on_initial_pose, QoSProfile(depth=1)
        )
        self._listen(poses.topic_name)

    def _listen(self, pose_topic: str) -> None:
        topics = [pose_topic]
        if self._mount is None:
            static = self._frames.subscribe(self, self._look_up_mount)
            topics += [static] if static else []
        self._input = StereoInput(
            self,
            "loc",
            self._config.input,
            on_pair=self._on_pair,
            on_rig=self._on_rig,
            on_jump_back=self._on_jump_back,
            on_problem=self._report,
        )
        service = self.create_service(Trigger, "~/reset", self._on_reset)
        publishes = [self._odometry.topic_name, self._calls.topic, *(["/tf"] if self._tf else [])]
        self.get_logger().info(
            f"listens to {', '.join(topics + self._input.topics)}; publishes {', '.join(publishes)}; "
            f"offers {self.resolve_service_name(service.srv_name)}"
        )
        if self._mount is None:
            source = "/tf_static is awaited" if len(topics) > 1 else "tf2_msgs for /tf_static is not installed"
            self.get_logger().warning(f"the place of the stereo bench (parameters T_rb_locsb) is not given: {source}")

    def _create_tf(self) -> Any:  # noqa: ANN401 - a publisher of a type that need not be there
        kind = tf_message_type()
        return self.create_publisher(kind, "/tf", QoSProfile(depth=100)) if kind and self._config.publish_tf else None

    def _look_up_mount(self) -> None:
        if self._mount is None:
            self._mount = self._frames.find(self._config.rb_frame, self._config.locsb_frame)

    def _on_rig(self, rig: StereoRig) -> None:
        if self._localiser is not None:
            self.get_logger().warning("camera_info has changed: localisation starts anew at its last pose")
        self._localiser = None

    def _on_jump_back(self) -> None:
        self.get_logger().warning("stamps have gone back: localisation starts anew at its first pose")
        self._localiser, self._next_pose = None, self._first_pose

    def _on_initial_pose(self, message: PoseWithCovarianceStamped) -> None:
        frame = message.header.frame_id
        if frame not in ("", self._config.ds_frame):
            self.get_logger().warning(f"initialpose is in '{frame}', '{self._config.ds_frame}' is needed: ignored")
            return
        try:
            pose = transform_from_pose(message.pose.pose, "initialpose")
        except InputError as error:
            self.get_logger().warning(f"{error}; ignored")
            return
        self._first_pose = self._next_pose = pose
        if self._localiser is not None:
            self._localiser.set_pose(pose)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._localiser = None
        self._first_pose = self._next_pose = Transform.identity()
        self._input.restart()
        response.success, response.message = True, "localisation starts anew at the identity"
        return response

    def _on_pair(self, pair: StereoPair) -> None:
        try:
            localiser = self._localiser or self._begin()
            with self._calls.measure() as usage:
                estimate = localiser.process(pair)
        except SfrError as error:
            self._input.counts.rejected += 1
            self._report(str(error))
            return
        self._next_pose = estimate.T_ds_rb
        self._publish(estimate)
        self._calls.publish(
            estimate.stamp_ns,
            usage,
            estimate.state.value,
            estimate.statistics,
            self._input.statistics(),
            LEVELS[estimate.state],
        )

    def _report(self, text: str) -> None:
        self.get_logger().error(text, throttle_duration_sec=WARN_EVERY_S)
        self._calls.publish_problem(text, self._input.statistics())

    def _begin(self) -> Localiser:
        """Make the localiser for the rig, at the pose due."""
        rig = self._input.rig
        if rig is None or self._mount is None:
            raise InputError(
                "the place of the stereo bench on the rover is not known: give the parameters T_rb_locsb.translation_m "
                "and T_rb_locsb.quat_xyzw, or publish it on /tf_static"
            )
        self._localiser = Localiser(replace(rig, T_rb_sb=self._mount), self._config.localisation, self._next_pose)
        return self._localiser

    def _publish(self, estimate: PoseEstimate) -> None:
        message = odometry_msg(estimate, self._config.ds_frame, self._config.rb_frame)
        self._odometry.publish(message)
        if self._tf is None or estimate.state is TrackingState.LOST:
            return
        motion = TransformStamped(header=message.header, child_frame_id=self._config.rb_frame)
        place = message.pose.pose.position
        motion.transform.translation = Vector3(x=place.x, y=place.y, z=place.z)
        motion.transform.rotation = message.pose.pose.orientation
        self._tf.publish(self._tf.msg_type(transforms=[motion]))


def main() -> int:
    """Run the node."""
    return run(LocalisationNode)


if __name__ == "__main__":
    raise SystemExit(main())
