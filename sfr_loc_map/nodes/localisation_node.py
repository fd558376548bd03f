"""The localisation node: stereo pairs in, odometry out.

Messages are received in the executor's thread and given to the worker in their order; its thread alone touches the
session, so that a new rig, pose or configuration takes its place among the pairs.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile

from sfr_loc_map.config import param
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.localisation.frontend.feature_detection import read_mask
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.start_pose import StartPose
from sfr_loc_map.nodes.diagnostics.call_reporter import Call, CallReporter
from sfr_loc_map.nodes.diagnostics.key_values import Level
from sfr_loc_map.nodes.input.config import StereoInputConfig
from sfr_loc_map.nodes.input.extrinsics import Extrinsics, ExtrinsicsConfig
from sfr_loc_map.nodes.input.odometry_subscriber import MotionPriorConfig, OdometrySubscriber
from sfr_loc_map.nodes.input.received_pair import ReceivedPair
from sfr_loc_map.nodes.input.stereo_subscriber import StereoSubscriber
from sfr_loc_map.nodes.input.stereo_synchronizer import PairHandlers
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.lifecycle.node_config import PairNodeConfig
from sfr_loc_map.nodes.messages.pose import odometry_msg, start_pose_of, tf_message_type, transform_of_odometry
from sfr_loc_map.nodes.output.path_publisher import PathPublisher
from sfr_loc_map.nodes.output.track_publisher import TrackPublisher
from sfr_loc_map.nodes.process.runner import run
from sfr_loc_map.pipeline.kernels import load_kernels
from sfr_loc_map.pipeline.localisation_session import LocalisationSession, PoseFile
from sfr_loc_map.pipeline.reception import latencies

NAME = "localisation_node"
LEVELS = {
    TrackingState.INITIALISING: Level.WARN,
    TrackingState.TRACKING: Level.OK,
    TrackingState.DEGRADED: Level.WARN,
    TrackingState.LOST: Level.ERROR,
}


@dataclass(frozen=True, slots=True)
class LocalisationNodeConfig(PairNodeConfig):
    """Parameters of the localisation node."""

    ds_frame: str = param("ds", doc="Name of the world frame DS: parent of the odometry.")
    rb_frame: str = param("rb", doc="Name of the frame RB of the rover: child of the odometry.")
    locsb_frame: str = param("locsb", doc="Name of the frame LOCSB of the stereo rig in /tf_static.")
    publish_tf: bool = param(True, doc="Publish ds to rb on /tf, where tf2_msgs is installed.")
    output_depth: int = param(
        1000,
        unit="messages",
        doc="Depth of the queue of the odometry: so many are kept for a slow subscriber.",
        low=1,
        high=10000,
    )
    resume_file: str = param(
        "",
        doc="File that keeps the last known pose of a rig, at which a node that was killed resumes. "
        "Empty: none is kept.",
    )
    resume_max_age_s: float = param(
        60.0,
        unit="s",
        doc="A kept pose older than this, by the stamp of the first pair, is not resumed from.",
        low=0.1,
        high=1e6,
    )
    T_rb_locsb: ExtrinsicsConfig = field(default_factory=ExtrinsicsConfig)
    input: StereoInputConfig = field(default_factory=StereoInputConfig)
    motion_prior: MotionPriorConfig = field(default_factory=MotionPriorConfig)
    localisation: LocalisationConfig = field(default_factory=LocalisationConfig)


class LocalisationNode(ManagedNode[LocalisationNodeConfig]):
    """Publishes the pose of RB in DS for each stereo pair.

    Attributes:
        config_type: Its parameters; a subclass may have more, by a dataclass that derives from this one.
    """

    config_type: type[LocalisationNodeConfig] = LocalisationNodeConfig
    _stereo: StereoSubscriber | None = None

    def __init__(self, name: str = NAME, **options: Any) -> None:  # noqa: ANN401
        """Declare the parameters.

        Args:
            name: Name of the node.
            options: Of `rclpy.node.Node`.

        Raises:
            ConfigError: If a parameter is unknown or not valid.
        """
        super().__init__(name, "localisation", self.config_type, live=("localisation.",), **options)
        self.teardown()

    def check_config(self, config: LocalisationNodeConfig) -> None:
        """Try whether a localiser can be made with the parameters and the rig; where that is not known, read masks."""
        config.check_frames(config.ds_frame, config.rb_frame, config.locsb_frame)
        T_rb_sb = config.T_rb_locsb.transform()
        for mask in filter(None, (config.localisation.left_mask, config.localisation.right_mask)):
            read_mask(mask)
        if self._stereo is not None and self._stereo.rig is not None:
            rig = replace(self._stereo.rig, T_rb_sb=T_rb_sb or Transform.identity())
            Localiser(rig, config.localisation, Transform.identity())

    def setup(self) -> None:
        """Load compiled code, create publishers."""
        config = self.config
        # Before the first pair: no call pays for it.
        load_kernels("localisation", self.get_logger().info, self.context.ok)
        pose_file = PoseFile(Path(config.resume_file), config.resume_max_age_s) if config.resume_file else None
        if pose_file is not None:
            pose_file.check()
        self._session = LocalisationSession(config.localisation, pose_file, self.status.warn)
        self._extrinsics = Extrinsics(
            config.T_rb_locsb, config.frame(config.rb_frame), config.frame(config.locsb_frame)
        )
        self._motion_prior = OdometrySubscriber(config.motion_prior, config.frame(config.rb_frame), self.status.warn)
        self._calls = CallReporter(self, self.task, self.status.publisher)
        self._odometry = self.endpoints.add_publisher(Odometry, "localisation/odometry", config.output_depth)
        self._path = PathPublisher(self.endpoints)
        self._pose_set = self.endpoints.add_publisher(
            PoseWithCovarianceStamped, "localisation/initialpose_set", 1, latched=True
        )
        self._tracks = TrackPublisher(self.endpoints)
        tf_type = tf_message_type() if config.publish_tf else None
        self._tf = self.endpoints.add_publisher(tf_type, "/tf", 100) if tf_type else None

    def subscribe(self) -> None:
        """Subscribe and offer services."""
        # First, so that a pose sent before the first pair is handled before it.
        self.endpoints.add_subscription(
            PoseWithCovarianceStamped, "initialpose", self._on_initial_pose, QoSProfile(depth=1)
        )
        missing = self._extrinsics.subscribe(self.endpoints)
        self._motion_prior.subscribe(self.endpoints, self.config.input.queue_depth)
        handlers = PairHandlers(
            on_pair=lambda pair: self.worker.enqueue_droppable(lambda: self._process(pair)),
            on_rig=lambda rig: self.worker.enqueue(lambda: self._set_rig(rig)),
            on_jump_back=lambda: self._restart("stamps have gone back"),
        )
        self._stereo = StereoSubscriber("loc", self.config.input, handlers, self.endpoints, self.status)
        self.add_service("~/reset", self._reset, first=self._forget_waiting)
        if missing is not None:
            self.get_logger().warning(missing)

    def teardown(self) -> None:
        """Forget everything."""
        self._stereo = None
        self._session = LocalisationSession(self.config.localisation)

    def clock_jumped_back(self) -> None:
        """Start a new run, unless its pairs have come already."""
        if self._stereo is not None and self._stereo.is_ahead_of(self.get_clock().now().nanoseconds):
            self._restart("the clock has gone back")

    def apply_config(self, config: LocalisationNodeConfig) -> None:
        """Continue at the last pose with other parameters."""
        self.worker.enqueue(lambda: self._session.set_config(config.localisation))

    def counts(self) -> dict[str, int]:
        """Return what was dropped since the start, by name."""
        return (self._stereo.counts() if self._stereo is not None else {}) | super().counts()

    def restart_after_fault(self) -> None:
        """Continue at the last pose."""
        self._session.continue_at_last_pose()
        self._count_unprocessed()

    # ---- in the executor's thread

    def _restart(self, reason: str) -> None:
        """Start a new run at the first pose, after the pairs that came before."""
        if self._stereo is not None:
            self._stereo.restart()
        self.get_logger().warning(f"{reason}: localisation restarts at its first pose")
        self.worker.enqueue(self._session.restart)

    def _on_initial_pose(self, message: PoseWithCovarianceStamped) -> None:
        frame, wanted = message.header.frame_id, self.config.frame(self.config.ds_frame)
        if frame not in ("", wanted):
            self.status.warn(f"initialpose is in '{frame}', '{wanted}' is needed: ignored")
            return
        try:
            pose = start_pose_of(message)
        except InputError as error:
            self.status.warn(f"{error}; ignored")
            return
        self.worker.enqueue(lambda: self._set_pose(pose, message))

    def _forget_waiting(self) -> None:
        self.worker.clear()
        if self._stereo is not None:
            self._stereo.restart()

    # ---- in the worker's thread

    def _set_rig(self, rig: StereoRig) -> None:
        if self._session.set_rig(rig):
            self.get_logger().warning("camera_info has changed: localisation restarts at its last pose")

    def _set_pose(self, pose: StartPose, message: PoseWithCovarianceStamped) -> None:
        """Take a start pose, and say so by the message itself."""
        self._session.set_pose(pose)
        self._pose_set.publish(message)

    def _reset(self) -> str:
        self._session.reset()
        self._path.clear()
        return "localisation restarts at the identity"

    def _process(self, received: ReceivedPair) -> None:
        begin = time.perf_counter()
        try:
            pair = received.decode()
            conversion_s = time.perf_counter() - begin
            localiser = self._session.localiser_at(pair.stamp_ns, self._extrinsics.T_rb_sb)
            motion = self._motion_prior.motion(self._session.tracked_ns, pair.stamp_ns)
            with self._calls.measure() as usage:
                estimate = localiser.process(pair, motion)
            self._session.accept(estimate)
        except SfrError as error:
            self._count_unprocessed()
            self.status.error(str(error))
            return
        self.publish_estimate(estimate)
        self._tracks.publish(pair, localiser, estimate, received.frame_id)
        now_ns = self.get_clock().now().nanoseconds
        times = latencies(received.times, pair.stamp_ns, time.time_ns(), now_ns) | {"conversion_s": conversion_s}
        statistics = estimate.figures | ({} if motion is None else {"motion_prior": 1.0})
        level = LEVELS[estimate.state]
        step = None if estimate.step is None else estimate.step.uncertainty
        result = (estimate.state.value, level, statistics, times, estimate.reason_text, step)
        call = Call(estimate.stamp_ns, usage, *result)
        self.status.note_call(call, self._calls.publish(call, self.counts()))

    def _count_unprocessed(self) -> None:
        if self._stereo is not None:
            self._stereo.count_unprocessed()

    def publish_estimate(self, estimate: PoseEstimate) -> None:
        """Publish odometry, and path and tf where tracked; in the worker's thread, in the order of the pairs."""
        config = self.config
        message = odometry_msg(estimate, config.frame(config.ds_frame), config.frame(config.rb_frame))
        self._odometry.publish(message)
        if estimate.state is TrackingState.LOST:
            return
        self._path.add(estimate, message)
        if self._tf is not None:
            self._tf.publish(self._tf.msg_type(transforms=[transform_of_odometry(message)]))


def main() -> int:
    """Run the node."""
    return run(LocalisationNode)


if __name__ == "__main__":
    raise SystemExit(main())
